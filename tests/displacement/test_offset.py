"""Windows offset by whole voxels: against direct sums, for signs, and for what cut particles do."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from plenopiv.displacement.offset import discrete_offset
from plenopiv.displacement.offset_kernels import correlations, refine
from plenopiv.displacement.peaks import gaussian_offset
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import SparseVolume

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
    at, to, c = np.array([1, 4, 2]), np.array([3, 2, 5]), np.empty(7)
    correlations(a, b, at, to, size, c)
    shifts = [(0, 0, 0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
    np.testing.assert_allclose(c, [slow_correlation(a, b, at, to, size, s) for s in shifts], rtol=1e-4, atol=1e-5)


def test_a_window_of_three_lengths_is_found_by_its_own_voxels():
    """The vector is the fit to the direct sums over just the window, which is longest along x."""
    rng, size, whole = np.random.default_rng(1), np.array([7, 9, 13]), np.array([1, -2, 3])
    a = gaussian_filter(rng.random((20, 24, 32)), 1.0).astype(np.float32)
    b = (np.roll(a, whole, (0, 1, 2)) + 0.02 * rng.random(a.shape)).astype(np.float32)
    corner, vectors, again = np.array([[6, 8, 9]]), whole[None, ::-1].astype(float), np.zeros(1, bool)
    refine(a, b, corner, size, vectors, again)
    at = corner[0] - whole // 2
    c = [slow_correlation(a, b, at, at + whole, size, step) for step in (np.zeros(3, int), *np.eye(3, dtype=int))]
    before = [slow_correlation(a, b, at, at + whole, size, -step) for step in np.eye(3, dtype=int)]
    expected = [n + gaussian_offset(low, c[0], high) for n, low, high in zip(whole, before, c[1:], strict=True)]
    assert again.all()
    np.testing.assert_allclose(vectors[0], expected[::-1], atol=1e-3)


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
