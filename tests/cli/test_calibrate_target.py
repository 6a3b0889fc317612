"""plenopiv calibrate with [calibration]: what it prints, writes and refuses."""

import json
import re

import numpy as np
import pytest
import tifffile
from calibrations import calibrated
from drafted_recording import COLUMNS, ROWS, edit, tree
from matplotlib.figure import Figure

from plenopiv.cli import main
from plenopiv.cli.calibrate import lines_of, undetermined
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration
from plenopiv.report import calibration
from plenopiv.run import target
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.white import white_image

WORDS = {
    "gap_mm": "window to lens",
    "stop_mm": "stop before",
    "distortion": "distortion at",
    "turn_x_rad": "laboratory turned about x",
}
WRITTEN = {"lattice.toml", "calibration.toml", "calibration.png"}
CALIBRATION = """
[calibration]
target = "dots"
pitch_mm = 0.6
dot_mm = 0.2
origin_dot_mm = 0.36
planes = [{ image = "target_0.tif", z_mm = -1.0 }, { image = "target_1.tif", z_mm = 1.0 }]
"""


def noise(rows, columns, seed):
    return np.random.default_rng(seed).normal(60, 3, (rows, columns)).astype(np.uint16)


@pytest.fixture
def with_target(folder):
    """An experiment file with images of a target, and a white image with a lattice."""
    file = folder / "experiment.toml"
    camera = Experiment.load(file).camera()
    white = digitise(white_image(camera, 3000.0), camera.sensor, SensorNoise(), np.random.default_rng(1))
    tifffile.imwrite(folder / "White_0.tif", white)
    for k in range(2):
        tifffile.imwrite(folder / f"target_{k}.tif", noise(ROWS, COLUMNS, k))
    file.write_text(file.read_text() + CALIBRATION)
    return folder


@pytest.fixture
def known(monkeypatch):
    """A calibration is not computed."""

    def made(experiment, recording, fit, progress):
        assert fit.lattice.kind == "hexagonal"
        progress("target", 4, 4)
        return calibrated()

    monkeypatch.setattr(target, "make_calibration", made)


@pytest.fixture
def undrawn(monkeypatch):
    """Nor is it drawn, which takes seconds."""
    monkeypatch.setattr(calibration, "calibration_figure", lambda found: Figure(figsize=(1, 1)))


@pytest.mark.usefixtures("known")
def test_it_prints_saves_and_draws(with_target, capsys):
    before = set(tree(with_target))
    assert main(["calibrate", str(with_target / "experiment.toml")]) == 0
    text = capsys.readouterr().out
    assert {path.name for path in set(tree(with_target)) - before} == WRITTEN
    for part in (
        "target     264 dots in 4 planes, 207 of them seen whole",
        "focal length                  1.5000 +- 0.0015 mm",
        "laboratory turned about z     +601.61 +- 0.60 deg",
        "   1.400     87     69    0.31    0.42    3.30  target_1.tif",
        "   4.200      3      0     nan     nan     nan  hidden.tif",
        "largest shift of all dots in a view: 0.60 um, in that of pixel (",
        f"saved      {with_target / 'calibration.png'}",
    ):
        assert part in text
    found, inputs = load_calibration(with_target / "calibration.toml")
    assert repr(found) == repr(calibrated())
    assert {"target_0.tif", "target_1.tif", "White_0.tif"} < set(inputs)
    assert (with_target / "calibration.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("known", "undrawn")
def test_as_json(with_target, capsys):
    assert main(["--json", "calibrate", str(with_target / "experiment.toml")]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [event["stage"] for event in events if event["event"] == "progress"] == ["target"]
    found = events[-1]
    assert {name.rsplit("/", 1)[-1] for name in found["files"]} == WRITTEN
    assert found["target"]["parameters"]["gap_mm"] == {"value": 3.5, "std": 0.0035, "undetermined": False}
    assert found["target"]["planes"][3] == {
        "image": "hidden.tif", "z_mm": 4.2, "dots": 3, "whole": 0, "outliers": 0,
        "rms_um": [None] * 3, "mean_um": [None] * 3,
    }  # fmt: skip
    assert found["lattice"]["kind"] == "hexagonal"


@pytest.mark.usefixtures("known", "undrawn")
@pytest.mark.parametrize("name", ["lattice.toml", "calibration.toml"])
def test_what_is_there_is_not_replaced_unasked(with_target, name, one_line):
    (with_target / name).write_text("mine")
    before = tree(with_target)
    assert f"{name}: is already there; use --overwrite to replace it" in one_line(
        "calibrate", with_target / "experiment.toml"
    )
    assert tree(with_target) == before
    assert main(["calibrate", str(with_target / "experiment.toml"), "--overwrite"]) == 0
    assert repr(load_calibration(with_target / "calibration.toml")[0]) == repr(calibrated())


def test_what_fails_writes_nothing(with_target, one_line, monkeypatch):
    def fail(*given):
        raise PlenoPIVError("target_1.tif: 0 dots of a target found")

    monkeypatch.setattr(target, "make_calibration", fail)
    before = tree(with_target)
    assert "target_1.tif: 0 dots" in one_line("calibrate", with_target / "experiment.toml")
    assert tree(with_target) == before


@pytest.mark.full
def test_the_image_of_another_camera(with_target, one_line):
    tifffile.imwrite(with_target / "target_1.tif", noise(ROWS, COLUMNS + 2, 1))
    for command in ("calibrate", "run"):
        message = one_line(command, with_target / "experiment.toml")
        assert "target_1.tif: " in message
        assert f"{COLUMNS + 2} x {ROWS}" in message


def test_an_image_of_the_target_is_missing(with_target, one_line):
    (with_target / "target_0.tif").unlink()
    assert "target_0.tif: " in one_line("calibrate", with_target / "experiment.toml")


@pytest.mark.full
def test_images_without_dots(with_target, one_line):
    message = one_line("calibrate", with_target / "experiment.toml")
    assert re.search(r"target_0.tif: \d dots of a target found, 9 or more are needed", message)
    tifffile.imwrite(with_target / "target_1.tif", np.full((ROWS, COLUMNS), 100, np.uint16))
    assert "target_1.tif: every pixel is 100; the image is blank" in one_line(
        "calibrate", with_target / "experiment.toml"
    )


def test_no_white_image(with_target, one_line):
    edit(with_target, 'white = "White_0.tif"', "")
    edit(with_target, "[camera.microlens_array]", "[camera.microlens_array]\nrotation_deg = 0\noffset_mm = [0, 0]")
    for command in ("calibrate", "run"):
        message = one_line(command, with_target / "experiment.toml")
        assert "recording.white is missing; a calibration needs the white image" in message


def test_a_damaged_calibration_stops_a_run(with_target, one_line):
    (with_target / "calibration.toml").write_text("[inputs]\nmethod = ")
    message = one_line("run", with_target / "experiment.toml")
    assert "calibration.toml: is not valid TOML" in message
    assert message.endswith("make it anew with: plenopiv calibrate --overwrite")


@pytest.mark.parametrize(
    ("medium", "words"),
    [
        ("fluid_mm = 40.0\nrefractive_index = 0.9", "medium.refractive_index"),
        ("fluid_mm = -4.0\nrefractive_index = 1.333", "medium.fluid_mm"),
        ("fluid_mm = 140.0\nrefractive_index = 1.333", "medium.fluid_mm: fluid and window take 105 mm"),
    ],
)
def test_a_fluid_that_is_not_before_the_camera(with_target, one_line, medium, words):
    file = with_target / "experiment.toml"
    file.write_text(file.read_text() + f"\n[medium]\n{medium}\n")
    assert words in one_line("calibrate", file)


def test_what_is_called_undetermined():
    made = calibrated()
    assert not any(line.startswith(WORDS["stop_mm"]) for line in lines_of(made))
    made.values["stop_mm"], made.std["stop_mm"] = 0.0, 0.1
    for name, std, expected in (
        ("gap_mm", 0.049 * made.values["gap_mm"], False),
        ("gap_mm", 0.051 * made.values["gap_mm"], True),
        ("distortion", 0.051, True),
        ("distortion", 0.049, False),
        ("turn_x_rad", 1.0, False),
        ("stop_mm", 0.049 * made.values["focal_length_mm"], False),
        ("stop_mm", 0.051 * made.values["focal_length_mm"], True),
        ("gap_mm", float("nan"), True),
    ):
        made.std[name] = std
        assert undetermined(made, name) == expected
        of_name = [line for line in lines_of(made) if line.startswith(WORDS[name])]
        assert ["undetermined" in line for line in of_name] == [expected]
