"""The light of particles through a main lens that blurs: against rays in plain NumPy, derivatives against differences,
and positions that are fitted with it."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.blurred_light import blurred_light
from oracles.unsharp_light import unsharp_point_image
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, pixels_of, seeded
from test_light_of_particles import BENT, HEXAGONAL, PLACES, SQUARE, gradients_off, image_of

from plenopiv.lattice import Lattice
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.light import PointLights, prior_std_mm
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, refine
from plenopiv.tracking.soft_cells import soft_cell, weights_of_sub_pixels
from plenopiv.tracking.soft_light_kernels import PARTS

LATTICES = pytest.mark.parametrize("camera", [HEXAGONAL, SQUARE, BENT], ids=["hexagonal", "square", "bent"])


def through(camera, blur_mm):
    return replace(camera, blur_mm=blur_mm)


@LATTICES
@pytest.mark.parametrize("place", PLACES)
def test_shares_are_those_of_rays_sent_astray(camera, place):
    camera = through(camera, 0.02)
    lights = PointLights(camera)
    made = lights([place])
    found, exact = image_of(camera, made, made.share), blurred_light(camera, place, lights.blur_px, 2**20)
    assert np.abs(found - exact).max() < 0.035 * exact.max()
    assert np.linalg.norm(found - exact) < 0.015 * np.linalg.norm(exact)
    assert found.sum() == pytest.approx(exact.sum(), abs=2e-3)


@pytest.mark.parametrize("place", PLACES[:4])
def test_shares_are_integrals_over_the_aperture(place):
    straight = Lattice("square", 0.08, 0.0, (0.03, 0.01))
    camera = through(SQUARE.with_lattice(straight), 0.04)
    lights = PointLights(camera)
    made, exact = lights([place]), unsharp_point_image(camera, place)
    found = image_of(camera, made, made.share)
    # the integrals know no diffraction, which blurs the rim of the aperture's image
    assert lights.blur_px < 0.3
    assert np.linalg.norm(found - exact) < 0.06 * np.linalg.norm(exact)
    columns, rows = np.meshgrid(np.arange(exact.shape[1]), np.arange(exact.shape[0]))
    for axis in (columns, rows):
        assert (found * axis).sum() / found.sum() == pytest.approx((exact * axis).sum() / exact.sum(), abs=0.02)


@LATTICES
@pytest.mark.parametrize("place", PLACES)
def test_gradients_are_differences_of_blurred_shares(camera, place):
    assert max(gradients_off(through(camera, 0.02), place)) < 0.04


def test_little_blur_is_nearly_none():
    """From both sides of what is taken for none; pixels are small against the cells that they see."""
    least = 0.02 * HEXAGONAL.lattice.pitch_mm
    for place in PLACES[:3]:
        sharp, soft = (PointLights(through(HEXAGONAL, blur))([place]) for blur in (0.99 * least, 1.01 * least))
        assert (sharp.share == PointLights(HEXAGONAL)([place]).share).all()
        first, second = (image_of(HEXAGONAL, each, each.share) for each in (sharp, soft))
        assert np.linalg.norm(first - second) < 0.06 * np.linalg.norm(first)


def test_a_cell_and_its_neighbours_share_all_light():
    pitch = 0.08
    corners = 0.5 * pitch * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)], np.float64)
    cell = soft_cell(corners, pitch, 0.25 * pitch)
    assert cell.values[..., 0].sum() * cell.step**2 == pytest.approx(pitch**2, rel=2e-3)

    def share(s, t):
        at = np.array([s + cell.half_s, t + cell.half_t]) / cell.step
        return cell.values[tuple(np.rint(at[::-1]).astype(int))]

    assert share(0.0, 0.0)[0] == pytest.approx(0.9545**2, abs=1e-3)  # two standard deviations on each side
    assert share(0.5 * pitch, 0.0)[0] == pytest.approx(0.5 * 0.9545, abs=0.02)
    slope = share(0.5 * pitch, 0.0)
    density = 0.3989 / (0.25 * pitch)  # of the Gaussian at a side
    assert slope[1] == pytest.approx(-density * 0.9545, rel=0.02)
    assert abs(slope[2]) < 0.01 * density
    assert share(0.0, -0.5 * pitch)[2] == pytest.approx(density * 0.9545, rel=0.02)


def test_parts_of_pixels_give_away_all_of_their_light():
    for blur_px in (0.05, 0.16, 0.5):
        weights = weights_of_sub_pixels(PARTS, blur_px)
        assert weights.sum(1) == pytest.approx(np.ones(PARTS), abs=1e-6)
        assert weights == pytest.approx(weights[::-1, ::-1], abs=1e-6)
        assert (weights.argmax(1) == weights.shape[1] // 2).all()


@pytest.mark.parametrize("z_mm", [-1.8, -0.6, 0.9, 2.2])
def test_an_isolated_particle_is_found_where_it_is(z_mm):
    """From the light of rays, a voxel off, in three iterations."""
    camera = through(CAMERA, 0.02)
    of_points = PointLights(camera)
    place = np.array([[0.05, -0.03, z_mm]])
    counts = 60.0 + 5e4 * blurred_light(camera, place[0], of_points.blur_px, 2**20)
    start = place + np.array([0.01, -0.012, 0.05])
    pixels = Pixels.of_image(counts, 60.0, 4095, 1.5, 0.37)
    fit = refine(of_points, pixels, start, np.array([4e4]), Prior(start, prior_std_mm(camera)), 6)
    assert np.abs((fit.position_mm - place) / [0.017, 0.017, 0.077]).max() < 5e-3
    assert fit.light[0] == pytest.approx(5e4, rel=3e-3)


def test_particles_of_a_frame_know_the_blur():
    """Half a particle per microlens: taken as sharp, the lens makes errors in depth several times as large."""
    camera, truth = through(CAMERA, 0.02), seeded(0.5)
    rng = np.random.default_rng(3)
    light = particle_image(camera, truth, rays=80_000, diffraction_nm=532.0, seed=3)
    pixels = pixels_of(digitise(light + 4.0, camera.sensor, SensorNoise(), rng))
    guess = truth.position_mm + rng.normal(0.0, 0.3, truth.position_mm.shape) * VOXEL_MM
    beyond = np.abs(truth.position_mm[:, 2]) > 0.5
    errors = []
    for taken in (camera, CAMERA):
        found = particles_of_frame(PointLights(taken), pixels, guess, GAIN * truth.electrons, LIMITS)
        partner = nearest(truth.position_mm, found.position_mm)
        both = beyond & (partner >= 0)
        off = (found.position_mm[partner[both]] - truth.position_mm[both]) / VOXEL_MM
        errors.append((both.sum() / beyond.sum(), np.median(np.abs(off), 0)))
    (share, right), (_, wrong) = errors
    assert share > 0.9
    assert (right < [0.02, 0.02, 0.05]).all()
    assert wrong[2] > 2.5 * right[2]
