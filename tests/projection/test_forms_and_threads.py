"""Sparse and dense kernels say the same, and no result depends on the number of threads."""

import numba
import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.projector import DENSE_ABOVE, Projector
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-0.41, 0.39), (-0.3, 0.33), (-2.1, 2.0), (0.0385, 0.0385, 0.0385 * 4))
LATTICES = {
    "square": ("square", 0.0, (0.017, -0.006)),
    "square, 1 deg": ("square", 1.0, (0.017, -0.006)),
    "hexagonal": ("hexagonal", 0.0, (0.013, -0.027)),
    "hexagonal, 0.1 deg": ("hexagonal", 0.1, (0.013, -0.027)),
    "hexagonal, 5 deg": ("hexagonal", 5.0, (0.013, -0.027)),
}


def setting(name, rule, share=0.03, seed=0):
    kind, degrees, offset = LATTICES[name]
    where = layout(small_camera(kind, pmr=8, rotation_rad=np.deg2rad(degrees), offset_mm=offset))
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(GRID, rng.random(GRID.shape) < share)
    volume = volume.with_values(rng.random(volume.column.size).astype(np.float32) * 1000)
    return where, Projector(where, GRID, rule), volume


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.mark.parametrize("rule", ["exact", "9-rays", "1-ray"])
@pytest.mark.parametrize("name", LATTICES)
def test_sparse_is_dense(name, rule, threads):
    """To float32 rounding of the brightest pixel."""
    threads(1)
    where, projector, volume = setting(name, rule)
    dense = projector.allocate()
    dense[:, :, : GRID.shape[2]] = volume.dense().values
    views = range(0, projector.views, 3)
    one = np.array([projector.forward(v, volume) for v in views])
    other = np.array([projector.forward(v, dense) for v in views])
    assert np.abs(one - other).max() <= 2e-5 * one.max()
    assert not one[~where.seen[::3]].any()


def test_forms_are_chosen_by_occupancy_and_are_copies():
    _, projector, volume = setting("square", "exact", share=0.5 * DENSE_ABOVE)
    working = projector.working_form(volume)
    assert volume.occupancy < DENSE_ABOVE
    assert isinstance(working, SparseVolume)
    assert not np.shares_memory(working.values, volume.values)
    _, projector, volume = setting("square", "exact", share=0.5 + 0.5 * DENSE_ABOVE)
    working = projector.working_form(volume)
    assert isinstance(working, np.ndarray)
    np.testing.assert_array_equal(working[:, :, : GRID.shape[2]], volume.dense().values)
    faint = float(np.median(volume.values))
    back = projector.listed(working, faint)
    want = volume.keeping(volume.values > faint)
    np.testing.assert_array_equal(back.row_start, want.row_start)
    np.testing.assert_array_equal(back.column, want.column)
    np.testing.assert_array_equal(back.values, want.values)


@pytest.mark.parametrize("name", ["square, 1 deg", "hexagonal"])
def test_results_do_not_depend_on_threads(name, threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    where, projector, volume = setting(name, "exact")
    dense = projector.allocate()
    dense[:, :, : GRID.shape[2]] = volume.dense().values
    rng = np.random.default_rng(3)
    image = rng.normal(size=where.lenses).astype(np.float32)
    bound = rng.uniform(0.0, 100.0, where.seen.shape).astype(np.float32)
    found = []
    for count in (1, 2):
        threads(count)
        back, product = projector.allocate(), dense.copy()
        projector.adjoint(20, image, back)
        projector.multiply(20, 0.1 * image, product)
        found.append(
            [
                projector.forward(20, volume),
                projector.forward(20, dense),
                projector.gather(20, image, volume),
                back,
                product,
                projector.voxels_within(bound, 2000.0).column,
            ]
        )
    assert 0 < found[0][-1].size < GRID.size
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)
