"""The whole loop on particles of known displacement: signs, accuracy, gradients, resolution, forms of volume."""

import warnings
from dataclasses import replace

import numba
import numpy as np
import pytest

from plenopiv.displacement import multigrid, validation, window_pass
from plenopiv.displacement.multigrid import correlation_pass, measure
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import window_cuts
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

CUBES = CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32), fine_passes=3)


def at_centres(flow, field):
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    return flow(np.stack([x.ravel(), y.ravel(), z.ravel()], -1)).T.reshape(3, *z.shape)


@pytest.mark.parametrize("component", [0, 1, 2])
def test_sign_of_each_axis(component):
    """One blob that moves to larger x, y or z gives a positive dx, dy or dz, and nothing else. No end of the window
    cuts it, so that the correction for overlap goes too far and passes close in on the displacement from both sides."""
    k = np.arange(32.0)
    volumes = []
    for side in (-1.5, 1.5):
        x, y, z = (np.exp(-0.5 * (k - 15.5 - side * (axis == component)) ** 2) for axis in range(3))
        values = (z[:, None, None] * y[:, None] * x).astype(np.float32)
        volumes.append(DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, values.shape), values))
    expected = np.zeros(3)
    expected[component] = 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        field = measure(*volumes, replace(CUBES, fine_passes=8))
    np.testing.assert_allclose(field.displacement[:, 0, 0, 0], expected, atol=0.02)
    assert (field.z[0], field.y[0], field.x[0]) == (15.5, 15.5, 15.5)
    assert field.valid.all()


@pytest.mark.parametrize("sigma", [(1.0, 1.0, 1.0), (0.6, 0.6, 0.6), (0.7, 0.7, 1.5)])
def test_uniform_shifts_have_little_bias_and_noise(particle_pair, uniform_flow, sigma):
    """10 particles per window; only windows that the ends of the volume do not cut. Elongated blobs are noisier."""
    bias, noise = [], []
    for seed, shift in enumerate([(0.25, 0.5, 0.75), (-3.6, 2.4, -1.3), (4.0, -0.5, 3.2)]):
        pair = particle_pair((80, 80, 80), uniform_flow(shift), 10 / 32**3, sigma, seed=seed)
        error = measure(*pair, CUBES).raw - np.reshape(shift, (3, 1, 1, 1))
        inner = error[:, 1:-1, 1:-1, 1:-1].reshape(3, -1)
        bias.append(inner.mean(1))
        noise.append(inner.std(1))
    limit = np.array(sigma) ** 2
    assert (np.abs(np.mean(bias, 0)) < 0.01 * np.maximum(limit, 1)).all()
    assert (np.sqrt(np.mean(np.square(noise), 0)) < 0.03 * np.maximum(limit, 1)).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_smoothing_along_an_axis_unlocks_peaks_from_its_voxels(axis):
    """Particles whose light is all in the voxel that they lie in move by whole voxels; on average by the true .3."""
    shift, size = 0.3, 64
    sharp, smooth = (0.58,) * 3, tuple(1.2 if k == axis else 0.58 for k in range(3))
    means = []
    for seed in range(3):
        at = np.random.default_rng(seed).uniform(2, size - 3, (8000, 3))
        volumes = []
        for side in (-0.5, 0.5):
            values = np.zeros((size,) * 3, np.float32)
            values[tuple(np.rint(at + side * shift).astype(int).T)] = 1.0
            volumes.append(DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, values.shape), values))
        fields = [measure(*volumes, replace(CUBES, smoothing_voxels=sigma)) for sigma in (sharp, smooth)]
        means.append([field.raw.reshape(3, -1).mean(1) for field in fields])
    locked, freed = np.mean(means, 0)
    assert (locked < shift).all()  # toward zero
    assert freed[axis] - locked[axis] > 0.008
    assert (np.abs(freed - locked)[np.arange(3) != axis] < 0.006).all()


def test_cuts_are_where_one_sample_lies_outside():
    """Against every voxel of every window: is x - d/2 or x + d/2 beyond a face?"""
    shape = (40, 48, 64)
    windows = window_grid(shape, (16, 16, 16), 0.5)
    z, y, x = np.meshgrid(*windows.centres, indexing="ij")
    flow = np.stack([2.0 + 0.02 * y, -3.0 + 0 * y, 0.05 * (x - 30) + 0.03 * z])
    predictor = fit_spline(flow, windows.centres, shape)
    cuts = window_cuts(windows, predictor, shape)
    half = np.abs(predictor.at(*(np.arange(n) for n in shape))) / 2
    for at in np.ndindex(*windows.shape):
        part = tuple(slice(s[k], s[k] + 16) for s, k in zip(windows.starts, at, strict=True))
        for axis in range(3):
            index = np.arange(shape[axis])[part[axis]].reshape([-1 if k == axis else 1 for k in range(3)])
            d = half[2 - axis][part]
            assert cuts[at][axis, 0] == pytest.approx(max(0, (d - index - 0.5).take(0, axis).max() + 0.5), abs=1e-5)
            low, high = cuts[at][axis]
            inside = (index >= windows.starts[axis][at[axis]] - 0.5 + low) & (
                index <= windows.starts[axis][at[axis]] + 15.5 - high
            )
            ends = (index - d < -0.5) | (index + d > shape[axis] - 0.5)
            assert not (inside & ends).any()
    assert (cuts[1:-1, 1:-1, 1:-1] == 0).all()


def test_cuts_halve_the_error_at_the_faces(particle_pair, uniform_flow, monkeypatch):
    """Where deformation reaches beyond the volume, one window would end early and pull the peak to zero."""
    pairs = []
    for seed, shift in enumerate([(3.6, -3.4, 3.7), (-3.4, 3.5, 3.3), (3.5, 3.6, -3.6)]):
        pairs.append((particle_pair((64, 64, 64), uniform_flow(shift), 10 / 32**3, seed=seed), shift))

    def noise_and_pull():
        error = np.stack([(measure(*pair, CUBES).raw.T - shift) * np.sign(shift) for pair, shift in pairs])
        return np.sqrt((error**2).mean()), -error.mean()

    noise, pull = noise_and_pull()
    monkeypatch.setattr(window_pass, "window_cuts", lambda windows, *_: np.zeros((*windows.shape, 3, 2)))
    noise_without, pull_without = noise_and_pull()
    assert noise < 0.6 * noise_without
    assert abs(pull) < 0.5 * pull_without


@pytest.mark.full
def test_ghosts_and_lost_particles_count_less(particle_pair, uniform_flow):
    shifts = (1.3, -2.4, 0.6), (-0.4, 3.1, 2.2), (0.7, 1.2, -1.6), (2.1, 0.4, 0.9)
    rms = []
    for power in (0.0, 4.0):
        settings = CorrelationSettings(windows=((32, 32, 32),), agreement=power)
        error = []
        for seed, shift in enumerate(shifts):
            pair = particle_pair((80, 96, 96), uniform_flow(shift), 10 / 32**3, seed=seed, lost=0.3, ghosts=0.3)
            error.append(measure(*pair, settings).displacement - np.reshape(shift, (3, 1, 1, 1)))
        rms.append(np.sqrt(np.mean(np.square(error))))
    assert rms[1] < 0.7 * rms[0]


def test_first_pass_is_rarely_wrong_with_ghosts(particle_pair, uniform_flow):
    """Looked for on the normalised correlation, a quarter of the peaks would be chance ones at the search border."""
    shift = (1.3, -2.4, 0.6)
    pair = particle_pair((80, 96, 96), uniform_flow(shift), 10 / 32**3, seed=4, lost=0.3, ghosts=0.3)
    windows = window_grid((80, 96, 96), (32, 32, 32), 0.5)
    found = correlation_pass(*pair, windows, None, CUBES, CUBES.search).displacement
    assert (np.abs(found - np.reshape(shift, (3, 1, 1, 1))) > 2).any(0).mean() < 0.08


def test_rotation_with_the_shear_of_a_deep_volume(particle_pair):
    """Solid-body rotation: 0.18 voxel per voxel of depth, a shear of 2.9 voxels inside a window; noisy, long blobs."""
    shape = (64, 128, 160)
    centre = (np.array(shape[::-1]) - 1) / 2

    def flow(p):
        q = p - centre
        return np.stack([0.18 * q[:, 2], np.full(len(p), 2.9), -0.0089 * q[:, 0]], -1)

    pair = particle_pair(
        shape, flow, 36 / 65536, (0.7, 0.7, 1.3), seed=1, lost=0.1, ghosts=0.2, jitter=(0.15, 0.15, 0.35)
    )
    settings = CorrelationSettings(windows=((96, 96, 32), (64, 64, 16)))
    field = measure(*pair, settings)
    error = field.raw - at_centres(flow, field)
    assert field.valid.mean() > 0.97
    assert (np.abs(error) < 1).all()
    assert (np.sqrt((error**2).mean((1, 2, 3))) < (0.1, 0.1, 0.2)).all()
    slope = np.polyfit(field.z, field.raw[0].mean((1, 2)), 1)[0]
    assert slope == pytest.approx(0.18, rel=0.02)

    # one pass without deformation loses the gradient's particles: the loop must be better
    single = correlation_pass(*pair, window_grid(shape, (64, 64, 16), 0.5), None, settings, 0.375)
    assert np.median(np.abs(single.displacement - at_centres(flow, field))[0]) > 2 * np.median(np.abs(error)[0])


@pytest.mark.parametrize(("windows_per_wave", "least"), [(2, 0.68), (3, 0.86), (4, 0.93)])
def test_amplitude_of_a_wave_beats_a_plain_average_over_the_window(particle_pair, windows_per_wave, least):
    """A window that averages sees sinc(1/wavelength) = 0.64, 0.83, 0.90 of a sinusoidal shear; deformation more."""

    def wave(y):
        return np.sin(2 * np.pi * y / (windows_per_wave * 32))

    pair = particle_pair(
        (32, 192, 96),
        lambda p: np.stack([1.5 * wave(p[:, 1]), 0 * p[:, 0], 0 * p[:, 0]], -1),
        36 / (32 * 32 * 16),
        seed=3,
    )
    windows = (48, 48, 32), (32, 32, 16)
    field = measure(*pair, CorrelationSettings(windows, inner_window=windows[-1], fine_passes=3))
    shape = wave(field.y)[:, None]
    amplitude = (field.raw[0] * shape).sum() / (np.broadcast_to(shape**2, field.raw[0].shape).sum() * 1.5)
    assert least < amplitude < 1.05
    assert amplitude > np.sinc(1 / windows_per_wave)


@pytest.fixture(scope="module")
def small_pair(particle_pair, uniform_flow):
    return particle_pair((40, 48, 56), uniform_flow((1.2, -0.7, 0.6)), 10 / 24**3, seed=8)


SMALL = CorrelationSettings(windows=((32, 32, 24), (24, 24, 16)))


def test_sparse_and_dense_volumes_give_the_same(small_pair):
    sparse = []
    for v in small_pair:
        lit = v.values > 0
        s = SparseVolume.from_mask(v.grid, lit)
        sparse.append(s.with_values(v.values[lit]))
    one, other = measure(*small_pair, SMALL), measure(*sparse, SMALL)
    np.testing.assert_array_equal(one.displacement, other.displacement)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="needs two threads")
def test_threads_change_nothing(small_pair):
    before = numba.get_num_threads()
    try:
        fields = []
        for threads in (1, 2):
            numba.set_num_threads(threads)
            fields.append(measure(*small_pair, SMALL))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(fields[0].raw, fields[1].raw)
    np.testing.assert_array_equal(fields[0].peak_ratio, fields[1].peak_ratio)


def test_planes_are_asked_for_in_slabs(small_pair):
    class Watched:
        def __init__(self, volume):
            self.grid, self.volume, self.most = volume.grid, volume, 0

        def slab(self, lo, hi):
            self.most = max(self.most, hi - lo)
            return self.volume.slab(lo, hi)

    pair = [Watched(v) for v in small_pair]
    measure(*pair, CorrelationSettings(windows=((32, 32, 16),), intensity_exponent=1.0))
    assert max(v.most for v in pair) <= 16 + 2 * 5  # a window, and what its offset of up to two voxels reaches


def test_dark_windows_are_replaced_and_the_rest_is_measured(particle_pair, uniform_flow):
    pair = particle_pair((32, 32, 128), uniform_flow((1.0, 0.5, -0.5)), 20 / 32**3, seed=9)
    for v in pair:
        v.values[:, :, 79:] = 0  # blended, the light ends where a window begins
    field = measure(*pair, CUBES)
    assert not field.valid[..., -1].any()
    assert field.valid[..., 0].all()
    assert np.isfinite(field.displacement).all()
    assert np.isfinite(field.raw).all()
    # continued from windows that the cut crosses, which see it in both volumes: 0.5 voxel is what one can ask
    np.testing.assert_allclose(field.displacement[..., -1], np.reshape([1.0, 0.5, -0.5], (3, 1, 1)), atol=0.5)


def test_a_window_half_a_voxel_off_its_neighbours_is_not_believed(particle_pair):
    """Particles of one window of 27 move half a voxel further than all others, along each axis in turn. What windows
    scatter by is a twentieth of that, so a measurement of this accuracy has to notice; the vector put in its place is
    its neighbours'."""
    everywhere, further = np.array([1.3, -0.7, 0.4]), 0.5
    settings = CorrelationSettings(windows=((24, 24, 24),), inner_window=(24, 24, 24), overlap=0.0)
    for axis in range(3):

        def flow(points, axis=axis):
            moved = np.tile(everywhere, (len(points), 1))
            inside = (np.abs(points - 35.5) < 12).all(1)  # the window in the middle of 72 voxels
            moved[inside, axis] += further
            return moved

        field = measure(*particle_pair((72, 72, 72), flow, 40 / 24**3, seed=20 + axis), settings)
        error = field.raw - everywhere.reshape(3, 1, 1, 1)
        others = np.ones((3, 3, 3), bool)
        others[1, 1, 1] = False
        assert error[:, others].std() < 0.05
        assert error[axis, 1, 1, 1] == pytest.approx(further, abs=0.1)
        assert not field.valid[1, 1, 1]
        assert field.valid[others].mean() > 0.9
        np.testing.assert_allclose(field.displacement[:, 1, 1, 1], everywhere, atol=0.1)


def test_no_light_at_all_is_an_error():
    grid = VoxelGrid((0.0,) * 3, (1.0,) * 3, (32, 32, 32))
    dark = DenseVolume(grid, np.zeros(grid.shape, np.float32))
    with pytest.raises(PlenoPIVError, match="particles"):
        measure(dark, dark, CUBES)


def test_volumes_of_different_grids_are_refused():
    one, other = (VoxelGrid((0.0,) * 3, (d,) * 3, (32, 32, 32)) for d in (1.0, 2.0))
    dark = np.zeros(one.shape, np.float32)
    with pytest.raises(PlenoPIVError, match="differ in grid"):
        measure(DenseVolume(one, dark), DenseVolume(other, dark), CUBES)


def test_far_displacement_warns(particle_pair, uniform_flow):
    pair = particle_pair((32, 48, 64), uniform_flow((10.5, 0.0, 0.0)), 30 / 32**3, seed=2)
    with pytest.warns(PlenoPIVWarning, match=r"along x reaches 1\d\.\d voxels, more than a quarter"):
        field = measure(*pair, CUBES)
    assert np.median(field.displacement[0]) == pytest.approx(10.5, abs=0.1)


def test_progress_counts_every_layer(small_pair):
    told = []
    measure(*small_pair, SMALL, lambda what, done, total: told.append((what, done, total)))
    assert told[0] == ("correlation pass 1 of 4", 1, 2)
    layers = window_grid((40, 48, 56), SMALL.sub_window, SMALL.inner_overlap).shape[0]
    assert told[-1] == ("correlation pass 4 of 4", layers, layers)


def test_volumes_that_have_nothing_in_common_give_a_field_that_says_so(particle_pair, uniform_flow):
    """A few windows that all disagree, none of them valid in one of the passes."""
    settings = CorrelationSettings(windows=((24, 24, 24),), inner_window=(24, 24, 24), outlier_threshold=0.5)
    a, _ = particle_pair((48, 48, 48), uniform_flow((0, 0, 0)), 10 / 32**3, (1.0, 1.0, 1.0), seed=1)
    b, _ = particle_pair((48, 48, 48), uniform_flow((0, 0, 0)), 10 / 32**3, (1.0, 1.0, 1.0), seed=2)
    field = measure(a, b, replace(settings, outlier_floor_voxels=1e-3))
    assert field.valid.mean() < 0.3
    assert np.isfinite(field.displacement).all()
    assert np.isfinite(field.std).all()


def test_without_a_valid_vector_all_are_the_median_of_those_measured():
    displacement = np.random.default_rng(1).normal(0, 9, (3, 2, 2, 2))
    found = np.ones((2, 2, 2), bool)
    found[0, 0, 0] = False
    result = window_pass.PassResult(displacement, found, np.ones((2, 2, 2), np.float32))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(validation, "find_outliers", lambda d, measured, *_: measured)
        valid, replaced = multigrid._validated(result, CUBES)
    assert not valid.any()
    expected = np.median(displacement.reshape(3, 8)[:, 1:], axis=1)
    np.testing.assert_array_equal(replaced, np.broadcast_to(expected[:, None, None, None], displacement.shape))
