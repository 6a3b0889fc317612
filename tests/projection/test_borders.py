"""Voxels across borders of microlenses in the plane in focus: ruled out together, never with a particle in them."""

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light

from plenopiv.lattice import Lattice
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide, nearest
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

PARTICLE = 1000.0
KINDS = ("square", "hexagonal")
VOXEL_MM = (0.006, 0.006, 0.04)


def layout_of(kind):
    return layout(small_camera(kind, pmr=8, microlenses=(9, 8), offset_mm=(0.007, -0.004)))


def grid_of(first_z=-0.04):
    """Three planes, the middle one in focus; some microlenses wide."""
    return VoxelGrid((-0.06, -0.06, first_z), VOXEL_MM, (3, 21, 21))


def lens_of(where, x, y):
    """Flat number of the microlens that holds points of the focal plane; magnification is -1 there."""
    i, j = where.camera.lattice.nearest(-x, -y)
    return (j - where.j0) * where.ni + i - where.i0


@pytest.mark.parametrize("kind", KINDS)
def test_a_dark_image_leaves_nothing_in_focus(kind):
    where, grid = layout_of(kind), grid_of()
    kept = PlenopticProjector(where, grid).candidates(np.zeros(where.seen.shape, np.float32), PARTICLE)
    assert kept.column.size == 0
    x, y, _ = grid.axes()
    half = 0.5 * VOXEL_MM[0]
    ends = [lens_of(where, *np.meshgrid(x + a, y + b)) for a in (-half, half) for b in (-half, half)]
    across = np.any([ends[0] != other for other in ends[1:]], axis=0)
    assert 0.1 < across.mean() < 0.6  # there were voxels that no pixel judges by itself


@pytest.mark.parametrize("kind", KINDS)
def test_one_bright_microlens_keeps_the_voxels_that_touch_it(kind):
    where, grid = layout_of(kind), grid_of()
    x, y, _ = grid.axes()
    lit = int(lens_of(where, np.float64(0.03), np.float64(0.025)))
    bound = np.zeros(where.seen.shape, np.float32)
    bound[:, lit] = np.inf
    kept = PlenopticProjector(where, grid).candidates(bound, PARTICLE).dense().values[1] > 0
    steps = np.linspace(-0.4, 0.4, 9) * VOXEL_MM[0]  # by more than float32 leaves open
    touches = np.any([lens_of(where, *np.meshgrid(x + a, y + b)) == lit for a in steps for b in steps], axis=0)
    assert touches.any()
    assert not touches.all()
    assert kept[touches].all()
    steps = np.linspace(-2.0, 2.0, 17) * VOXEL_MM[0]  # blur by half a voxel in depth, with a margin
    near = np.any([lens_of(where, *np.meshgrid(x + a, y + b)) == lit for a in steps for b in steps], axis=0)
    assert not kept[~near].any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_particle_anywhere_in_such_a_voxel_keeps_it(kind):
    """Its own noise-free light as the bound, wherever it is within the voxel along x, y and z."""
    where, grid, rng = layout_of(kind), grid_of(), np.random.default_rng(2)
    projector, (x, y, z) = PlenopticProjector(where, grid), grid.axes()
    tried = 0
    while tried < 12:
        k, row, column = 1, *rng.integers(2, 19, 2)
        place = np.array([x[column], y[row], z[k]]) + rng.uniform(-0.49, 0.49, 3) * VOXEL_MM
        half = 0.5 * VOXEL_MM[0]
        corners = {int(lens_of(where, x[column] + a, y[row] + b)) for a in (-half, half) for b in (-half, half)}
        if len(corners) == 1:
            continue
        tried += 1
        bound = (1.01 * PARTICLE * exact_light(where, place)).astype(np.float32)
        kept = projector.candidates(bound, PARTICLE).dense().values > 0
        assert kept[k, row, column], place


def test_borders_coincide_where_the_aperture_s_blur_is_less_than_half_a_voxel():
    """|A| P_m/2 = |z| P_m/2 / S_o on the microlens plane, to first order."""
    where = layout_of("square")
    reach = 0.5 * VOXEL_MM[0] * 100.0 / (0.5 * where.camera.main_lens.aperture_mm)
    grid = VoxelGrid((-0.06, -0.06, -0.4), VOXEL_MM, (21, 21, 21))
    coincide = [k for k in range(21) if borders_coincide(where, grid, k)]
    assert coincide == [k for k, z in enumerate(grid.axes()[2]) if abs(z) < reach] == [9, 10, 11]


@pytest.mark.parametrize("kind", KINDS)
def test_the_kernel_s_nearest_lens_is_the_lattice_s(kind):
    lattice = Lattice(kind, 1.0)
    points = np.random.default_rng(4).uniform(-5, 5, (2000, 2))
    found = [nearest(kind == "hexagonal", lattice.row_spacing, a, b) for a, b in points]
    assert np.array_equal(np.transpose(found), lattice.nearest(*points.T))
