"""Sparse and dense kernels say the same, and no result depends on the number of threads."""

import numba
import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.planes import DensePlanes
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


@pytest.mark.parametrize("name", LATTICES)
def test_sparse_is_dense(name, threads):
    """But for a voxel's place, which is rounded, and pixels at the rim, which are rectangles; no light is lost."""
    threads(1)
    where, projector, volume = setting(name, "exact")
    dense = DensePlanes.of(volume)
    views = range(0, projector.views, 3)
    one = np.array([projector.forward(v, volume) for v in views])
    other = np.array([projector.forward(v, dense) for v in views])
    off = (one - other)[where.seen[::3]]
    print(f"\n{name}: rms {np.std(off) / np.std(one):.4f}, sum {other.sum() / one.sum() - 1:+.1e}")
    assert np.std(off) <= 0.1 * np.std(one)  # voxels as large as microlenses, 3 % of them lit
    assert other.sum() == pytest.approx(one.sum(), rel=2e-3)
    assert not one[~where.seen[::3]].any()
    assert not other[~where.seen[::3]].any()


def test_footprints_are_dark_only_where_no_voxel_shines(threads):
    """The map of tiles changes nothing."""
    threads(1)
    _, projector, volume = setting("hexagonal", "exact", share=0.002)
    dense, flagged = DensePlanes.of(volume), DensePlanes.of(volume)
    flagged.tiles[:] = 1
    assert 0 < dense.tiles.mean() < 0.2
    rng = np.random.default_rng(1)
    for view in range(0, projector.views, 7):
        np.testing.assert_array_equal(projector.forward(view, dense), projector.forward(view, flagged))
        image = rng.normal(size=projector.layout.lenses)
        projector.multiply(view, 0.1 * image, dense)
        projector.multiply(view, 0.1 * image, flagged)
        np.testing.assert_array_equal(dense.values, flagged.values)


def test_dense_planes_of_a_volume_and_back():
    _, _, volume = setting("square", "exact")
    dense = DensePlanes.of(volume)
    np.testing.assert_array_equal(dense.inside, volume.dense().values)
    back, faint = dense.listed(), float(np.median(volume.values))
    for name in ("row_start", "column", "values"):
        np.testing.assert_array_equal(getattr(back, name), getattr(volume, name))
    bright = volume.keeping(volume.values > faint)
    assert dense.keep_above(faint) == bright.column.size
    np.testing.assert_array_equal(dense.inside, bright.dense().values)


def test_forms_are_chosen_by_occupancy_and_are_copies():
    _, projector, few = setting("square", "exact", share=0.5 * DENSE_ABOVE)
    working = projector.working_form(few)
    assert isinstance(working, SparseVolume)
    assert not np.shares_memory(working.values, few.values)
    _, projector, many = setting("square", "exact", share=0.5 + 0.5 * DENSE_ABOVE)
    working = projector.working_form(many)
    assert isinstance(working, DensePlanes)
    np.testing.assert_array_equal(working.inside, many.dense().values)
    share = float(np.quantile(many.values, 1 - 0.5 * DENSE_ABOVE) / many.values.mean())
    assert isinstance(projector.thinned(working, 0.1), DensePlanes)
    want = many.keeping(many.values > share * many.values.mean())
    for form in (DensePlanes.of(many), many):
        thinned = projector.thinned(form, share)
        assert isinstance(thinned, SparseVolume)
        np.testing.assert_array_equal(thinned.column, want.column)
        np.testing.assert_array_equal(thinned.values, want.values)
    _, rays, _ = setting("square", "1-ray")
    assert isinstance(rays.working_form(many), SparseVolume)


@pytest.mark.parametrize("name", ["square, 1 deg", "hexagonal"])
def test_results_do_not_depend_on_threads(name, threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    where, projector, volume = setting(name, "exact")
    dense = DensePlanes.of(volume)
    rng = np.random.default_rng(3)
    image = rng.normal(size=where.lenses).astype(np.float32)
    bound = rng.uniform(0.0, 100.0, where.seen.shape).astype(np.float32)
    found = []
    for count in (1, 2):
        threads(count)
        back, product = DensePlanes.empty(GRID), DensePlanes.of(volume)
        projector.adjoint(20, image, back)
        projector.multiply(20, 0.1 * image, product)
        found.append(
            [
                projector.forward(20, volume),
                projector.forward(20, dense),
                projector.gather(20, image, volume),
                back.values,
                product.values,
                projector.voxels_within(bound, 2000.0).column,
            ]
        )
    assert 0 < found[0][-1].size < GRID.size
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)
