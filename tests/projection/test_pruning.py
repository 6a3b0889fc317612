"""Dense ray tracing's kernel against direct sums over weights that plain Python computed place by place."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light, ray_light

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.candidates.rule import judging_views
from plenopiv.projection.plenoptic.geometry import CameraOnGrid, Plane, planes
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

PARTICLE = 1000.0
STARTS = (-2.4, -0.25, 1.1)  # far from focus, in the dead zone, between


def grid_at(z):
    return VoxelGrid((-0.0261, -0.0183, z), (0.017, 0.019, 0.08), (2, 1, 3))


def inner_layout(kind):
    camera = small_camera(kind, pmr=8, microlenses=(9, 8), offset_mm=(0.007, -0.004))
    where = layout(camera)
    inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= camera.aperture_radius_px
    return replace(where, seen=where.seen & inner[:, None])


def random_bound(where, seed):
    """One in ten pixels of the views that are asked allows 0 to all of what a pixel can get, the rest anything."""
    rng = np.random.default_rng(seed)
    bound = rng.uniform(0, 0.03 * PARTICLE, where.seen.shape)
    asked = np.isin(np.arange(where.views), judging_views(CameraOnGrid(where, grid_at(STARTS[0]))))
    return np.where((rng.random(bound.shape) < 0.9) | ~asked[:, None], np.inf, bound).astype(np.float32)


def voxels(grid):
    x, y, z = grid.axes()
    return [(px, py, pz) for pz in z for py in y for px in x]


def least_light(where, grid, size):
    """Least light (voxel, view, lens) that each pixel gets of a particle anywhere in ``size`` times a voxel: at its
    corners and in its middle."""
    steps = [(0, 0, 0), *product((-0.5, 0.5), repeat=3)]
    return np.array(
        [
            np.min([exact_light(where, np.add(centre, size * np.multiply(step, grid.voxel_mm))) for step in steps], 0)
            for centre in voxels(grid)
        ]
    )


def ruled_out(weights, where, grid, bound, hardly):
    """Voxels whose light by ``weights`` (voxel, view, lens) exceeds what some one pixel collected that gets more than
    the share ``hardly`` of what a pixel in the middle of the light gets."""
    light = planes(where.camera, grid)[:, Plane._fields.index("light")].astype(float)
    light = np.repeat(light, grid.shape[1] * grid.shape[2])[:, None, None]
    return ((weights * PARTICLE > bound) & (weights > hardly * light)).any((1, 2))


@pytest.mark.parametrize("z", STARTS)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_voxels_are_dropped_if_all_of_the_voxel_is_ruled_out(kind, z):
    """Sandwiched: whatever is dropped is ruled out all over the voxel, and what is ruled out all over a
    voxel half as large again, by pixels that get a tenth of the light, is dropped."""
    where, grid = inner_layout(kind), grid_at(z)
    projector = PlenopticProjector(where, grid, "exact")
    voxel, larger = least_light(where, grid, 0.98), least_light(where, grid, 1.5)
    dropped, surely = [], []
    for seed in range(20):
        bound = random_bound(where, seed)
        kept = projector.candidates(bound, PARTICLE).dense().values.ravel() > 0
        dropped.append(~kept)
        surely.append(ruled_out(larger, where, grid, bound, 0.1))
        assert not (~kept & ~ruled_out(voxel, where, grid, bound, 0.01)).any()
        assert not (kept & surely[-1]).any()
    assert 0.1 < np.mean(dropped) < 0.9 or (z == STARTS[1] and np.any(dropped))  # few pixels share a voxel in focus
    assert np.any(surely) or z == STARTS[1]


@pytest.mark.parametrize(("kind", "z"), [("square", STARTS[0]), ("square", STARTS[2]), ("hexagonal", STARTS[0])])
def test_a_deep_voxel_is_ruled_out_by_its_own_depth(kind, z):
    """Of voxels whose depth moves their light more than their width does: what a pixel on an axis of the aperture rules
    out all over a voxel a seventh deeper is dropped."""
    where, grid = inner_layout(kind), replace(grid_at(z), voxel_mm=(0.017, 0.019, 0.24))
    projector, judging = PlenopticProjector(where, grid, "exact"), judging_views(CameraOnGrid(where, grid_at(z)))
    on_axis = [view for view in judging if (where.offsets[view] == 0).any() and np.abs(where.offsets[view]).max() >= 2]
    least = least_light(where, grid, np.array([1.05, 1.05, 1.15]))
    light = planes(where.camera, grid)[:, Plane._fields.index("light")]
    asked = [place for place in np.argwhere(least > 0.15 * light.min()) if place[1] in on_axis]
    assert len(asked) > 2
    for voxel, view, lens in asked:
        bound = np.full(where.seen.shape, np.inf, np.float32)
        bound[view, lens] = 0.98 * PARTICLE * least[voxel, view, lens]
        assert projector.candidates(bound, PARTICLE).dense().values.ravel()[voxel] == 0


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize(("rule", "rays"), [("1-ray", 1), ("9-rays", 9)])
def test_rays_are_judged_as_they_are(kind, rule, rays):
    where, grid = inner_layout(kind), grid_at(STARTS[0])
    weights = np.array([ray_light(where, place, rays) for place in voxels(grid)])
    projector = PlenopticProjector(where, grid, rule)
    for seed in range(4):
        bound = random_bound(where, seed)
        kept = projector.candidates(bound, PARTICLE).dense().values.ravel() > 0
        np.testing.assert_array_equal(kept, ~ruled_out(weights, where, grid, bound, 0.02))


def test_no_limit_and_no_light():
    where, grid = inner_layout("square"), grid_at(STARTS[2])
    projector = PlenopticProjector(where, grid, "exact")
    nowhere_dark = np.full(where.seen.shape, np.inf, np.float32)
    assert projector.candidates(nowhere_dark, PARTICLE).column.size == grid.size
    assert projector.candidates(np.zeros_like(nowhere_dark), PARTICLE).column.size == 0
    nothing_seen = replace(where, seen=np.zeros_like(where.seen))
    assert PlenopticProjector(nothing_seen, grid).candidates(np.zeros_like(nowhere_dark), 1.0).column.size == grid.size


def test_what_the_middle_of_the_aperture_does_not_see_is_no_candidate():
    camera = small_camera("square", pmr=8)
    where, limit = layout(camera), 0.5 * 13 * camera.lattice.pitch_mm  # 13 microlenses, magnification -1
    grid = VoxelGrid.covering((-1.5 * limit, 1.5 * limit), (-0.02, 0.02), (-3, 3), (0.02, 0.02, 0.5))
    projector = PlenopticProjector(where, grid, "exact")
    no_limit = np.full(where.seen.shape, np.inf, np.float32)
    kept = projector.candidates(no_limit, PARTICLE).dense().values > 0
    x, _, z = grid.axes()
    for k, depth in enumerate(z):
        reach = limit / abs(camera.scale(depth)) / (1 + camera.image_scale)
        np.testing.assert_array_equal(kept[k], np.broadcast_to(np.abs(x) <= reach, kept[k].shape))
    assert not kept.all()
    np.testing.assert_array_equal(projector.visible_voxels().dense().values > 0, kept)
