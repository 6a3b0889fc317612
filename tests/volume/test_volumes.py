"""Voxel grids and the dense and sparse forms of a volume."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.thinning import keeping
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-0.2, 0.3), (0.0, 0.21), (-0.5, 0.5), (0.05, 0.03, 0.1))


def random_volume(seed=0, share=0.2):
    rng = np.random.default_rng(seed)
    mask = rng.random(GRID.shape) < share
    mask[2] = False
    volume = SparseVolume.from_mask(GRID, mask)
    return mask, volume.with_values(rng.random(volume.column.size).astype(np.float32) + 0.1)


def test_covering_counts_and_centres_voxels():
    assert GRID.shape == (10, 7, 10)
    assert GRID.size == 700
    for (lo, hi), want in zip(GRID.limits_mm(), ((-0.2, 0.3), (0.0, 0.21), (-0.5, 0.5)), strict=True):
        assert (lo, hi) == pytest.approx(want)
    x, y, z = GRID.axes()
    assert (x.size, y.size, z.size) == (10, 7, 10)
    assert x[0] == pytest.approx(-0.175)
    assert np.diff(z) == pytest.approx(np.full(9, 0.1))


def test_covering_an_interval_that_voxels_do_not_divide():
    grid = VoxelGrid.covering((0, 1), (0, 1), (-2, 2), (0.3, 0.5, 0.0769))
    assert grid.shape == (53, 2, 4)  # ceil(52.02); 0.5 divides 1; ceil(3.33)
    assert grid.limits_mm()[0] == pytest.approx((-0.1, 1.1))  # centred on the interval
    assert VoxelGrid.covering((0, 0.7 + 1e-9), (0, 1), (0, 1), (0.1, 1, 1)).shape[2] == 7  # not 8 for a rounding


def test_sparse_and_dense_are_the_same_volume():
    mask, volume = random_volume()
    np.testing.assert_array_equal(volume.mask(), mask)
    want = np.zeros(GRID.shape, np.float32)
    want[mask] = volume.values
    np.testing.assert_array_equal(volume.dense().values, want)
    assert volume.occupancy == pytest.approx(mask.mean())
    again = SparseVolume.from_mask(GRID, want > 0).with_values(want[want > 0])
    np.testing.assert_array_equal(again.row_start, volume.row_start)
    np.testing.assert_array_equal(again.column, volume.column)


@pytest.mark.parametrize(
    ("lo", "hi"), [(0, 10), (3, 4), (-2, 3), (8, 13), (-5, 0), (10, 12), (-3, 14), (12, 15), (-6, -2)]
)
def test_slabs_reach_beyond_the_volume_with_zeros(lo, hi):
    _, volume = random_volume()
    dense = volume.dense()
    want = np.zeros((hi - lo, *GRID.shape[1:]), np.float32)
    for k in range(max(lo, 0), min(hi, GRID.shape[0])):
        want[k - lo] = dense.values[k]
    np.testing.assert_array_equal(volume.slab(lo, hi), want)
    np.testing.assert_array_equal(DenseVolume(GRID, dense.values).slab(lo, hi), want)


def test_keeping_drops_voxels_and_no_others():
    _, volume = random_volume()
    keep = volume.values > 0.6
    fewer = keeping(volume, keep)
    want = volume.dense().values.copy()
    want[want <= 0.6] = 0
    np.testing.assert_array_equal(fewer.dense().values, want)
    assert fewer.row_start[-1] == fewer.column.size == keep.sum()
    none = keeping(volume, np.zeros(volume.column.size, bool))
    assert none.column.size == 0
    assert not none.dense().values.any()


def test_columns_ascend_within_rows():
    _, volume = random_volume()
    for row in range(volume.row_start.size - 1):
        column = volume.column[volume.row_start[row] : volume.row_start[row + 1]].astype(int)
        assert (np.diff(column) > 0).all()


def test_rows_and_their_stack():
    _, volume = random_volume()
    parts = [volume.y_range(*part) for part in ((0, 3), (3, 4), (4, 7))]
    for part, (low, high) in zip(parts, ((0, 3), (3, 4), (4, 7)), strict=True):
        np.testing.assert_array_equal(part.dense().values, volume.dense().values[:, low:high])
        np.testing.assert_allclose(part.grid.axes()[1], GRID.axes()[1][low:high])
        assert part.grid.axes()[2][0] == GRID.axes()[2][0]
    again = SparseVolume.stacked(GRID, parts)
    for name in ("row_start", "column", "values"):
        np.testing.assert_array_equal(getattr(again, name), getattr(volume, name))
        assert getattr(again, name).dtype == getattr(volume, name).dtype


def test_grids_agree_but_for_rounding():
    grid = VoxelGrid((0.1, -0.2, 0.3), (0.02, 0.03, 0.1), (30, 20, 10))
    off = np.nextafter(0.3, 1.0)
    assert grid.agrees_with(VoxelGrid((0.1, -0.2, off), (0.02, 0.03, 0.1), (30, 20, 10)))
    for other in (
        VoxelGrid((0.1, -0.2, 0.3 + 1e-6), (0.02, 0.03, 0.1), (30, 20, 10)),
        VoxelGrid((0.1, -0.2, 0.3), (0.02, 0.03, 0.1 + 1e-8), (30, 20, 10)),
        VoxelGrid((0.1, -0.2, 0.3), (0.02, 0.03, 0.1), (30, 20, 11)),
    ):
        assert not grid.agrees_with(other)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("x_mm", (0.5, -0.5), r"volume.x_mm: \[0.5, -0.5\] holds no voxel of 0.02 mm; give the lower limit, then the"),
        ("y_mm", (0.5, 0.5), r"volume.y_mm: \[0.5, 0.5\] holds no voxel"),
        ("z_mm", (0.5, 0.5 + 1e-9), "volume.z_mm: .* holds no voxel of 0.08 mm"),
        ("z_mm", (np.nan, 0.5), r"volume.z_mm: \[nan, 0.5\] holds no voxel"),
        ("z_mm", (-np.inf, 0.5), r"volume.z_mm: \[-inf, 0.5\] holds no voxel"),
        ("voxel_mm", (0.02, 0.0, 0.08), "volume.voxel_mm: 0.0 along y; give a positive number of mm"),
        ("voxel_mm", (-0.02, 0.02, 0.08), "volume.voxel_mm: -0.02 along x"),
        ("voxel_mm", (0.02, 0.02, np.nan), "volume.voxel_mm: nan along z"),
    ],
)
def test_limits_without_a_voxel_are_refused(key, value, message):
    good = {"x_mm": (-0.5, 0.5), "y_mm": (-0.4, 0.4), "z_mm": (0.5, 2.0), "voxel_mm": (0.02, 0.02, 0.08)}
    with pytest.raises(PlenoPIVError, match=message):
        VoxelGrid.covering(**good | {key: value})


@pytest.mark.parametrize("shape", [(10, 7, 9), (9, 7, 10), (10, 10, 7), (700,)])
def test_values_of_another_shape_than_the_grid_are_refused(shape):
    with pytest.raises(PlenoPIVError, match=r"on a grid of \(10, 7, 10\) voxels .* one value for each voxel"):
        DenseVolume(GRID, np.zeros(shape, np.float32))
    with pytest.raises(PlenoPIVError, match="one value for each voxel"):
        DenseVolume(GRID, np.zeros(GRID.shape, np.float32)).with_values(np.zeros(shape, np.float32))
