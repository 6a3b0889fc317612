"""Pixels and the plane they lie in; the orientation in which an image is stored."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor, upright

SENSOR = Sensor(9, 6, 0.0055, 12, 60.0)


def test_axis_and_full_scale():
    assert SENSOR.axis == (4.0, 2.5)
    assert SENSOR.full_scale == 4095
    assert SENSOR.plane_from_pixel(4.0, 2.5) == (0.0, 0.0)


def test_plane_and_pixel_are_inverse():
    column, row = np.random.default_rng(0).uniform(-3, 12, (2, 40))
    back = SENSOR.pixel_from_plane(*SENSOR.plane_from_pixel(column, row))
    np.testing.assert_allclose(back, [column, row], atol=1e-12)


def test_signs_of_an_upright_image():
    """Columns grow with the object's +x, which is -s (M < 0); rows with -y, which is +t."""
    s, t = SENSOR.plane_from_pixel(5.0, 3.5)
    assert s == pytest.approx(-0.0055)
    assert t == pytest.approx(+0.0055)


def test_upright_is_its_own_inverse_and_no_mirror():
    image = np.arange(54).reshape(6, 9)
    assert upright(image, "upright") is image
    turned = upright(image, "sensor")
    np.testing.assert_array_equal(turned, np.rot90(image, 2))
    np.testing.assert_array_equal(upright(turned, "sensor"), image)
    # a mirror would swap the sense of (right, down) steps: their cross product keeps its sign
    where = {value: np.argwhere(turned == value)[0] for value in (0, 1, 9)}
    right, down = where[1] - where[0], where[9] - where[0]
    assert right[1] * down[0] - right[0] * down[1] == 1


@pytest.mark.parametrize("word", ["Upright", "up", "", None])
def test_unknown_orientations_are_refused(word):
    with pytest.raises(PlenoPIVError, match=rf'recording.orientation: {word!r} is no orientation; give "upright" or'):
        upright(np.zeros((6, 9)), word)
