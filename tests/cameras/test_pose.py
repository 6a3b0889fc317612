"""How a camera stands: points, boxes and voxels of the object in the camera's own frame, in all 24 poses."""

from itertools import permutations, product

import numpy as np
import pytest

from plenopiv.cameras.pose import SIDE, Pose
from plenopiv.volume import VoxelGrid

AXES = [
    tuple(sign * axis for sign, axis in zip(signs, order, strict=True))
    for order in permutations((1, 2, 3))
    for signs in product((1, -1), repeat=3)
]
POSES = [axes for axes in AXES if np.linalg.det(np.eye(3)[[abs(a) - 1 for a in axes]] * np.sign(axes)[:, None]) > 0]
GRID = VoxelGrid((-1.0, 3.0, 0.25), (0.5, 0.25, 0.125), (4, 3, 5))  # no two axes alike
every_pose = pytest.mark.parametrize("axes", POSES)


def object_places():
    """x, y and z of every voxel of the object, each (nz, ny, nx)."""
    x, y, z = GRID.axes()
    return np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None])


def test_the_side_camera_sees_z_to_its_left_y_up_and_x_come_nearer():
    """It stands on the +x side and looks along -x."""
    assert SIDE.in_camera((1.0, 0.0, 0.0)) == pytest.approx([0, 0, 1])
    assert SIDE.in_camera((0.0, 1.0, 0.0)) == pytest.approx([0, 1, 0])
    assert SIDE.in_camera((0.0, 0.0, 1.0)) == pytest.approx([-1, 0, 0])


def test_there_are_24():
    assert len(POSES) == 24


@every_pose
def test_voxels_are_where_the_object_has_them(axes):
    """The camera's grid tells where the voxels lie that ``planes`` puts there."""
    pose = Pose(axes)
    own = pose.grid(GRID)
    x, y, z = own.axes()
    told = np.stack(np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None]), -1)
    of_object = np.stack([pose.planes(place) for place in object_places()], -1)
    assert told.shape[:3] == own.shape
    np.testing.assert_allclose(told, pose.in_camera(of_object), atol=1e-12)


@every_pose
def test_a_box_holds_its_corners_and_touches_them(axes):
    pose, box = Pose(axes), ((-1.0, 2.0), (3.0, 7.0), (-20.0, 10.0))
    corners = pose.in_camera(list(product(*box)))
    for along, (low, high) in zip(corners.T, pose.limits(box), strict=True):
        assert (low, high) == (along.min(), along.max())


@every_pose
def test_there_and_back(axes):
    pose, point = Pose(axes), (1.0, 20.0, 300.0)
    assert pose.inverse().in_camera(pose.in_camera(point)) == pytest.approx(point)
