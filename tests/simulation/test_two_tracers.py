"""The simulation's rays against those that calibration fits (``cameras.ray_model``): written apart, of one world."""

import numpy as np
import pytest

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_images import traced

SHEET = PlenopticCamera(MainLens(50.0, 25.0, -0.8), Lattice("hexagonal", 0.077), 0.308, Sensor(600, 480, 0.0055, 12))
CORNER_MM = np.hypot(600, 480) * 0.0055 / 2


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (2.0, -1.0), (-4.0, 3.0)])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (1.0, -2.0, 20.0)])
def test_both_trace_the_same_rays(tilt, turn):
    medium = Medium(1.333, 45.0, 10.0, 1.52, tilt)
    pose = Pose(turn[2], (0.1, -0.2, 0.0), turn[:2])
    camera = RealCamera.of(SHEET, distortion=0.02, medium=medium, pose=pose)
    model = RayModel(
        50.0, 90.0, medium.gap_mm(camera.object_distance_mm), medium, 90.0, CORNER_MM,
        tuple(np.radians(turn)), pose.origin_mm[:2], 0.02,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    points, lens = rng.uniform((-1, -1, -3), (1, 1, 3), (8, 3)), rng.uniform(-8, 8, (12, 2))
    theirs = model.trace(points, lens)[0].reshape(-1, 2)
    mine = traced(camera, np.repeat(points, 12, 0), np.tile(lens, (8, 1))).st_mm
    assert mine == pytest.approx(theirs, abs=2e-6 if any(tilt) else 1e-10)
