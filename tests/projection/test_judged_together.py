"""Voxels in focus judged by all their pixels together: which planes are, and which voxels go, against slow loops."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lattice import LatticeMap
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide, rule_out_together
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

STRETCHED = LatticeMap(1, 0.2, ((0.004, -0.0007), (0.001, -0.006)))
CAMERAS = {
    "square": small_camera("square", pmr=8, microlenses=(7, 6), rotation_rad=0.02, offset_mm=(0.007, -0.004)),
    "hexagonal": small_camera("hexagonal", pmr=8, microlenses=(7, 6), rotation_rad=-0.03, offset_mm=(-0.01, 0.006)),
}
CAMERAS["stretched"] = CAMERAS["hexagonal"].with_lattice(replace(CAMERAS["hexagonal"].lattice, map=STRETCHED))


def test_borders_coincide_up_to_half_a_voxel():
    """At M = -1 and f_m = 50 mm a view through the rim sees a plane at z moved by z R / 100 mm: less than half a voxel
    as long as |z| R < 50 mm dx, whichever side is the smaller one."""
    where = layout(small_camera("square", pmr=8))
    radius, least = 0.5 * where.camera.main_lens.aperture_mm, 0.006
    for voxel_mm in ((least, 2 * least, 0.002), (3 * least, least, 0.002)):
        grid = VoxelGrid((0.0, 0.0, -0.1007), voxel_mm, (101, 3, 3))
        found = [k for k in range(101) if borders_coincide(where, grid, k)]
        assert found == [k for k, z in enumerate(grid.axes()[2]) if abs(z) * radius < 50 * least]
        assert 10 < len(found) < 90


def test_borders_half_a_voxel_apart_do_not_coincide():
    """In exact numbers: A = -28/128, B = -100/128, an aperture of 12.5 mm and voxels of 3.5 mm."""
    camera = small_camera("square", pmr=8)
    where = layout(replace(camera, main_lens=replace(camera.main_lens, aperture_mm=12.5)))
    assert not borders_coincide(where, VoxelGrid((0.0, 0.0, -28.0), (3.5, 3.5, 1.0), (1, 1, 1)), 0)
    assert borders_coincide(where, VoxelGrid((0.0, 0.0, -27.99), (3.5, 3.5, 1.0), (1, 1, 1)), 0)


def nearest_lens(camera, s, t):
    """(i, j) of the lens whose centre is nearest before the array is stretched, by looking at all of them."""
    i, j = np.mgrid[-9:10, -9:10]
    if camera.lattice.map is not None:
        stretch = np.eye(2) + np.transpose(STRETCHED.coefficients_mm) / STRETCHED.unit_mm
        s, t = np.linalg.solve(stretch, (s, t))
    centre_s, centre_t = replace(camera.lattice, map=None).centres(i, j)
    at = int(np.argmin((centre_s - s) ** 2 + (centre_t - t) ** 2))
    return int(i.flat[at]), int(j.flat[at])


def touched(camera, place, voxel_mm):
    """Lenses that hold a voxel's middle, corners or the middles of its sides, the voxel as wide on the microlens plane
    as the rays through the aperture's rim leave it over half its depth to either side."""
    x, y, z = place
    so, si, f = camera.main_lens.object_distance_mm, camera.main_lens.image_distance_mm, 50.0
    blur = max(abs(1 + si / (so - at) - si / f) for at in (z - voxel_mm[2] / 2, z + voxel_mm[2] / 2))
    blur *= 0.5 * camera.main_lens.aperture_mm
    b = -si / (so - z)
    wide, high = abs(b) * voxel_mm[0] / 2 + blur, abs(b) * voxel_mm[1] / 2 + blur
    steps = (-1, 0, 1)
    return {nearest_lens(camera, b * x + wide * m, b * y + high * n) for m in steps for n in steps}


@pytest.mark.parametrize("first_mm", [(-0.29, -0.22, -0.06), (0.11, 0.08, 0.05)])
@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_voxel_goes_when_all_its_pixels_of_a_view_hold_less_than_a_particle(camera, first_mm):
    """Light drawn at random; voxels within one lens and voxels beyond the sensor's lenses are not judged."""
    where = layout(camera)
    camera, voxel_mm = where.camera, (0.011, 0.008, 0.05)
    grid = VoxelGrid(first_mm, voxel_mm, (1, 19, 16))
    rng = np.random.default_rng(5)
    bound = rng.uniform(0, 1.0, where.seen.shape).astype(np.float32)
    bound[rng.random(bound.shape) < 0.1] = np.inf
    views, counts = np.array([3, 11, 7]), 0.9
    alive = np.ones((19, 16), np.uint8)
    alive[4, :3] = 0
    want = alive.copy()
    x, y, _ = grid.axes()
    judged = beyond = 0
    for r, k in np.argwhere(alive):
        lenses = touched(camera, (x[k], y[r], first_mm[2]), voxel_mm)
        inside = all(0 <= i - where.i0 < where.ni and 0 <= j - where.j0 < where.nj for i, j in lenses)
        beyond += not inside
        if len(lenses) < 2 or not inside:
            continue
        flat = [(j - where.j0) * where.ni + i - where.i0 for i, j in lenses]
        judged += 1
        want[r, k] = all(sum(float(bound[view, lens]) for lens in flat) >= counts for view in views)
    rule_out_together(where, grid, 0, alive, bound, counts, views)
    np.testing.assert_array_equal(alive, want)
    print(f"\n{judged} judged, {(want == 0).sum()} gone, {beyond} beyond")
    assert judged > 50
    assert beyond > 10
    assert 20 < (want == 0).sum() < judged
