"""Micro-images that grow over the sensor, as where the gap behind the array is tilted: against rays."""

import numpy as np
import pytest

from plenopiv.cameras.lens_space import space_map
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import real_particle_image
from plenopiv.tracking.light import PointLights

SENSOR = Sensor(700, 700, 0.0055, 12, 60)
LATTICE = Lattice("hexagonal", 0.077, 0.0053, (0.0237, 0.0012))
TILT = 0.06  # from corner to corner, along s
REAL = RealCamera(50.0, 100.0, 11.0, LATTICE, 0.308, SENSOR, gap_tilt=TILT)
CAMERA = PlenopticCamera(MainLens(50.0, 22.0, -1.0), LATTICE, 0.308, SENSOR)
CORNER_MM = 0.5 * SENSOR.pixel_pitch_mm * float(np.hypot(SENSOR.columns, SENSOR.rows))


@pytest.fixture(scope="module")
def space():
    model = RayModel(50.0, 100.0, REAL.air_mm, Medium(), 100.0, CORNER_MM, gap_tilt=(TILT / 2, 0.0))
    return space_map(model, CAMERA, ((-1.9, 1.9), (-1.9, 1.9), (-3.0, 3.0)))


@pytest.mark.parametrize("side", [-1, 1], ids=["narrow", "wide"])
def test_micro_images_are_as_wide_as_those_of_rays(space, side):
    """s = -x: at x < 0 the gap is longer, and each micro-image wider. Rays at its edge tell."""
    place = np.array([[-side * 1.5, 0.1, 1.6]])
    image = real_particle_image(REAL, Particles(place, np.ones(1)), rays=400_000, diffraction_nm=532.0, seed=2)
    true = image.ravel()

    def missed(growth):
        lights = PointLights(CAMERA, left=space.left, growth=growth)(space.to_lens(place))
        return 0.5 * np.abs(np.bincount(lights.pixel, lights.share, true.size) - true).sum()

    assert space.growth == pytest.approx((TILT / 2 / CORNER_MM, 0.0))
    right, none, other = (missed((k * space.growth[0], 0.0)) for k in (1.0, 0.0, -1.0))
    assert right < 0.95 * none  # what is left: rays are not in focus behind a longer gap
    assert none < 0.95 * other
