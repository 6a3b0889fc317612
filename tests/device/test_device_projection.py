"""Views of a dense volume, and what pixels give back, by the device's code on this processor: those of the kernels."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from oracles.cameras import small_camera

pytest.importorskip("jax")
import jax.numpy as jnp

from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.cameras.space_map import PLACE_POWERS
from plenopiv.device import asking
from plenopiv.device.projection import forward, gather, on_device
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import LatticeMap
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.several_cameras import SeveralCameras
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

NEAR = VoxelGrid.covering((-0.41, 0.39), (-0.3, 0.33), (-2.1, -1.3), (0.0385, 0.0385, 0.1))
FAR = VoxelGrid.covering((-0.2, 0.2), (-0.3, 0.3), (7.5, 9.0), (0.01, 0.01, 0.5))  # two voxels to a point
TWOS = VoxelGrid.covering((-0.2, 0.2), (-0.2, 0.2), (8.0, 8.3), (0.01, 0.01, 0.05))
FOCUS = VoxelGrid.covering((-0.2, 0.2), (-0.2, 0.25), (-0.4, 0.4), (0.05, 0.05, 0.1))
LENS_MAP = LatticeMap(2, 0.25, ((0.012, 0.01), (-0.008, -0.015), (0.01, 0.0), (0.0, 0.02), (0.01, 0.0)))


def projector_of(kind, degrees, grid, shifts=None, light=False, **options):
    camera = small_camera(kind, pmr=8, rotation_rad=radians(degrees), offset_mm=(0.013, -0.027))
    if options:
        camera = camera.with_lattice(replace(camera.lattice, **options))
    where = layout(camera)
    if light:
        share = np.random.default_rng(5).uniform(0.6, 1.0, where.seen.shape).astype(np.float32)
        where = replace(where, light=share)
    if shifts is not None:
        rng = np.random.default_rng(6)
        shifts = rng.normal(0, shifts, (where.views, len(PLACE_POWERS), 2)).astype(np.float32)
    return PlenopticProjector(where, grid, shifts=shifts)


def compared(projection, views, share=0.1, seed=0):
    """Images of a volume and what random images give back, both of the kernels and of the device: of each the largest
    difference as a share of the largest value, and how far both are from transposes of each other."""
    rng, grid = np.random.default_rng(seed), projection.grid
    listed = SparseVolume.from_mask(grid, rng.random(grid.shape) < share)
    listed = listed.with_values(rng.random(listed.column.size).astype(np.float32) * 1000)
    seen, device = projection.seen[views], on_device(projection)
    light = forward(device, views, jnp.asarray(listed.dense().values))
    images = rng.normal(size=seen.shape).astype(np.float32) * seen
    back = gather(device, views, images)
    by_kernels, sums = projection.forward(views, listed) * seen, projection.gather(views, images, listed)
    assert by_kernels.max() > 0
    ahead, other = np.sum(light * images.astype(np.float64)), back[listed.mask()].astype(np.float64) * listed.values
    if isinstance(projection, PlenopticProjector):
        planes = np.diff(listed.row_start[:: grid.shape[1]])
        other = other * np.repeat(projection.light_of_planes().astype(np.float64), planes)
        ahead = abs(ahead - other.sum()) / (np.linalg.norm(light) * np.linalg.norm(images))
    of_light = np.abs(light - by_kernels).max() / by_kernels.max()
    of_sums = np.abs(back[listed.mask()] - sums).max() / np.abs(sums).max()
    print(f"\nlight {of_light:.1e}, back {of_sums:.1e}, transposes {ahead:.1e}")
    return of_light, of_sums, ahead


CASES = {
    "square": ("square", 0.0, NEAR),
    "hexagonal, 5 deg, in focus": ("hexagonal", 5.0, FOCUS),
    "hexagonal, several voxels to a point": ("hexagonal", 0.5, FAR),
}


@pytest.mark.parametrize("case", ["square", *(pytest.param(case, marks=pytest.mark.full) for case in list(CASES)[1:])])
def test_light_and_back_are_those_of_the_kernels(case):
    """Of a volume of which so few voxels are listed as of a frame's."""
    projector = projector_of(*CASES[case])
    views = np.arange(0, projector.views, projector.views // 7)[:8]
    of_light, of_sums, apart = compared(projector, views)
    assert of_light <= 1e-5
    assert of_sums <= 1e-5
    assert apart <= 1e-6


def test_planes_in_twos_either_way():
    """Far from focus several views at once are read off maps that two planes share."""
    projector = projector_of("square", 0.5, TWOS)
    assert all(np.diff(pairs.first).max() == 2 for pairs in projector.images.pairs)
    for views in ([20, 3, 31], [21, 3, 30]):
        of_light, of_sums, _ = compared(projector, np.array(views), share=0.02)
        assert of_light <= 1e-5
        assert of_sums <= 1e-5


@pytest.mark.full
def test_many_microlenses_about_a_point(monkeypatch):
    monkeypatch.setattr(asking, "WRITTEN_OUT", 0)
    grid = VoxelGrid.covering((-0.4, 0.37), (-0.3, 0.36), (-2.0, -1.7), (0.0385, 0.0385, 0.1))  # no other test's
    of_light, of_sums, apart = compared(projector_of("hexagonal", 2.0, grid), np.arange(3) * 20)
    assert max(of_light, of_sums) <= 1e-5
    assert apart <= 1e-6


@pytest.mark.full
def test_voxels_of_a_few_listed():
    projector = projector_of("hexagonal", 5.0, FOCUS)
    of_light, of_sums, _ = compared(projector, np.arange(8) * 7, share=0.03)
    assert of_light <= 1e-5
    assert of_sums <= 1e-5


@pytest.mark.full
@pytest.mark.parametrize("case", ["square", "hexagonal, several voxels to a point"])
def test_all_voxels_listed(case):
    """Rows of many voxels are spread by the kernels by outer products, of which those below 3e-4 of the largest are
    left out."""
    projector = projector_of(*CASES[case])
    of_light, of_sums, apart = compared(projector, np.arange(8) * 7, share=1.1)
    assert of_light <= 1e-4
    assert of_sums <= 2e-3
    assert apart <= 1e-6


@pytest.mark.parametrize("kind", ["hexagonal", pytest.param("square", marks=pytest.mark.full)])
def test_what_real_cameras_do(kind):
    """A distorted array, views that see light beside its place, and light that the main lens' rim clips."""
    projector = projector_of(kind, 1.0, NEAR, shifts=0.01, light=True, map=LENS_MAP)
    of_light, of_sums, apart = compared(projector, np.arange(4) * 15)
    assert of_light <= 1e-5
    assert of_sums <= 1e-5
    assert apart <= 1e-6


def test_each_axis_moves_light_its_own_way():
    """One voxel's light moves as the kernels say when it moves by one voxel along x, y or z."""
    projector = projector_of("square", 0.0, NEAR)
    device, places = on_device(projector), [(3, 8, 10), (3, 8, 11), (3, 9, 10), (4, 8, 10)]
    views, images = np.arange(8) * 7, []
    for place in places:
        mask = np.zeros(NEAR.shape, bool)
        mask[place] = True
        volume = SparseVolume.from_mask(NEAR, mask, 1e4)
        found = forward(device, views, jnp.asarray(volume.dense().values))
        images.append(np.array([projector.forward(int(view), volume) for view in views]))
        np.testing.assert_allclose(found, images[-1], atol=3e-4 * images[-1].max())
    for moved in images[1:]:
        assert np.abs(moved - images[0]).max() > 0.1 * images[0].max()


def test_the_same_bits_twice():
    projector = projector_of("square", 0.0, NEAR)
    device, rng = on_device(projector), np.random.default_rng(1)
    volume, views = jnp.asarray(rng.random(NEAR.shape, np.float32)), np.arange(8) * 7
    images = rng.normal(size=(8, projector.layout.lenses)).astype(np.float32)
    np.testing.assert_array_equal(forward(device, views, volume), forward(device, views, volume))
    np.testing.assert_array_equal(gather(device, views, images), gather(device, views, images))


@pytest.mark.full
def test_two_cameras_around_a_volume():
    grid = VoxelGrid.covering((-0.3, 0.35), (-0.2, 0.2), (-0.3, 0.25), (0.05, 0.04, 0.06))
    wheres = [layout(small_camera("square", pmr=8, microlenses=size)) for size in ((14, 9), (13, 11))]
    poses = FRONT, SIDE
    each = [PlenopticProjector(where, pose.grid(grid)) for where, pose in zip(wheres, poses, strict=True)]
    several = SeveralCameras(grid, each, poses)
    views = np.array([3, each[0].views + 20, 30, each[0].views + 5])
    of_light, of_sums, _ = compared(several, views)
    assert of_light <= 1e-5
    assert of_sums <= 1e-5


def test_weights_of_rays_are_refused():
    where = layout(small_camera("square", pmr=8))
    with pytest.raises(PlenoPIVError, match=r'reconstruction\.weights: "9-rays" .* use "exact"'):
        on_device(PlenopticProjector(where, NEAR, "9-rays"))
