"""Experiment files that no person wrote, or wrote with a hand on the keyboard: one line, and at once."""

import time

import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment, text

DRAFT = """
[camera]
kind = "plenoptic"
[camera.main_lens]
focal_length_mm = 50.0
aperture_mm = 25.0
magnification = -1.0
[camera.microlens_array]
lattice = "hexagonal"
pitch_mm = 0.077
focal_length_mm = 0.308
[camera.sensor]
columns = 1800
rows = 1350
pixel_pitch_mm = 0.0055
bit_depth = 12
black_level = 60
[recording]
white = "white.tif"
frames = ["a.tif", "b.tif"]
dt_s = 0.0005
orientation = "upright"
[volume]
x_mm = [-4.2, 4.2]
y_mm = [-3.0, 3.0]
z_mm = [-4.0, 4.0]
voxel_mm = [0.0171428571, 0.0171428571, 0.077]
[correlation]
windows = [[128, 128, 32], [64, 64, 16]]
[output]
directory = "results"
[simulation]
flow = "uniform"
"""


def refused(tmp_path, old, new):
    """What is said of the draft with a text replaced."""
    assert old in DRAFT
    path = tmp_path / "run7.toml"
    path.write_text(DRAFT.replace(old, new, 1), encoding="utf-8")
    began = time.perf_counter()
    with pytest.raises(PlenoPIVError) as caught:
        Experiment.load(path)
    assert time.perf_counter() - began < 5
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 600
    return message


def test_the_draft_itself_loads(tmp_path):
    path = tmp_path / "run7.toml"
    path.write_text("\ufeff" + DRAFT, encoding="utf-8")  # as editors of Windows write it
    assert Experiment.load(path).recording_table.white == "white.tif"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[volume]", "a = " + "[" * 3000 + "]" * 3000 + "\n[volume]", "nested too deeply"),
        ("[volume]", "a = " + "[" * 3000 + "\n[volume]", "nested too deeply"),
        ("[volume]", "a = " + "[" * 40 + "]" * 40 + "\n[volume]", "nested more than 16 deep"),
        ('"uniform"', '"uniform"\nparameters = ' + "{a = " * 300 + "1" + "}" * 300, "nested more than 16"),
        ("[volume]", "[" + "a." * 100_000 + "a]\n[volume]", "more than 32 parts between dots"),
        ("[volume]", "[" + "'a' . " * 100_000 + "a]\n[volume]", "more than 32 parts between dots"),
        ("dt_s = 0.0005", "dt_s = " + "1" * 5000, "a value that cannot be read"),
        ("dt_s = 0.0005", "dt_s = " + "1" * 4000, "recording.dt_s: is a whole number of 13285 bits"),
        ("dt_s = 0.0005", "dt_s = 1e400", "must be a finite number"),
        ("columns = 1800", "columns = 0x" + "f" * 5000, "a whole number of 20000 bits"),
        ("white.tif", "a\\u0000b.tif", "recording.white: 'a\\x00b.tif' holds a NUL"),
        ('"a.tif"', '"a\\u0000.tif"', "recording.frames: 'a\\x00.tif' holds a NUL"),
        ('["a.tif", "b.tif"]', '"*\\u0000"', "recording.frames: '*\\x00' holds a NUL"),
        ('"results"', '"\\u0000"', "output.directory: '\\x00' holds a NUL"),
        ('"results"', f'"{"a" * 5000}"', "output.directory: has 5000 letters"),
        ("aperture_mm = 25.0", "aperture_mm = 25000.0", "f/0.002, and no lens is faster than f/0.5"),
        ("focal_length_mm = 0.308", "focal_length_mm = 3.08", "micro-images 10 times as wide as their pitch"),
        ("focal_length_mm = 50.0", "focal_length_mm = 1e30", "1e+30 is not between 1e-09 and 1e+09"),
        ("z_mm = [-4.0, 4.0]", "z_mm = [-1e308, 4.0]", "volume.z_mm[0]: -1e+308 is not between"),
        ("dt_s = 0.0005", "dt_s = 5e-324", "recording.dt_s: 4.94066e-324 is not between"),
    ],
)
def test_what_no_parser_or_camera_takes_is_one_line(tmp_path, old, new, said):
    assert said in refused(tmp_path, old, new)


def test_a_file_of_gigabytes_is_not_read_whole(tmp_path):
    path = tmp_path / "frames.toml"
    with path.open("wb") as file:
        file.truncate(4_000_000_000)
    with pytest.raises(PlenoPIVError, match="is larger than 8 MB, so it is no file of settings"):
        Experiment.load(path)


def test_names_of_other_alphabets_are_names(tmp_path):
    """Joiners that are not printable belong to letters of some of them."""
    path = tmp_path / "run7.toml"
    path.write_text(DRAFT.replace("white.tif", "سفید\u200cها white.tif"), encoding="utf-8")
    assert "\u200c" in (Experiment.load(path).recording_table.white or "")


def test_texts_with_many_dots_are_no_keys(tmp_path):
    assert text.tables(b'a = "' + b"..." * 1000 + b'"\nb = ' + b"1." + b"0" * 500, tmp_path)["a"][:3] == "..."
