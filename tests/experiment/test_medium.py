"""The table [medium], and what of a file depends on it."""

import tomllib

import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

TEXT = """
[camera]
kind = "plenoptic"
main_lens = { focal_length_mm = 50.0, aperture_mm = 25.0, magnification = -1.0 }
microlens_array = { lattice = "hexagonal", pitch_mm = 0.077, focal_length_mm = 0.308 }
sensor = { columns = 1800, rows = 1350, pixel_pitch_mm = 0.0055, bit_depth = 12, black_level = 60 }
[recording]
white = "white.tif"
frames = ["a.tif", "b.tif"]
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-4.1, 4.1]
y_mm = [-2.9, 2.9]
z_mm = [-5.3, 5.3]
voxel_mm = [0.0171428571, 0.0171428571, 0.1026]
[correlation]
windows = [[128, 128, 32], [64, 64, 16]]
"""
WATER = {"refractive_index": 1.333, "fluid_mm": 40.0}


def loaded(**medium):
    return Experiment.from_dict(tomllib.loads(TEXT) | ({"medium": medium} if medium else {}), "file.toml")


def refused(**medium):
    with pytest.raises(PlenoPIVError) as error:
        loaded(**medium)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_defaults():
    medium = loaded(**WATER).medium
    assert medium.window_mm == 0.0
    assert medium.window_refractive_index == 1.5
    assert medium.window_tilt_deg == (0.0, 0.0)
    assert medium.medium().optical_way_mm == pytest.approx(40 / 1.333)
    assert loaded().medium is None


def test_a_window_within_the_volume():
    assert "file.toml: medium.fluid_mm: 5.2 mm of fluid between z = 0 and the window end within the volume" in refused(
        refractive_index=1.333, fluid_mm=5.2
    )
    assert loaded(refractive_index=1.333, fluid_mm=5.4).medium
    # 2.9 mm off the axis a window that is turned by 5 degrees about x is 0.25 mm nearer
    assert "within the volume" in refused(refractive_index=1.333, fluid_mm=5.4, window_tilt_deg=[5, 0])
    assert loaded(refractive_index=1.333, fluid_mm=5.6, window_tilt_deg=[5, 0]).medium


def test_no_air_left():
    said = refused(refractive_index=1.333, fluid_mm=120.0, window_mm=15.75)
    assert "medium.fluid_mm: fluid and window take 100.5 mm" in said
    assert "of the 100 mm from the focal plane to the lens" in said
    assert loaded(refractive_index=1.333, fluid_mm=120.0, window_mm=14.0).medium


def test_wrong_keys_and_numbers():
    assert "medium.index: unknown key" in refused(**WATER, index=1.3)
    assert "did you mean refractive_index?" in refused(refractiv_index=1.333, fluid_mm=40.0)
    assert "medium.refractive_index = 0.75" in refused(refractive_index=0.75, fluid_mm=40.0)
    assert "medium.fluid_mm" in refused(refractive_index=1.333, fluid_mm=-40.0)
    assert "medium.fluid_mm: missing" in refused(refractive_index=1.333)
    assert "medium.window_tilt_deg" in refused(**WATER, window_tilt_deg=2.0)
    assert "medium.window_tilt_deg" in refused(**WATER, window_tilt_deg=[60.0, 0.0])


def test_with_a_target_the_volume_is_not_in_the_camera_s_frame():
    planes = [{"image": f"{k}.tif", "z_mm": float(k)} for k in range(3)]
    target = {"target": "dots", "pitch_mm": 0.6, "dot_mm": 0.2, "origin_dot_mm": 0.36, "planes": planes}
    tables = tomllib.loads(TEXT) | {"medium": {"refractive_index": 1.333, "fluid_mm": 5.0}, "calibration": target}
    assert Experiment.from_dict(tables).medium.fluid_mm == 5.0


def test_it_is_written_out():
    text = loaded(**WATER, window_tilt_deg=[1.0, -2.0]).dump_toml()
    again = Experiment.from_dict(tomllib.loads(text))
    assert again.medium == loaded(**WATER, window_tilt_deg=[1.0, -2.0]).medium


def test_particles_do_not_tell_blur_from_the_aberration_of_water():
    tables = tomllib.loads(TEXT)
    tables["camera"]["main_lens"]["blur_mm"] = "auto"
    assert Experiment.from_dict(tables, "file.toml").blur_measured
    with pytest.raises(PlenoPIVError, match=r'main_lens\.blur_mm: "auto" needs a camera in air') as error:
        Experiment.from_dict(tables | {"medium": WATER}, "file.toml")
    assert "\n" not in str(error.value)
    assert loaded(**WATER).blur_measured is None
