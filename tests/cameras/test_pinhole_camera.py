"""The pinhole camera: signs of every axis and angle, closed forms, and rays that lead back."""

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from plenopiv.cameras.pinhole import (
    PinholeCamera,
    looking_at,
    rotation_matrix,
    rotation_vector,
    share_seen,
)
from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor

SENSOR = Sensor(640, 480, 0.0055)
SCALE, DISTANCE = 0.074, 500.0


def camera(**angles):
    return looking_at((0, 0, 0), SENSOR, scale_mm_px=SCALE, distance_mm=DISTANCE, **angles)


def shift(seen_by, step_mm):
    """How the image of the centre moves, in px, when the point does."""
    return seen_by.project(step_mm) - seen_by.project((0, 0, 0))


def test_straight_ahead_columns_grow_with_x_and_rows_with_minus_y():
    ahead = camera()
    assert ahead.project((0, 0, 0)) == pytest.approx([319.5, 239.5])
    assert shift(ahead, (SCALE, 0, 0)) == pytest.approx([1, 0])
    assert shift(ahead, (0, SCALE, 0)) == pytest.approx([0, -1])
    assert shift(ahead, (0, 0, 10)) == pytest.approx([0, 0])


def test_nearer_is_larger():
    """+z is toward the camera: at z = 100 mm of 500 everything is 500/400 as large."""
    assert camera().project((1, 0, 100))[0] - 319.5 == pytest.approx(1 / SCALE * 500 / 400)
    assert camera().pixels_per_mm((0, 0, 100)) == pytest.approx(1 / SCALE * 500 / 400)


@pytest.mark.parametrize("degrees", [25.0, -25.0])
def test_turned_about_y(degrees):
    """Turned by +25 degrees it stands at x > 0 and sees what comes nearer to z move to the left."""
    turned = camera(about_y_deg=degrees)
    side = np.sign(degrees)
    assert turned.position_mm == pytest.approx((DISTANCE * sin(radians(degrees)), 0, DISTANCE * cos(radians(degrees))))
    step = shift(turned, (0, 0, 1e-3)) / 1e-3 * SCALE
    assert step == pytest.approx([-sin(radians(degrees)), 0], abs=1e-4)
    assert side * step[0] < 0
    assert shift(turned, (1e-3, 0, 0)) / 1e-3 * SCALE == pytest.approx([cos(radians(degrees)), 0], abs=1e-4)
    assert shift(turned, (0, 1e-3, 0)) / 1e-3 * SCALE == pytest.approx([0, -1], abs=1e-4)


@pytest.mark.parametrize("degrees", [25.0, -25.0])
def test_turned_about_x(degrees):
    """Turned by +25 degrees it stands at y < 0, below, and sees what comes nearer to z move up (rows fall)."""
    turned = camera(about_x_deg=degrees)
    assert turned.position_mm == pytest.approx((0, -DISTANCE * sin(radians(degrees)), DISTANCE * cos(radians(degrees))))
    step = shift(turned, (0, 0, 1e-3)) / 1e-3 * SCALE
    assert step == pytest.approx([0, -sin(radians(degrees))], abs=1e-4)
    assert shift(turned, (0, 1e-3, 0)) / 1e-3 * SCALE == pytest.approx([0, -cos(radians(degrees))], abs=1e-4)
    assert shift(turned, (1e-3, 0, 0)) / 1e-3 * SCALE == pytest.approx([1, 0], abs=1e-4)


def test_turned_about_both_its_rows_stay_level():
    both = camera(about_y_deg=20, about_x_deg=-15)
    right, up, back = both.axes
    assert right[1] == pytest.approx(0)
    assert right[0] > 0
    assert up[1] > 0
    assert back == pytest.approx(np.array(both.position_mm) / DISTANCE)
    assert np.linalg.det(both.axes) == pytest.approx(1)
    assert both.project((0, 0, 0)) == pytest.approx([319.5, 239.5])


def test_the_centre_need_not_be_the_origin():
    at = looking_at((3, -4, 5), SENSOR, scale_mm_px=SCALE, distance_mm=DISTANCE, about_y_deg=30)
    assert at.project((3, -4, 5)) == pytest.approx([319.5, 239.5])
    assert at.pixels_per_mm((3, -4, 5)) == pytest.approx(1 / SCALE)


def test_principal_point_and_distortion():
    """A point at 45 degrees to the axis has r = 1: the image is stretched by 1 + k1 + k2."""
    bent = PinholeCamera((0, 0, 10), (0, 0, 0), 100.0, SENSOR, (300.0, 200.0), (0.1, -0.02))
    assert bent.project((10, 0, 0)) == pytest.approx([300 + 108, 200])
    assert bent.project((0, -10, 0)) == pytest.approx([300, 200 + 108])
    # r^2 = 1/4: 1 + 0.1/4 - 0.02/16
    assert bent.project((-5, 0, 0)) == pytest.approx([300 - 50 * 1.02375, 200])


def test_behind_the_pinhole_there_is_no_image():
    assert np.isnan(camera().project((0, 0, DISTANCE + 1))).all()
    assert not camera().sees((0, 0, DISTANCE + 1))


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.3, 0.1), (0.4, -0.2)])
def test_rays_lead_back_to_their_pixels(distortion):
    one = replace(camera(about_y_deg=-20, about_x_deg=10), distortion=distortion, principal_point_px=(310.0, 250.0))
    pixels = np.random.default_rng(0).uniform([0, 0], [639, 479], (200, 2))
    rays = one.rays(pixels)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1)
    for distance in (300.0, 700.0):
        again = one.project(np.array(one.position_mm) + distance * rays)
        np.testing.assert_allclose(again, pixels, atol=1e-9)


def test_pixels_on_a_plane():
    one = camera(about_y_deg=20)
    points = np.random.default_rng(1).uniform(-10, 10, (50, 3))
    points[:, 2] = 4.0
    np.testing.assert_allclose(one.on_plane(one.project(points), 4.0), points, atol=1e-9)


@pytest.mark.parametrize("vector", [(0.3, 0, 0), (0, -0.4, 0), (0, 0, 0.5), (0.3, -1.2, 2.0), (1e-10, 0, 0), (0, 0, 0)])
def test_rotation_vectors_and_matrices(vector):
    matrix = rotation_matrix(vector)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert rotation_vector(matrix) == pytest.approx(vector, abs=1e-12)


def test_rotations_are_right_handed():
    x, y, z = np.eye(3)
    quarter = np.pi / 2
    np.testing.assert_allclose(rotation_matrix((0, 0, quarter)) @ x, y, atol=1e-12)
    np.testing.assert_allclose(rotation_matrix((quarter, 0, 0)) @ y, z, atol=1e-12)
    np.testing.assert_allclose(rotation_matrix((0, quarter, 0)) @ z, x, atol=1e-12)


def test_share_of_a_volume_that_is_seen():
    """640 px of 0.074 mm are 47.36 mm; a slab twice as wide is seen by half."""
    half = 0.5 * 640 * SCALE
    assert share_seen(camera(), ((-half, half), (-1, 1), (0, 0))) == 1.0
    assert share_seen(camera(), ((-2 * half, 2 * half), (-1, 1), (0, 0)), 61) == pytest.approx(0.5, abs=0.02)
    assert share_seen(camera(), ((3 * half, 4 * half), (-1, 1), (0, 0))) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale_mm_px": 0}, "positive"),
        ({"scale_mm_px": float("inf")}, "positive"),
        ({"distance_mm": -1}, "positive"),
        ({"distance_mm": float("nan")}, "positive"),
        ({"about_x_deg": 90}, "from behind"),
        ({"about_y_deg": float("nan")}, "from behind"),
        ({"about_x_deg": float("nan")}, "from behind"),
        ({"centre_mm": (0, float("nan"), 0)}, "give x, y, z"),
        ({"centre_mm": (0, 0)}, "give x, y, z"),
    ],
)
def test_placements_that_make_no_sense(change, message):
    given = {"centre_mm": (0, 0, 0), "scale_mm_px": 0.1, "distance_mm": 100.0} | change
    with pytest.raises(PlenoPIVError, match=message):
        looking_at(given.pop("centre_mm"), SENSOR, **given)


def test_a_focal_length_is_positive():
    with pytest.raises(PlenoPIVError, match="focal_length_px"):
        PinholeCamera((0, 0, 1), (0, 0, 0), 0.0, SENSOR)
