"""What falls on the outermost pixels' outer sides is still seen, on all four alike."""

import pytest

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.sensor import Sensor

# 1000 px of focal length at 1000 mm: a pixel is a millimetre, and all numbers below are exact
CAMERA = PinholeCamera((0.0, 0.0, 1000.0), (0.0, 0.0, 0.0), 1000.0, Sensor(64, 48, 0.0055))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_edge_belongs_to_the_sensor(sign):
    assert CAMERA.project((sign * 32.0, 0.0, 0.0)) == pytest.approx([31.5 + sign * 32, 23.5], abs=0)
    for place in [(32.0, 0.0), (0.0, 24.0), (32.0, 24.0)]:
        assert CAMERA.sees((sign * place[0], sign * place[1], 0.0))
    for place in [(32.001, 0.0), (0.0, 24.001)]:
        assert not CAMERA.sees((sign * place[0], sign * place[1], 0.0))
