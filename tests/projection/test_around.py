"""Two cameras at a right angle: the same light, the same voxels, each in its own order."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.cameras.pose import FRONT, SIDE, Pose
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.several_cameras import SeveralCameras, places_of, turned
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.5, 0.6), (-0.3, 0.3), (-0.6, 0.5), (0.04, 0.03, 0.05))
MIDDLE = (0.28, 0.105, -0.375)  # of a voxel
BELOW = Pose((1, 3, -2))  # on the -y side, its y along z
POSES = (FRONT, SIDE, BELOW)


def listed(share=0.05, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(GRID, rng.random(GRID.shape) < share)
    return volume.with_values(rng.random(volume.column.size).astype(np.float32))


def cameras(microlenses=(40, 40), grid=GRID):
    where = layout(small_camera("hexagonal", microlenses=microlenses))
    poses = (FRONT, SIDE)
    return SeveralCameras(grid, [PlenopticProjector(where, pose.grid(grid)) for pose in poses], poses)


def centres(volume):
    """Of the listed voxels, (n, 3) mm."""
    return np.stack([axis[place] for axis, place in zip(volume.grid.axes(), places_of(volume), strict=True)], -1)


@pytest.mark.parametrize("pose", POSES)
def test_a_turned_list_holds_the_same_light_at_the_same_places(pose):
    volume = listed()
    own, order = turned(volume, pose)
    np.testing.assert_allclose(centres(own), pose.in_camera(centres(volume)[order]), atol=1e-12)
    np.testing.assert_array_equal(own.values, volume.values[order])
    rank = np.ravel_multi_index(places_of(own)[::-1], own.grid.shape)
    assert (np.diff(rank) > 0).all()
    assert own.row_start[-1] == own.column.size


@pytest.mark.parametrize("pose", POSES)
def test_the_dense_volume_turned_by_hand(pose):
    volume = listed()
    by_hand = np.transpose(volume.dense().values, [3 - abs(a) for a in pose.axes[::-1]])
    flip = tuple(axis for axis, a in enumerate(pose.axes[::-1]) if a < 0)
    own = turned(volume, pose).volume.dense().values
    np.testing.assert_array_equal(own, np.flip(by_hand, flip))
    np.testing.assert_array_equal(own, pose.planes(volume.dense().values))
    np.testing.assert_array_equal(pose.inverse().planes(own), volume.dense().values)


def test_planes_that_a_camera_at_the_side_sees():
    """Its nearest are the object's last columns; on its left is +z, up stays up."""
    values = np.arange(2 * 3 * 4).reshape(2, 3, 4)
    seen = SIDE.planes(values)
    assert seen.shape == (4, 3, 2)
    np.testing.assert_array_equal(seen[3, 1], [values[1, 1, 3], values[0, 1, 3]])


def test_signs_of_a_camera_at_the_side():
    """On the +x side it sees +z on its left, +y up, and +x comes nearer."""
    np.testing.assert_allclose(SIDE.in_camera([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert SIDE.limits(((-1, 2), (-3, 4), (-5, 6))) == ((-6, 5), (-3, 4), (-1, 2))


@pytest.mark.parametrize("axes", [(1, 2, -3), (2, 1, 3), (1, 1, 3), (0, 2, 3), (1, 2, 4)])
def test_frames_that_are_none(axes):
    with pytest.raises(PlenoPIVError, match="right-handed"):
        Pose(axes)


def test_views_of_each_camera_are_its_own():
    around, volume = cameras(), listed()
    first, second = around.projectors
    views = np.array([3, first.views + 5, 0])
    images = around.forward(views, volume)
    np.testing.assert_array_equal(images[[0, 2]], first.forward([3, 0], volume))
    np.testing.assert_array_equal(images[1], second.forward(5, turned(volume, SIDE).volume))


def test_forward_and_back_are_transposes():
    around, volume, rng = cameras(), listed(), np.random.default_rng(1)
    views = np.array([2, 60, around.projectors[0].views + 7])
    images = rng.random((3, around.seen.shape[1])).astype(np.float32)
    light = np.concatenate([p.light_of_planes() for p in around.projectors])
    assert np.ptp(light) < 0.03 * light.mean()  # a view's light: a voxel's share of it, in a camera of this depth
    there = np.sum(around.forward(views, volume) * images, dtype=np.float64)
    back = np.sum(around.gather(views, images, volume) * volume.values, dtype=np.float64) * light.mean()
    assert back == pytest.approx(there, rel=0.03)


def test_voxels_left_by_all():
    around, a, b = cameras(), listed(0.3, 1), listed(0.3, 2)
    left = around._in_all([a, turned(b, SIDE).volume])
    np.testing.assert_array_equal(left.dense().values > 0, (a.dense().values > 0) & (b.dense().values > 0))


def frame(place_mm, around, light=20_000.0):
    images = []
    for projector, pose in zip(around.projectors, around.poses, strict=True):
        where = projector.layout
        image = particle_image(where.camera, Particles(pose.in_camera([place_mm]), np.float64(light)), rays=200_000)
        images.append(image + where.camera.sensor.black_level)
    return images


@pytest.mark.parametrize("place", [(0.3, 0.1, -0.4), (-0.3, -0.12, 0.3)])
def test_a_particle_is_found_where_it_is(place):
    around = cameras()
    found = reconstruct(around.values_of(frame(place, around)), around, ReconstructionSettings())
    volume = found.volume
    centre = (centres(volume) * volume.values[:, None]).sum(0) / volume.values.sum()
    assert (np.abs(centre - place) < 0.6 * np.array(GRID.voxel_mm)).all()  # lone light may gather in one voxel


def test_a_voxel_gets_its_light_back_once_not_once_for_each_camera():
    around = cameras()
    found = reconstruct(
        around.values_of(frame((0.28, 0.105, -0.375), around)), around, ReconstructionSettings()
    )  # its middle
    assert found.volume.values.sum() == pytest.approx(20_000.0, rel=0.1)


def test_frames_that_do_not_belong_together():
    """Out of focus in both cameras, where no voxel stays for lying across microlenses."""
    grid, settings = (
        VoxelGrid.covering((0.6, 1.0), (-0.3, 0.3), (0.6, 1.0), (0.04, 0.03, 0.04)),
        ReconstructionSettings(),
    )
    around = cameras((66, 40), grid)
    front, side = frame((0.8, 0.2, 0.8), around)
    _, other_side = frame((0.8, -0.2, 0.8), around)
    assert reconstruct(around.values_of([front, side]), around, settings).volume.column.size > 0
    message = r"^frame 7: no voxel is a candidate of all cameras; check how they are mounted"
    with pytest.raises(PlenoPIVError, match=message):
        reconstruct(around.values_of([front, other_side]), around, settings, name="frame 7")
    with pytest.raises(PlenoPIVError, match=r"^1 images for 2 cameras; give one of each camera"):
        around.values_of([front])


def test_tiles_of_two_cameras_are_the_whole():
    around = cameras()
    values = around.values_of(frame(MIDDLE, around))
    whole = reconstruct(values, around, ReconstructionSettings()).volume
    tiles = cut(GRID.shape[1], 2, 4)  # the particle's light crosses few rows
    found = reconstruct(values, around, ReconstructionSettings(), tiles=tiles).volume
    assert found.grid == GRID
    assert found.values.sum() == pytest.approx(whole.values.sum(), rel=0.05)
    at = [(centres(v) * v.values[:, None]).sum(0) / v.values.sum() for v in (whole, found)]
    assert (np.abs(at[1] - at[0]) < 0.3 * np.array(GRID.voxel_mm)).all()


def test_rounding_is_no_other_grid():
    """Rows of a tile, counted from either side: their places differ in the last bit."""
    camera, rng = layout(small_camera()), np.random.default_rng(0)
    poses = Pose(), Pose((3, -2, 1))
    for low, high in rng.uniform(0.2, 0.5, (8, 2)):
        grid = VoxelGrid.covering((-0.1, 0.1), (-low, high), (-0.1, 0.1), (0.03, 0.03, 0.03))
        around = SeveralCameras(grid, [PlenopticProjector(camera, pose.grid(grid)) for pose in poses], poses)
        rows = grid.shape[1] // 3, grid.shape[1] // 2 + 1
        assert around.tile(*rows).grid.shape[1] == rows[1] - rows[0]


def test_tiles_need_rows_that_are_rows_to_each_camera():
    where = layout(small_camera("square", microlenses=(40, 40)))
    poses = (FRONT, BELOW)
    around = SeveralCameras(GRID, [PlenopticProjector(where, pose.grid(GRID)) for pose in poses], poses)
    with pytest.raises(PlenoPIVError, match="camera 2: its y is not the volume's"):
        around.tile(0, 5)
    assert around.tile(0, GRID.shape[1]) is around


def test_a_projector_of_other_voxels():
    where = layout(small_camera("square"))
    with pytest.raises(PlenoPIVError, match="camera 2: its voxels are not the volume's"):
        SeveralCameras(GRID, [PlenopticProjector(where, GRID)] * 2, (FRONT, SIDE))
