"""The light of particles: against rays in plain NumPy, and its derivatives against differences."""

import numpy as np
import pytest
from oracles.blurred_light import blurred_light

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor
from plenopiv.tracking.light import PointLights, diffraction_px

HEXAGONAL = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.01, (0.02, -0.01)),
    0.308,
    Sensor(300, 280, 0.0055, 12, 60),
)
SQUARE = PlenopticCamera(
    MainLens(60.0, 15.0, -0.5), Lattice("square", 0.08, -0.02, (0.03, 0.01)), 0.5, Sensor(261, 300, 0.0055, 12, 0)
)
BENT = HEXAGONAL.with_lattice(
    Lattice("hexagonal", 0.077, 0.01, (0.02, -0.01), LatticeMap(1, 1.0, ((0.004, 0.001), (-0.002, 0.003))))
)
PLACES = [(0.05, -0.11, 0.004), (-0.2, 0.13, 0.7), (0.11, 0.02, -2.3), (-0.03, -0.21, 3.9), (0.3, 0.3, -7.0)]


def image_of(camera, lights, values):
    out = np.bincount(lights.pixel, values, camera.sensor.rows * camera.sensor.columns)
    return out.reshape(camera.sensor.rows, camera.sensor.columns)


def gradients_off(camera, place):
    """How far derivatives by x, y, z are off differences of shares, as shares of these."""
    lights, out = PointLights(camera), []
    here = lights([place])
    for axis, step in enumerate((2e-4, 2e-4, 1e-3)):
        move = np.eye(3)[axis] * step
        ahead, behind = lights([np.add(place, move)]), lights([np.subtract(place, move)])
        difference = (image_of(camera, ahead, ahead.share) - image_of(camera, behind, behind.share)) / (2 * step)
        found = image_of(camera, here, here.gradient[:, axis])
        out.append(np.linalg.norm(found - difference) / np.linalg.norm(difference))
    return out


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", [HEXAGONAL, SQUARE, BENT], ids=["hexagonal", "square", "bent"])
def test_shares_are_those_of_rays(camera, place):
    lights = PointLights(camera)
    found = image_of(camera, lights([place]), lights([place]).share)
    exact = blurred_light(camera, place, lights.blur_px)
    assert np.abs(found - exact).max() < 0.015 * exact.max()
    assert found.sum() == pytest.approx(exact.sum(), abs=2e-3)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", [HEXAGONAL, SQUARE], ids=["hexagonal", "square"])
def test_gradients_are_differences_of_shares(camera, place):
    assert max(gradients_off(camera, place)) < 0.015


def test_points_do_not_depend_on_each_other():
    lights = PointLights(HEXAGONAL)
    together, alone = lights(PLACES), lights([PLACES[2]])
    own = slice(*together.start[2:4])
    assert (together.pixel[own] == alone.pixel).all()
    assert (together.share[own] == alone.share).all()
    assert (together.gradient[own] == alone.gradient).all()
    assert together.whole()[:4] == pytest.approx(np.ones(4), abs=2e-3)


def test_a_point_behind_the_main_lens():
    with pytest.raises(PlenoPIVError, match="in front of the main lens at z = 100 mm"):
        PointLights(HEXAGONAL)([(0.0, 0.0, 100.0)])


def test_diffraction_is_that_of_a_microlens():
    assert diffraction_px(HEXAGONAL) == pytest.approx(0.42 * 532e-6 * 0.308 / 0.077 / 0.0055)
