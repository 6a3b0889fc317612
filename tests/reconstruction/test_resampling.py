"""A volume of lens space on the laboratory's grid: where its light goes."""

from itertools import product
from math import floor

import numba
import numpy as np
import pytest

from plenopiv.cameras.space_map import Polynomial
from plenopiv.reconstruction import resampling
from plenopiv.reconstruction.resampling import resampled
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-0.2, 0.3), (0.0, 0.21), (-0.5, 0.5), (0.05, 0.03, 0.1))  # 10 x 7 x 10 voxels


def polynomial(function, degree=3, grid=GRID):
    axes = [np.linspace(lo, hi, degree + 2) for lo, hi in grid.limits_mm()]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return Polynomial.fitted(points, function(points), degree)


def moved(x=0.0, y=0.0, z=0.0):
    return polynomial(lambda p: p + np.array([x, y, z]), 1)


def curved(p):
    """Turned about z, sheared, shrunk along z with a curved focal plane."""
    x, y, z = p.T
    return np.stack([x - 0.1 * y + 0.08 * x * z, y + 0.1 * x + 0.05 * z, 0.9 * z + 0.3 * x * x + 0.1 * y], -1)


def some_light(grid=GRID, share=0.2, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(grid, rng.random(grid.shape) < share)
    return volume.with_values(rng.random(volume.values.size).astype(np.float32) + 0.1)


def one_voxel(k, j, i, value=1.0):
    mask = np.zeros(GRID.shape, bool)
    mask[k, j, i] = True
    return SparseVolume.from_mask(GRID, mask, value)


def naive(volume, to_grid, grid):
    """The same in plain Python."""
    out = np.zeros(grid.shape)
    x, y, z = volume.grid.axes()
    for (k, j, i), value in np.ndenumerate(volume.dense().values):
        place = (to_grid([x[i], y[j], z[k]]) - grid.first_mm) / grid.voxel_mm
        base = [floor(p) for p in place]
        for corner in product((0, 1), repeat=3):
            at = [b + c for b, c in zip(base, corner, strict=True)]
            weight = np.prod([1 - abs(p - a) for p, a in zip(place, at, strict=True)])
            if all(0 <= a < n for a, n in zip(at, grid.shape[::-1], strict=True)):
                out[at[2], at[1], at[0]] += weight * value
    return out


def check_order(volume):
    """Rows are whole and their columns ascend."""
    assert volume.row_start.size == volume.grid.shape[0] * volume.grid.shape[1] + 1
    assert volume.row_start[-1] == volume.column.size == volume.values.size
    for low, high in zip(volume.row_start[:-1], volume.row_start[1:], strict=True):
        assert (np.diff(volume.column[low:high].astype(int)) > 0).all()
    assert (volume.values > 0).all()


def test_without_a_difference_the_volume_stays():
    volume = some_light()
    found = resampled(volume, moved(), GRID)
    np.testing.assert_allclose(found.dense().values, volume.dense().values, atol=1e-6)
    assert found.grid == GRID


@pytest.mark.parametrize("together", [1, 3, 16])
def test_a_curved_map_as_in_plain_python(together, monkeypatch):
    monkeypatch.setattr(resampling, "TOGETHER", together)
    volume, map_ = some_light(), polynomial(curved)
    grid = VoxelGrid.covering((-0.25, 0.3), (-0.03, 0.25), (-0.5, 0.45), (0.045, 0.033, 0.09))
    found = resampled(volume, map_, grid)
    check_order(found)
    np.testing.assert_allclose(found.dense().values, naive(volume, map_, grid), atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_half_a_voxel_shares_halves_and_goes_the_right_way(axis, sign):
    step = np.zeros(3)
    step[axis] = 0.5 * sign * GRID.voxel_mm[axis]
    found = resampled(one_voxel(5, 3, 4, 2.0), moved(*step), GRID).dense().values
    expected = np.zeros(GRID.shape)
    at = [5, 3, 4]
    expected[tuple(at)] = 1.0
    at[2 - axis] += sign
    expected[tuple(at)] = 1.0
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_light_and_its_centre_are_kept():
    fine = VoxelGrid.covering((-0.25, 0.35), (-0.05, 0.28), (-0.6, 0.6), (0.04, 0.025, 0.08))
    map_, blob = polynomial(curved), np.zeros(GRID.shape, np.float32)
    blob[3:6, 2:5, 3:6] = np.multiply.outer(np.multiply.outer([1, 2, 1], [1, 2, 1]), [1, 2, 1])
    volume = SparseVolume.from_mask(GRID, blob > 0)
    volume = volume.with_values(blob[blob > 0])
    found = resampled(volume, map_, fine).dense().values
    assert found.sum() == pytest.approx(blob.sum(), rel=1e-6)
    x, y, z = GRID.axes()
    centre = map_([x[4], y[3], z[4]])
    for axis, along, voxel in zip(range(3), fine.axes(), fine.voxel_mm, strict=True):
        weights = found.sum(tuple(a for a in range(3) if a != 2 - axis))
        assert (weights @ along / weights.sum() - centre[axis]) / voxel == pytest.approx(0, abs=0.01)


def test_an_even_light_stays_even_where_voxels_are_nearly_of_one_size():
    source = VoxelGrid.covering((-1, 1), (-1, 1), (-1, 1), (0.05, 0.05, 0.05))
    target = VoxelGrid.covering((-0.8, 0.8), (-0.8, 0.8), (-0.8, 0.8), (0.051, 0.0505, 0.049))
    found = resampled(SparseVolume.from_mask(source, np.ones(source.shape, bool)), moved(), target).dense().values
    assert found.mean() == pytest.approx(0.051 * 0.0505 * 0.049 / 0.05**3, rel=2e-3)
    assert np.ptp(found) / found.mean() < 0.02


def test_what_lies_outside_is_left_out():
    far = resampled(some_light(), moved(x=5.0), GRID)
    assert far.values.size == 0
    check_order(far)
    edge = resampled(one_voxel(0, 0, 0), moved(-0.025, -0.015, -0.05), GRID)
    assert edge.values == pytest.approx([1 / 8])


def test_the_same_bits_on_any_number_of_threads():
    volume, map_ = some_light(share=0.5), polynomial(curved)
    found = []
    for threads in (1, 2):
        before = numba.get_num_threads()
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
        try:
            found.append(resampled(volume, map_, GRID))
        finally:
            numba.set_num_threads(before)
    one, two = found
    np.testing.assert_array_equal(one.row_start, two.row_start)
    np.testing.assert_array_equal(one.column, two.column)
    np.testing.assert_array_equal(one.values, two.values)
