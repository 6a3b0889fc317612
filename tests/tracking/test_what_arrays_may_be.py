"""Arrays of other shapes, limits that are none: one line each, where they are given."""

import numpy as np
import pytest

from plenopiv.cameras.pinhole import looking_at
from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor
from plenopiv.tracking.field import field_from_tracks
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.pinhole_light import PinholeLights
from plenopiv.tracking.pixels import Pixels
from plenopiv.volume import as_points, check_limits

LIMITS = ((-1.0, 1.0),) * 3
PLACES = np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3))


@pytest.fixture(scope="module")
def seen():
    """Two cameras' light, and dark pixels."""
    sensor = Sensor(60, 50, 0.0055, 12, 0.0)
    cameras = [looking_at((0, 0, 0), sensor, scale_mm_px=0.03, distance_mm=300.0, about_y_deg=y) for y in (-20.0, 20.0)]
    dark = Pixels.of_image(np.ones((50, 60)), 0.0, 4095.0, 1.5, 0.5)
    return PinholeLights(cameras, 0.7), Pixels.of_cameras([dark, dark])


@pytest.mark.parametrize("points", [np.zeros((30, 2)), PLACES.T, np.zeros((2, 3, 3)), np.zeros(6)])
def test_points_are_x_y_z_of_each(seen, points):
    of_points, _ = seen
    with pytest.raises(PlenoPIVError, match=r"tracking: points of shape \(.*\), give x, y, z of each: \(n, 3\)"):
        of_points(points)


def test_one_point_a_list_and_none_are_points():
    assert as_points("a test", [1, 2, 3]).shape == (1, 3)
    assert as_points("a test", [[1, 2, 3], [4, 5, 6]]).tolist() == [[1, 2, 3], [4, 5, 6]]
    for none in ([], np.empty((0, 3)), np.empty((0, 0))):
        assert as_points("a test", none).shape == (0, 3)


@pytest.mark.parametrize("limits", [((0.5, -0.5),) * 3, (-0.5, 0.5), ((0.0, 1.0),) * 2, ((0.0, np.nan),) * 3])
def test_limits_are_three_rising_pairs(seen, limits):
    of_points, pixels = seen
    words = r"limits .*, give lowest and highest x, y and z: three rising pairs"
    with pytest.raises(PlenoPIVError, match=f"a test: {words}"):
        check_limits("a test", limits)
    with pytest.raises(PlenoPIVError, match=f"tracking: {words}"):
        particles_of_frame(of_points, pixels, PLACES, np.ones(30), limits)
    with pytest.raises(PlenoPIVError, match=f"tracking: {words}"):
        field_from_tracks(PLACES, PLACES, np.ones_like(PLACES), limits, 0.5)


def test_each_particle_has_its_light(seen):
    of_points, pixels = seen
    for light in (np.ones(29), 5.0):
        with pytest.raises(PlenoPIVError, match=r"tracking: light of shape .*, of 30 points; give one of each"):
            particles_of_frame(of_points, pixels, PLACES.tolist(), light, LIMITS)


@pytest.mark.parametrize("std", [0.1, np.ones(30), np.ones((29, 3))])
def test_tracks_have_all_three_of_each(std):
    with pytest.raises(PlenoPIVError, match=r"tracking: positions, velocities and std of shapes .*, give \(n, 3\)"):
        field_from_tracks(PLACES, PLACES, std, LIMITS, 0.5)


def test_pixels_are_of_one_image():
    with pytest.raises(PlenoPIVError, match=r"tracking: an image of shape \(2, 5, 5\), give \(rows, columns\)"):
        Pixels.of_image(np.ones((2, 5, 5)), 0.0, 4095.0, 1.5, 0.5)
    for wrong in (-1.0, np.nan):
        with pytest.raises(PlenoPIVError, match=r"tracking: counts_per_electron = .*, give 0 or more"):
            Pixels.of_image(np.ones((5, 5)), 0.0, 4095.0, 1.5, wrong)
