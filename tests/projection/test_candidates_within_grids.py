"""Dense ray tracing rules voxels out by where they are, whatever grid they are in and however the lattice is turned."""

from dataclasses import replace
from itertools import product
from math import radians

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.candidates.rule import judging_views
from plenopiv.projection.plenoptic.geometry import CameraOnGrid, Plane, planes
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

PARTICLE = 1000.0


def limits(where, share, seed):
    """A random share of the pixels allow up to 3 % of a particle's light, the others any."""
    rng = np.random.default_rng(seed)
    most = rng.uniform(0, 0.03 * PARTICLE, where.seen.shape)
    return np.where(rng.random(most.shape) < share, most, np.inf).astype(np.float32)


@pytest.mark.parametrize(("columns", "rows"), [((40, 52), (0, 40)), ((10, 20), (7, 29)), ((61, 90), (3, 5))])
def test_a_part_of_a_grid_has_the_candidates_of_the_whole(columns, rows):
    """Voxels so fine that footprints reach twenty beyond the part's faces, on all sides."""
    where = layout(small_camera("hexagonal", pmr=8, microlenses=(9, 8)))
    whole = VoxelGrid((-0.09, -0.04, -2.4), (0.002, 0.002, 0.3), (3, 40, 90))
    (left, right), (low, high) = columns, rows
    first = (whole.first_mm[0] + 0.002 * left, whole.first_mm[1] + 0.002 * low, whole.first_mm[2])
    part = VoxelGrid(first, whole.voxel_mm, (3, high - low, right - left))
    for seed, share in enumerate((0.1, 0.06)):
        most = limits(where, share, seed)
        all_of_them = PlenopticProjector(where, whole).candidates(most, PARTICLE).mask()
        found = PlenopticProjector(where, part).candidates(most, PARTICLE).mask()
        assert 0.2 < all_of_them.mean() < 0.95
        np.testing.assert_array_equal(found, all_of_them[:, low:high, left:right])


def least_light(where, grid, size):
    """Least light (voxel, view, lens) that each pixel gets of a particle anywhere in ``size`` times a voxel."""
    x, y, z = grid.axes()
    centres = [(px, py, pz) for pz in z for py in y for px in x]
    steps = [(0, 0, 0), *product((-0.5, 0.5), repeat=3)]
    place = [[np.add(c, np.multiply(size, np.multiply(s, grid.voxel_mm))) for s in steps] for c in centres]
    return np.array([np.min([exact_light(where, at) for at in places], 0) for places in place])


@pytest.mark.parametrize(
    ("kind", "turn_deg"),
    [
        ("hexagonal", 90.0),
        ("square", 3.0),
        pytest.param("hexagonal", 3.0, marks=pytest.mark.full),
        pytest.param("square", 90.0, marks=pytest.mark.full),
    ],
)
def test_voxels_of_turned_lattices_are_ruled_out_as_a_whole(kind, turn_deg):
    """Whatever is dropped is ruled out all over the voxel, and what is ruled out all over one a little larger is
    dropped. Voxels are twice as wide along y, so that their sides must not be exchanged, and deep."""
    camera = small_camera(kind, pmr=8, microlenses=(9, 8), rotation_rad=radians(turn_deg), offset_mm=(0.007, -0.004))
    where = layout(camera)
    inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= camera.aperture_radius_px
    where = replace(where, seen=where.seen & inner[:, None])
    grid = VoxelGrid((-0.0261, -0.0183, -2.4), (0.011, 0.022, 0.11), (2, 2, 2))
    voxel, larger = least_light(where, grid, (0.97, 0.97, 0.97)), least_light(where, grid, (1.25, 1.25, 1.25))
    light = planes(where.camera, grid)[:, Plane._fields.index("light")].astype(float)
    clearly = np.repeat(light, grid.shape[1] * grid.shape[2])[:, None, None] * 0.1
    asked = np.isin(np.arange(where.views), judging_views(CameraOnGrid(where, grid)))
    projector, dropped = PlenopticProjector(where, grid), []
    for seed in range(30):
        most = np.where(asked[:, None], limits(where, 0.1, seed), np.inf).astype(np.float32)
        kept = projector.candidates(most, PARTICLE).mask().ravel()
        for_sure = ((voxel * PARTICLE > most) & (voxel > 0)).any((1, 2))
        too_large = ((larger * PARTICLE > most) & (larger > clearly)).any((1, 2))
        assert not (~kept & ~for_sure).any()
        assert not (kept & too_large).any()
        dropped.append(~kept)
    assert 0.1 < np.mean(dropped) < 0.95
