"""What falls on the outermost pixels' outer sides is still seen, on all four alike."""

import pytest

from plenopiv.cameras.coverage import middle_with
from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
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


def test_the_middle_with_a_volume_beside_it():
    """Twice as much wider as the image of the volume's centre lies beyond a quarter of it; the axis stays in it."""
    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), Lattice("square", 0.077), 0.308, Sensor(3000, 2000, 0.0055))
    about_the_axis = middle_with(camera, ((-2.0, 2.4), (-1.0, 1.0), (-2.0, 2.0)), 1600)
    assert (about_the_axis.columns, about_the_axis.rows) == (1600, 1600)
    aside = middle_with(camera, ((2.75, 3.3), (-5.5, -2.75), (-0.1, 0.1)), 1600)
    assert aside.columns == 1600 + 2 * (550 - 400)
    assert aside.rows == 2000  # no more than there is: 1600 + 2 * (750 - 400)
