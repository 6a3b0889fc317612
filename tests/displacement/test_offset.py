"""Windows offset by whole voxels: against direct sums, for signs, and for what cut particles do."""

import numpy as np
import pytest
from oracles.quadratic_peak import maximum_about
from scipy.ndimage import gaussian_filter

from plenopiv.displacement.offset import discrete_offset
from plenopiv.displacement.offset_kernels import BESIDE, STEPS, correlations, refine
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

WINDOW = (24, 24, 24)


def slow_correlation(a, b, at, to, size, shift):
    """C(d) as the module's text has it, in plain NumPy."""
    one = a[tuple(slice(s, s + n) for s, n in zip(at, size, strict=True))].astype(float)
    two = b[tuple(slice(s + d, s + d + n) for s, d, n in zip(to, shift, size, strict=True))].astype(float)
    return ((one - one.mean()) * two).sum() / np.sqrt(((two - two.mean()) ** 2).sum())


@pytest.mark.parametrize("size", [(5, 8, 21), (8, 5, 16)])
def test_correlations_are_the_direct_sums(size):
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 14, 15, 30)).astype(np.float32)
    at, to, c = np.array([1, 4, 2]), np.array([3, 2, 5]), np.empty(BESIDE)
    correlations(a, b, at, to, size, c)
    np.testing.assert_allclose(c, [slow_correlation(a, b, at, to, size, s) for s in STEPS], rtol=1e-4, atol=1e-5)


def test_a_window_of_three_lengths_is_found_by_its_own_voxels():
    """The vector is the maximum of the quadratic through the logarithms of the direct sums over just the window, which
    is longest along x."""
    rng, size, whole = np.random.default_rng(1), np.array([7, 9, 13]), np.array([1, -2, 3])
    a = gaussian_filter(rng.random((20, 24, 32)), 1.0).astype(np.float32)
    b = (np.roll(a, whole, (0, 1, 2)) + 0.02 * rng.random(a.shape)).astype(np.float32)
    corner, vectors, again = np.array([[6, 8, 9]]), whole[None, ::-1].astype(float), np.zeros(1, bool)
    refine(a, b, corner, size, vectors, again)
    at = corner[0] - whole // 2

    expected = maximum_about(lambda d: slow_correlation(a, b, at, at, size, d), whole)
    assert again.all()
    np.testing.assert_allclose(vectors[0], expected[::-1], atol=1e-4)


def test_slanted_particles_are_displaced_along_their_own_axis():
    """Off the camera's axis particles lie along lines of sight, .6 voxel aside in each plane here: fits along the axes
    alone have a third of a voxel of x in z."""
    rng, moved = np.random.default_rng(5), np.array([0.4, 0.3, -0.4])  # z, y, x
    a, b = np.zeros((2, 40, 40, 48), np.float32)
    z, y, x = np.mgrid[:40, :40, :48].astype(np.float32)
    for place in rng.uniform(-4.0, [44.0, 44.0, 52.0], (250, 3)):
        for volume, side in ((a, -0.5), (b, 0.5)):
            pz, py, px = place + side * moved
            along = z - pz
            volume += np.exp(-((along / 2.5) ** 2 + ((y - py) / 1.2) ** 2 + ((x - px - 0.6 * along) / 1.2) ** 2) / 2)
    windows = window_grid(a.shape, (32, 32, 32), 0.5)
    volumes = (SparseVolume.of(DenseVolume(VoxelGrid((0, 0, 0), (1, 1, 1), a.shape), each)) for each in (a, b))
    found, again = discrete_offset(*volumes, windows, np.zeros((3, *windows.shape)))
    assert again.all()
    np.testing.assert_allclose(found.mean((1, 2, 3)), moved[::-1], atol=0.06)


@pytest.mark.parametrize("shift", [(3.3, 0.0, 0.0), (0.0, -2.6, 0.0), (0.0, 0.0, 1.45), (-1.2, 2.7, 0.4)])
def test_each_axis_and_sign(particle_pair, uniform_flow, shift):
    a, b = particle_pair((48, 56, 64), uniform_flow(shift), 12 / 24**3, seed=1)
    windows = window_grid(a.grid.shape, WINDOW, 0.5)
    roughly = np.broadcast_to(np.reshape(np.rint(shift), (3, 1, 1, 1)), (3, *windows.shape))
    found, again = discrete_offset(a, b, windows, roughly)
    assert again.all()
    error = found - np.reshape(shift, (3, 1, 1, 1))
    assert np.sqrt((error**2).mean()) < 0.03
    assert np.abs(error.mean((1, 2, 3))).max() < 0.02  # of some ten independent windows


def test_a_first_guess_may_be_off_by_a_voxel_on_two_axes(particle_pair, uniform_flow):
    a, b = particle_pair((48, 48, 48), uniform_flow((2.2, -1.1, 0.3)), 12 / 24**3, seed=2)
    windows = window_grid(a.grid.shape, WINDOW, 0.5)
    guess = np.broadcast_to(np.reshape([1.0, 0.0, 0.0], (3, 1, 1, 1)), (3, *windows.shape))
    found, again = discrete_offset(a, b, windows, guess)
    assert again.all()
    assert np.abs(found - np.reshape([2.2, -1.1, 0.3], (3, 1, 1, 1))).max() < 0.2


def test_windows_without_light_or_room_keep_their_vectors(particle_pair, uniform_flow):
    a, b = particle_pair((32, 32, 48), uniform_flow((1.0, 0.0, 0.0)), 12 / 24**3, seed=3)
    for volume in (a, b):
        volume.values[:, :, 20:] = 0
    windows = window_grid(a.grid.shape, WINDOW, 0.5)
    first = np.zeros((3, *windows.shape))
    first[0] = 0.75
    found, again = discrete_offset(a, b, windows, first)
    assert not again[..., -1].any()
    assert (found[0, ..., -1] == 0.75).all()
    first[2] = 40.0  # beyond the volume
    found, again = discrete_offset(a, b, windows, first)
    assert not again.any()
    assert (found == first).all()


def test_sparse_volumes_give_the_same(particle_pair, uniform_flow):
    a, b = particle_pair((32, 40, 48), uniform_flow((1.4, -0.6, 0.2)), 12 / 24**3, seed=4)
    windows = window_grid(a.grid.shape, WINDOW, 0.5)
    first = np.zeros((3, *windows.shape))
    listed = SparseVolume.from_mask(a.grid, a.values > 0)
    listed = listed.with_values(a.values[a.values > 0])
    assert np.array_equal(discrete_offset(a, b, windows, first)[0], discrete_offset(listed, b, windows, first)[0])
