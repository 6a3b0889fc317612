"""Bad images and experiment files: one line, exit code 2, nothing written."""

import numpy as np
import pytest
import tifffile
from drafted_recording import COLUMNS, ROWS, edit, tree

IMAGES = {
    "missing": (lambda path: path.unlink(), "no such file"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:60000]), "truncated"),
    "size": (lambda path: tifffile.imwrite(path, np.ones((448, 560), np.uint16)), "is 560 x 448 pixels"),
    "depth": (lambda path: tifffile.imwrite(path, np.ones((ROWS, COLUMNS), np.uint8)), "holds 8 bits"),
    "over": (lambda path: tifffile.imwrite(path, rising(np.uint16) + 4000), "above full scale of 12 bits"),
    "colour": (
        lambda path: tifffile.imwrite(path, np.stack([rising(np.uint16)] * 3, -1), photometric="rgb"),
        "colour cameras are not supported",
    ),
    "nan": (lambda path: tifffile.imwrite(path, rising(np.float32) * np.nan), "holds float32 values"),
    "pages": (
        lambda path: tifffile.imwrite(path, np.stack([rising(np.uint16)] * 2), photometric="minisblack"),
        "holds 2 images",
    ),
    "png": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50)), "no image file that is known"),
}


def rising(dtype):
    return (np.arange(ROWS * COLUMNS) % 1000).reshape(ROWS, COLUMNS).astype(dtype)


@pytest.mark.parametrize("command", ["run", "calibrate"])
@pytest.mark.parametrize("kind", IMAGES)
def test_a_bad_image_ends_a_command_with_one_line(folder, one_line, command, kind):
    spoil, expected = IMAGES[kind]
    spoil(folder / "White_0.tif")
    before = tree(folder)
    message = one_line(command, folder / "experiment.toml")
    assert expected in message
    assert "White_0.tif" in message
    assert tree(folder) == before


@pytest.mark.parametrize("kind", [kind for kind in IMAGES if kind != "over"])  # pixel values are seen when read
def test_a_bad_frame_is_found_before_any_work(folder, one_line, kind):
    spoil, expected = IMAGES[kind]
    spoil(folder / "frame10.tif")
    message = one_line("calibrate", folder / "experiment.toml")
    assert expected in message
    assert "frame10.tif" in message


@pytest.mark.parametrize("command", ["run", "calibrate", "info"])
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("aperture_mm", "apperture_mm", "did you mean aperture_mm?"),
        ("focal_length_mm = 50.0", 'focal_length_mm = "50"', "must be a number"),
        ("focal_length_mm = 50.0", "focal_length_mm = nan", "must be a finite number"),
        ("focal_length_mm = 50.0", "focal_length_mm = -50.0", "must be greater than 0"),
        ("focal_length_mm = 50.0", "focal_length_mm = ", "line 9"),
        ("z_mm = [-1.5, 1.5]", "z_mm = [-1.5, 150.0]", "not in front of the main lens"),
        ("z_mm = [-1.5, 1.5]", "z_mm = [1.5, -1.5]", "is not below the upper one"),
        ('frames = ["frame9.tif", "frame10.tif"]', 'frames = ["frame9.tif"]', "at least two"),
        ("dt_s = 0.0005", "", "recording.dt_s: missing"),
    ],
)
def test_a_bad_experiment_ends_a_command_with_one_line(folder, one_line, command, old, new, expected):
    file = edit(folder, old, new)
    before = tree(folder)
    message = one_line(command, file)
    assert expected in message
    assert "experiment.toml" in message
    assert tree(folder) == before


def test_a_glob_that_finds_one_frame_or_none(folder, one_line):
    file = edit(folder, '["frame9.tif", "frame10.tif"]', '"frame9*.tif"')
    assert "1 frame (frame9.tif)" in one_line("calibrate", file)
    edit(folder, '"frame9*.tif"', '"shot*.tif"')
    assert "no file matches 'shot*.tif'" in one_line("calibrate", file)


def test_a_calibration_that_finds_no_lattice_writes_none(folder, one_line):
    assert "White_0.tif" in one_line("calibrate", folder / "experiment.toml")
    assert not (folder / "lattice.toml").exists()
