"""Particles of one frame: alone, among others, and those that are not there."""

from dataclasses import replace
from itertools import combinations

import numba
import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded
from scipy.sparse import bsr_array

from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.noise import QUANTUM, noise_of
from plenopiv.tracking import areas
from plenopiv.tracking import covariance as of_fit
from plenopiv.tracking.covariance import LEAST, covariance_among
from plenopiv.tracking.evidence import errors_of
from plenopiv.tracking.frame import particles_of_frame, particles_of_second_frame
from plenopiv.tracking.light import UNIT_MM, PointLights, prior_std_mm
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, first_light, image_of, refine
from plenopiv.volume import DenseVolume, VoxelGrid

LIGHT = GAIN * 400.0 * 150.0  # counts of a particle


@pytest.fixture(scope="module")
def of_points():
    return PointLights(CAMERA)


@pytest.mark.parametrize("z", [-6.0, -1.5, 0.7, 3.9])
def test_a_particle_alone_without_noise(of_points, z):
    """Positions to 1e-3 voxel, from half a voxel away."""
    place = np.array([[0.031, -0.087, z]])
    lights = of_points(place)
    light = np.bincount(lights.pixel, LIGHT * lights.share, CAMERA.sensor.rows * CAMERA.sensor.columns)
    pixels = Pixels(light, np.ones(len(light), bool), 2.0, GAIN)
    start = place + 0.5 * VOXEL_MM
    fit = refine(of_points, pixels, start, np.array([0.7 * LIGHT]), Prior(start, prior_std_mm(CAMERA)), 12)
    assert np.abs((fit.position_mm - place) / VOXEL_MM).max() < 1e-3
    assert fit.light[0] == pytest.approx(LIGHT, rel=1e-3)


@pytest.fixture(scope="module")
def field(of_points):
    """Particles at 1 ppm, and what is found of them from the truth put off by errors as those of MART's peaks, one
    particle in ten left out and as many added."""
    truth = seeded()
    counts = noisy(truth.position_mm, truth.electrons)
    rng = np.random.default_rng(0)
    known = rng.random(len(truth.electrons)) > 0.1
    start = truth.position_mm[known] + rng.normal(0.0, (0.15, 0.15, 0.25), (known.sum(), 3)) * VOXEL_MM
    ghosts = rng.uniform(*np.transpose(LIMITS), (len(known) // 10, 3))
    first = np.concatenate([start, ghosts])

    return truth, particles_of_frame(of_points, pixels_of(counts), first, np.full(len(first), LIGHT), LIMITS)


def test_particles_among_others(of_points, field):
    truth, found = field
    beyond = np.abs(truth.position_mm[:, 2]) > 0.46
    judged = beyond & (of_points(truth.position_mm).whole() > 0.999)
    partner = nearest(truth.position_mm, found.position_mm)
    assert judged.sum() > 50
    assert (partner[judged] >= 0).mean() > 0.95
    alone = np.setdiff1d(np.arange(len(found.light)), partner)
    assert (np.abs(found.position_mm[alone, 2]) > 0.46).sum() <= 0.02 * len(found.light)
    both = judged & (partner >= 0)
    error = (found.position_mm[partner[both]] - truth.position_mm[both]) / VOXEL_MM
    assert (np.sqrt((error**2).mean(0)) < (0.05, 0.05, 0.08)).all()
    std = np.sqrt(np.einsum("nii->ni", found.covariance))[partner[both], :3] / VOXEL_MM
    assert 0.55 < (np.abs(error) < std).mean() < 0.82
    assert (np.abs(error) < 2 * std).mean() > 0.88
    light = found.light[partner[both]] / (GAIN * truth.electrons[both])
    assert np.median(light) == pytest.approx(1.0, abs=0.01)
    assert 0.8 < np.median(found.misfit) < 1.3


def test_no_particles(of_points):
    """Noise alone, and a first guess that is not there."""
    pixels = pixels_of(noisy(np.zeros((1, 3)), np.zeros(1)))
    for first in (np.empty((0, 3)), np.array([[0.1, 0.1, 1.0]])):
        with pytest.raises(PlenoPIVError, match="the pixels speak for no particle"):
            particles_of_frame(of_points, pixels, first, np.full(len(first), LIGHT), LIMITS)


@pytest.fixture(scope="module")
def few():
    """The pixels of a few particles, some beside each other, and these."""
    truth = seeded(0.15)
    near = np.concatenate([truth.position_mm, truth.position_mm[:9] + 2 * VOXEL_MM])
    return pixels_of(noisy(near, np.full(len(near), LIGHT / GAIN))), near


def test_pixels_that_cannot_be_used_speak_for_no_particle(of_points, few):
    """Of particles that share such pixels alone nothing is known, which ended in a division by zero."""
    pixels, near = few
    light = np.full(len(near), LIGHT)
    with pytest.raises(PlenoPIVError, match="the pixels speak for no particle"):
        particles_of_frame(of_points, replace(pixels, usable=np.zeros_like(pixels.usable)), near, light, LIMITS)
    rows, columns = CAMERA.sensor.rows, CAMERA.sensor.columns
    half = replace(pixels, usable=pixels.usable & (np.arange(rows * columns) % columns < columns // 2))
    found = particles_of_frame(of_points, half, near, light, LIMITS)
    assert 0.3 * len(near) < len(found.light) < 0.8 * len(near)
    own = of_points(found.position_mm)
    seen = np.bincount(own.point, own.share * half.usable[own.pixel], len(found.light)) / own.whole()
    assert seen.min() > 0.05


def test_a_camera_that_clips_at_zero(of_points, few):
    """No pixel is below a black level of 0, and a white image told of no shot noise: digitisation is left."""
    pixels, near = few
    counts = np.maximum(pixels.counts, 0.0).astype(np.float32)
    dark = noise_of(counts, pixels.usable, 0.0).dark
    assert dark == QUANTUM
    image = counts.reshape(CAMERA.sensor.rows, CAMERA.sensor.columns)
    clipped = Pixels.of_image(image, 0.0, 4035, dark, 0.0)
    found = particles_of_frame(of_points, clipped, near, np.full(len(near), LIGHT), LIMITS)
    assert (nearest(near, found.position_mm) >= 0).mean() > 0.8


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_guesses_that_are_not_numbers_are_left_out(of_points, few, wrong):
    pixels, near = few
    light = np.full(len(near), LIGHT)
    expected = particles_of_frame(of_points, pixels, near, light, LIMITS)
    odd, odd_light = np.concatenate([near, near[:2]]), np.concatenate([light, [LIGHT, wrong]])
    odd[-2, 2] = wrong
    found = particles_of_frame(of_points, pixels, odd, odd_light, LIMITS)
    assert (found.position_mm == expected.position_mm).all()
    second = particles_of_second_frame(of_points, pixels, odd, odd_light, LIMITS)
    assert np.isfinite(second.position_mm).all()


@pytest.mark.parametrize("find", [particles_of_frame, particles_of_second_frame])
def test_pixels_of_other_cameras_are_refused(of_points, few, find):
    pixels, near = few
    fewer = replace(pixels, counts=pixels.counts[:-5], usable=pixels.usable[:-5])
    count = len(pixels.counts)
    with pytest.raises(PlenoPIVError, match=f"{count - 5} pixels are given, the cameras have {count}; give"):
        find(of_points, fewer, near, np.full(len(near), LIGHT), LIMITS)


def test_what_is_left_of_other_cameras_is_refused(of_points):
    with pytest.raises(PlenoPIVError, match="9 pixels are given"):
        of_points.places(np.zeros(9), LIMITS)


@pytest.mark.parametrize("together", [2000, 2], ids=["at once", "in areas, several at once"])
def test_bits_do_not_depend_on_the_number_of_threads(monkeypatch, of_points, together):
    truth = seeded(0.15)
    monkeypatch.setattr(areas, "TOGETHER", together)
    cut = areas.areas(truth.position_mm[:, :2])
    groups = areas.groups(truth.position_mm[:, :2], cut, areas.ABOUT * UNIT_MM[:2])
    assert (max(map(len, groups)) > 1) == (together == 2)
    pixels, start = pixels_of(noisy(truth.position_mm, truth.electrons)), truth.position_mm + 0.2 * VOXEL_MM
    threads, found = numba.get_num_threads(), []
    try:
        for count in (1, 2):
            numba.set_num_threads(count)
            found.append(particles_of_frame(of_points, pixels, start, np.full(len(start), LIGHT), LIMITS))
    finally:
        numba.set_num_threads(threads)
    for name in ("position_mm", "light", "covariance"):
        assert (getattr(found[0], name) == getattr(found[1], name)).all()


def test_covariances_are_those_of_the_whole_inverse():
    """Where all neighbours fit in, a particle's covariance is its block of the inverse."""
    rng = np.random.default_rng(1)
    tall = rng.normal(size=(60, 24))
    dense = tall.T @ tall
    dense += 10 * np.eye(24)
    blocks = bsr_array(dense, blocksize=(4, 4))
    inverse = np.linalg.inv(dense + LEAST * np.diag(np.diag(dense)))
    found = covariance_among(blocks, np.array([4, 0, 5]))
    for block, n in zip(found, (4, 0, 5), strict=True):
        assert block == pytest.approx(inverse[4 * n : 4 * n + 4, 4 * n : 4 * n + 4], rel=1e-6)


def test_areas_hold_each_point_once_and_are_cut_elsewhere_in_turn(monkeypatch):
    monkeypatch.setattr(areas, "TOGETHER", 60)
    place = np.random.default_rng(2).uniform(0.0, (3.0, 1.0), (500, 2))
    for turn in (0, 1):
        cut = areas.areas(place, turn)
        assert max(len(area) for area in cut) <= 60
        assert np.sort(np.concatenate(cut)).tolist() == list(range(500))
        assert all((np.diff(area) > 0).all() for area in cut)
        assert np.mean([np.prod(np.ptp(place[area], axis=0)) for area in cut]) < 3.0 / len(cut)  # they do not overlap
        first, second = (areas.areas(place, turn + k)[0] for k in (0, 1))
        assert set(first) != set(second)
    reach = np.array([0.3, 0.1])
    near = areas.about(place, cut[0], reach)
    low, high = place[cut[0]].min(0), place[cut[0]].max(0)
    for n, (x, y) in enumerate(place):
        within = low[0] - 0.3 <= x <= high[0] + 0.3 and low[1] - 0.1 <= y <= high[1] + 0.1
        assert (n in near) == within


@pytest.mark.parametrize("turn", [0, 1])
def test_areas_fitted_at_once_do_not_touch(monkeypatch, turn):
    monkeypatch.setattr(areas, "TOGETHER", 30)
    place, apart = np.random.default_rng(2).uniform(0.0, (3.0, 1.0), (1000, 2)), np.array([0.1, 0.1])
    cut = areas.areas(place, turn)
    groups = areas.groups(place, cut, apart)
    assert np.sort(np.concatenate([area for group in groups for area in group])).tolist() == list(range(1000))
    assert 2 < max(len(group) for group in groups) <= areas.AT_ONCE
    for group in groups:
        for one, other in combinations(group, 2):
            gap = np.abs(place[one][:, None] - place[other]).max(2)  # of any two of their points, along either axis
            assert gap.min() >= 0.1
    assert [len(group) for group in areas.groups(place, cut, np.array([9.0, 9.0]))] == [1] * len(cut)


def test_particles_in_areas_are_those_of_all_at_once(monkeypatch, of_points):
    """Six at a time, whose light overlaps with that of most others: light and places come to the same, and so do error
    bars where all that are coupled are within reach."""
    truth = seeded(0.5)
    pixels, prior = pixels_of(noisy(truth.position_mm, truth.electrons)), Prior(truth.position_mm, prior_std_mm(CAMERA))
    light = GAIN * truth.electrons
    whole, n = refine(of_points, pixels, truth.position_mm, light, prior, 16), len(light)
    covariance, off = errors_of(whole, pixels.usable)
    assert (covariance == covariance_among(whole.normal(), np.arange(n))).all()
    alone = first_light(of_points, pixels, truth.position_mm, 1.2 * light)
    monkeypatch.setattr(areas, "TOGETHER", 6)
    monkeypatch.setattr(of_fit, "TOGETHER", 6)
    assert np.median(np.abs(errors_of(whole, pixels.usable)[0] / covariance - 1.0)) < 1e-3
    monkeypatch.setattr(of_fit, "ABOUT", 1e3)  # all are within reach
    assert (errors_of(whole, pixels.usable)[0] == covariance).all()
    assert image_of(of_points, whole.position_mm, whole.light, len(pixels.counts)) == pytest.approx(whole.image)
    in_areas = refine(of_points, pixels, truth.position_mm, light, prior, 32)
    assert in_areas.kept is None
    std = np.sqrt(np.einsum("nii->ni", covariance))
    told = np.abs(truth.position_mm[:, 2]) > 0.46  # near focus particles slide on, together as in areas
    assert np.abs((in_areas.position_mm - whole.position_mm) / UNIT_MM / std[:, :3])[told].max() < 0.1
    assert in_areas.light[told] == pytest.approx(whole.light[told], rel=1e-3)
    assert in_areas.residual == pytest.approx(whole.residual, abs=0.02 * GAIN * 400.0)
    covariance_in_areas, off_in_areas = errors_of(in_areas, pixels.usable)
    assert off_in_areas == pytest.approx(off, rel=1e-2)
    bars = np.sqrt(np.einsum("nii->ni", covariance_in_areas))
    assert np.median(np.abs(bars / std - 1.0)) < 0.01
    assert first_light(of_points, pixels, truth.position_mm, 1.2 * light) == pytest.approx(alone, rel=0.1)


def test_a_frame_in_areas_has_the_same_particles(monkeypatch, of_points):
    """Beyond the dead zone: in it one particle has several places, that explain the pixels more or less well."""
    truth = seeded(1.0)
    told = np.abs(truth.position_mm[:, 2]) > 0.46
    position, electrons = truth.position_mm[told], truth.electrons[told]
    pixels = pixels_of(noisy(position, electrons))
    rng = np.random.default_rng(6)
    start = position + rng.normal(0.0, (2e-3, 2e-3, 1e-2), position.shape)
    guess = of_points, pixels, start[2:], GAIN * electrons[2:], LIMITS
    whole = particles_of_frame(*guess)
    monkeypatch.setattr(areas, "TOGETHER", 20)
    assert len(areas.areas(start[:, :2])) > 1
    in_areas = particles_of_frame(*guess)
    partner = nearest(whole.position_mm, in_areas.position_mm)
    found = partner >= 0
    assert found.mean() > 0.98
    partner, std = partner[found], np.sqrt(np.einsum("nii->ni", whole.covariance))[found, :3]
    apart = (in_areas.position_mm[partner] - whole.position_mm[found]) / std
    assert np.quantile(np.abs(apart), 0.95) < 0.3
    np.testing.assert_allclose(in_areas.misfit[partner], whole.misfit[found], rtol=0.02)


@pytest.mark.parametrize("pixels", [40, 79, 90])
def test_particles_that_light_does_not_tell_apart_have_wide_bars(pixels):
    """20 particles of 4 unknowns on that many pixels, in single precision: what cannot be told, or by rounding alone,
    is as wide as LEAST lets it be, and nothing is infinite."""
    rng = np.random.default_rng(3)
    derivatives = rng.normal(size=(pixels, 80))
    derivatives[:, 40:44] = derivatives[:, 36:40]  # two at one place
    dense = (derivatives.T @ derivatives).astype(np.float32)
    blocks = np.ascontiguousarray(dense.reshape(20, 4, 20, 4).transpose(0, 2, 1, 3)).reshape(400, 4, 4)
    normal = bsr_array((blocks, np.tile(np.arange(20), 20), 20 * np.arange(21)), shape=(80, 80))
    covariance = covariance_among(normal, np.arange(20))
    assert np.isfinite(covariance).all()
    own = np.diagonal(dense).reshape(20, 4)
    bars = np.sqrt(np.einsum("nii->ni", covariance) * own)  # of what they were, were the others known
    assert (bars >= 0.999).all()
    assert bars[9:11].min() > 200.0
    if pixels == 90:  # the rest are as wide as if the two were one
        one = np.delete(np.arange(80), np.arange(40, 44))
        expected = np.sqrt(np.diag(np.linalg.inv(dense.astype(float)[np.ix_(one, one)])).reshape(19, 4))
        rest = np.delete(np.arange(20), [9, 10])
        assert bars[rest] == pytest.approx(np.delete(expected, 9, 0) * np.sqrt(own[rest]), rel=0.05)


def test_peaks_of_a_volume():
    grid = VoxelGrid((-1.0, 0.0, 2.0), (0.1, 0.1, 0.4), (70, 20, 24))
    values = np.zeros(grid.shape, np.float32)
    k, j, i = np.mgrid[:70, :20, :24]
    true = np.array([[7.3, 9.8, 12.1], [31.6, 5.2, 6.0], [64.0, 14.4, 17.7]])
    for at in true:
        values += np.exp(-0.5 * ((k - at[0]) ** 2 + (j - at[1]) ** 2 + (i - at[2]) ** 2)).astype(np.float32)
    position, light = peaks(DenseVolume(grid, values))
    expected = np.array(grid.first_mm) + true[:, ::-1] * grid.voxel_mm
    order = np.argsort(position[:, 2])
    assert position[order] == pytest.approx(expected, abs=0.02)
    assert light == pytest.approx(np.full(3, (2 * np.pi) ** 1.5), rel=0.05)
