"""Maps and polygons say the same, and no result depends on the number of threads."""

import numba
import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.plane_maps.kernels import workspace_size
from plenopiv.projection.plenoptic.projector import PlenopticProjector
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
    return where, PlenopticProjector(where, GRID, rule), volume


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.mark.parametrize(
    ("across", "limit", "lost"), [(40.0, 0.04, 1e-3), pytest.param(None, 0.2, 0.02, id="7.0-0.2-0.02")]
)
@pytest.mark.parametrize("name", LATTICES)
def test_maps_are_polygons(name, across, limit, lost, threads):
    """But for what they interpolate, the less the more points they have, and pixels at the rim. Voxels of half a
    microlens, 3 % of them lit."""
    threads(1)
    where, polygons, volume = setting(name, "polygons")
    mapped = PlenopticProjector(where, GRID, "exact", **({} if across is None else {"across": across}))
    views = range(0, polygons.views, 3)
    one = np.array([polygons.forward(v, volume) for v in views])
    other = np.array([mapped.forward(v, volume) for v in views])
    off = (one - other)[where.seen[::3]]
    print(f"\n{name}: rms {np.std(off) / np.std(one):.4f}, sum {other.sum() / one.sum() - 1:+.1e}")
    assert np.std(off) <= limit * np.std(one)
    assert other.sum() == pytest.approx(one.sum(), rel=lost)
    assert not one[~where.seen[::3]].any()
    assert not other[~where.seen[::3]].any()


@pytest.mark.parametrize("strip", [1, 1 << 12, 1 << 30])
def test_strips_change_nothing_but_rounding(strip, threads, monkeypatch):
    """From the lowest that hold one row of voxels to whole planes, with maps finer and coarser than the voxels."""
    threads(1)
    fine = VoxelGrid.covering((-0.2, 0.2), (-0.3, 0.3), (-9.0, 9.0), (0.01, 0.01, 1.8))
    where = layout(small_camera("hexagonal", pmr=8, rotation_rad=0.01))
    whole = PlenopticProjector(where, fine, "exact")
    shape = whole.images.maps.shape
    assert shape[:, 4].max() > 1
    assert shape[:, 5].max() > 0
    cut = PlenopticProjector(where, fine, "exact")
    cut.images.workspace = workspace_size(shape, strip)
    rng = np.random.default_rng(4)
    volume = SparseVolume.from_mask(fine, rng.random(fine.shape) < 0.05)
    volume = volume.with_values(rng.random(volume.column.size).astype(np.float32))
    for view in (0, whole.views // 2, whole.views - 1):
        image = rng.normal(size=where.lenses).astype(np.float32)
        one, other = (p.forward(view, volume) for p in (whole, cut))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6 * one.max())
        one, other = (p.gather(view, image, volume) for p in (whole, cut))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6 * np.abs(one).max())


@pytest.mark.parametrize("name", ["square, 1 deg", "hexagonal"])
def test_results_do_not_depend_on_threads(name, threads):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    where, projector, volume = setting(name, "exact")
    polygons = PlenopticProjector(where, GRID, "polygons")
    rng = np.random.default_rng(3)
    image = rng.normal(size=where.lenses).astype(np.float32)
    bound = rng.uniform(0.0, 100.0, where.seen.shape).astype(np.float32)
    found = []
    for count in (1, 2):
        threads(count)
        product = volume.with_values(volume.values.copy())
        projector.multiply(20, 0.1 * image, product)
        found.append(
            [
                projector.forward(20, volume),
                projector.gather(20, image, volume),
                product.values,
                polygons.forward(20, volume),
                polygons.gather(20, image, volume),
                projector.candidates(bound, 2000.0).column,
            ]
        )
    assert 0 < found[0][-1].size < GRID.size
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("rule", ["exact", "polygons"])
@pytest.mark.parametrize("name", ["square", "hexagonal, 5 deg"])
def test_several_views_at_once_are_those_views(name, rule):
    """Images are the same; what they give back to the voxels adds up."""
    _, projector, volume = setting(name, rule)
    views = np.array([20, 3, 11])
    alone = np.array([projector.forward(v, volume) for v in views])
    np.testing.assert_allclose(projector.forward(views, volume), alone, rtol=1e-5, atol=1e-6 * alone.max())
    images = np.random.default_rng(6).standard_normal(alone.shape).astype(np.float32)
    each = sum(projector.gather(v, image, volume) for v, image in zip(views, images, strict=True))
    np.testing.assert_allclose(projector.gather(views, images, volume), each, atol=2e-5 * np.abs(each).max())
