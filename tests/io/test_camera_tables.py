"""A calibrated camera goes through JSON and TOML and comes back to the last bit."""

import json
import tomllib
from dataclasses import replace

import pytest
import tomli_w
from calibrations import calibrated

from plenopiv.errors import PlenoPIVError
from plenopiv.io.camera_tables import camera_of, tables_of

CAMERA = replace(calibrated().camera, blur_mm=0.1 + 0.2)


@pytest.mark.parametrize("irregular", [True, False])
@pytest.mark.parametrize("through", [lambda t: json.loads(json.dumps(t)), lambda t: tomllib.loads(tomli_w.dumps(t))])
def test_there_and_back(irregular, through):
    camera = replace(calibrated(irregular, irregular).camera, blur_mm=1 / 3)
    assert repr(vars(camera_of(through(tables_of(camera))))) == repr(vars(camera))


def test_the_sign_of_a_zero_stays():
    camera = replace(CAMERA, lattice=replace(CAMERA.lattice, offset_mm=(-0.0, 0.0)))
    assert str(camera_of(json.loads(json.dumps(tables_of(camera)))).lattice.offset_mm) == "(-0.0, 0.0)"


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("main_lens", {}, KeyError),
        ("microlens_focal_length_mm", float("nan"), ValueError),
        ("microlens_focal_length_mm", "x", TypeError),
        ("sensor", 3, TypeError),
        ("main_lens", {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": 1.0}, PlenoPIVError),
        ("rim", {"radius_mm": "10", "slip": 0.1, "start_mm": [0.0, 0.0]}, TypeError),
        ("rim", {"radius_mm": 10.0, "slip": 0.1, "start_mm": [0.0, 0.0], "more": 1.0}, ValueError),
    ],
)
def test_what_is_no_camera(key, value, error):
    with pytest.raises(error):
        camera_of(tables_of(CAMERA) | {key: value})
