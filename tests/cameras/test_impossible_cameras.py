"""Numbers that no camera has are refused where the camera is made, by name."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

LENS, LATTICE, SENSOR = MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), Sensor(336, 280, 0.0055, 12, 60)
CAMERA = PlenopticCamera(LENS, LATTICE, 0.308, SENSOR)
NOT_POSITIVE = (0.0, -1.0, np.nan, np.inf)
REFUSED = [
    *((LENS, "magnification", m, "main lens: magnification = .* a real image is inverted") for m in (0.5, 0.0, np.nan)),
    *((LENS, "focal_length_mm", f, "main lens: focal_length_mm = .* positive number") for f in NOT_POSITIVE),
    *((LENS, "aperture_mm", d, "main lens: aperture_mm = .* positive number") for d in NOT_POSITIVE),
    *((LATTICE, "pitch_mm", p, "lattice: pitch_mm = .* positive number") for p in NOT_POSITIVE),
    *((LATTICE, "kind", kind, 'lattice: kind = .* "square" or "hexagonal"') for kind in ("Square", "hexagon", None)),
    *((CAMERA, "microlens_focal_length_mm", f, "microlens array: focal_length_mm = ") for f in NOT_POSITIVE),
    *((CAMERA, "blur_mm", blur, "main lens: blur_mm = .* 0 or a positive") for blur in (-0.01, np.nan)),
    *((SENSOR, "columns", n, "sensor: columns = .* positive whole number") for n in (0, -3, 336.0)),
    *((SENSOR, "rows", n, "sensor: rows = .* positive whole number") for n in (0, -3)),
    *((SENSOR, "pixel_pitch_mm", p, "sensor: pixel_pitch_mm = .* positive number") for p in NOT_POSITIVE),
    (SENSOR, "bit_depth", 0, "sensor: bit_depth = 0"),
    (SENSOR, "black_level", np.nan, "sensor: black_level = nan"),
    (SENSOR, "alignment", "High", "sensor: alignment = 'High', give"),
]


@pytest.mark.parametrize(("part", "name", "value", "message"), REFUSED)
def test_numbers_that_no_camera_has(part, name, value, message):
    with pytest.raises(PlenoPIVError, match=f"^{message}"):
        replace(part, **{name: value})


def test_numbers_of_numpy_are_taken():
    assert replace(SENSOR, columns=np.int64(300)).axis == (149.5, 139.5)
    assert replace(LENS, aperture_mm=np.float32(12.5)).object_distance_mm == pytest.approx(100.0)
