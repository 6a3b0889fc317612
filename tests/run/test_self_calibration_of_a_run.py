"""A recording whose calibration is wrong in its views: corrected by its own particles, and used by the next run."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from calibrations import calibrated
from conftest import camera, record

from plenopiv.calibration import find_lattice
from plenopiv.cameras.lens_space import behind_window
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.space_map import ViewShift
from plenopiv.cli import main
from plenopiv.cli.self_calibrate import self_calibrate as said
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration, save_calibration
from plenopiv.run.self_calibrate import SelfCalibration, self_calibrate
from plenopiv.run.target import inputs_of
from plenopiv.tracking.ray_shifts import together
from plenopiv.tracking.with_calibration import Step

TARGET = {
    "target": "dots",
    "pitch_mm": 0.6,
    "dot_mm": 0.2,
    "origin_dot_mm": 0.36,
    "planes": [{"image": f"t{k}.tif", "z_mm": float(k)} for k in range(2)],
}
U_MM, S_MM = 12.5, 1.155
EVERY = [(a, b, c, d) for a in range(4) for b in range(4) for c in range(4) for d in range(4) if a + b + c + d <= 3]
WRONG = {(2, 0, 0, 0): (6e-3, 0.0), (0, 1, 0, 0): (-5e-3, 0.0), (1, 1, 0, 0): (0.0, 6e-3)}


def shift(terms):
    return ViewShift(U_MM, S_MM, 3, tuple(terms.get(power, (0.0, 0.0)) for power in EVERY))


@pytest.fixture
def folder(tmp_path):
    """A recording of a thin lens in air, and a calibration as a target would give it."""
    folder = record(tmp_path / "recording", particles=None).directory
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["calibration"] = TARGET
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return folder


def calibrate(folder, beside):
    """Write the calibration, its rays wrong by ``beside``."""
    experiment = Experiment.load(folder / "experiment.toml")
    recording = experiment.recording()
    sheet = experiment.camera()
    of = sheet.with_lattice(find_lattice(recording.white(), sheet).lattice)
    made = replace(calibrated(), camera=of, model=behind_window(of, Medium(1.0, 1.0)), beside=beside)
    save_calibration(made, inputs_of(experiment, recording), folder / "calibration.toml")
    return experiment


def visible_um(beside):
    """RMS over the aperture of what of a shift differs between views, as particles in the middle see it."""
    angle, radius = 2 * np.pi * np.arange(60) / 1.618, U_MM * np.sqrt((np.arange(60) + 0.5) / 60)
    u = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    flat = 1e3 * beside(u, np.zeros_like(u)).T.ravel()
    ones, none = np.ones(60), np.zeros(60)
    moves = np.stack([np.r_[ones, none], np.r_[none, ones], u.T.ravel()], 1)
    return float(np.sqrt(np.sum((flat - moves @ np.linalg.lstsq(moves, flat, rcond=None)[0]) ** 2) / 60))


@pytest.mark.full
def test_wrong_views_are_corrected_and_a_right_calibration_stays(folder, capsys):
    calibrate(folder, shift(WRONG))
    before = visible_um(shift(WRONG))
    assert main(["--json", "selfcalibrate", str(folder / "experiment.toml")]) == 0
    facts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert facts["corrected"]
    assert facts["settled"]
    assert facts["chi2"][1] < facts["chi2"][0]
    assert facts["hidden"] > 3
    corrected, _ = load_calibration(folder / "calibration.toml")
    assert visible_um(corrected.beside) < 0.35 * before
    experiment = calibrate(folder, None)
    found = self_calibrate(experiment)
    left, _ = load_calibration(folder / "calibration.toml")
    assert found.rms_um < 0.35 * before
    assert left.beside is None or visible_um(left.beside) < 0.35 * before


@pytest.mark.parametrize("settled", [True, False])
def test_steps_that_did_not_settle_are_told_of(tmp_path, monkeypatch, recwarn, settled):
    chi2 = 6.7, 6.6
    found = SelfCalibration(tmp_path / "calibration.toml", None, 0.3, 0.04, 5, 0.08, settled, chi2, 900, 40, 4)
    monkeypatch.setattr("plenopiv.run.self_calibrate.self_calibrate", lambda *given: found)
    monkeypatch.setattr("plenopiv.experiment.Experiment.load", lambda file: None)
    facts = said(tmp_path / "experiment.toml").facts
    assert (facts["settled"], facts["last_step_um"]) == (settled, 0.08)
    words = "calibration.toml: the last of 5 steps still changed the views by 0.08 um RMS"
    assert [words in str(w.message) for w in recwarn] == [True] * (not settled)


@pytest.mark.parametrize(("change", "std", "settled"), [(0.2, 0.1, False), (0.04, 0.01, True), (0.2, 0.3, True)])
def test_steps_settle_where_they_hardly_change_or_by_less_than_is_known(change, std, settled):
    one = np.zeros((1, 3)), np.ones(1), np.array([0.3, 0.4])
    assert Step(*one, std, 1.0, change).settled == settled


def test_without_a_target_there_is_nothing_to_correct(recorded):
    with pytest.raises(PlenoPIVError, match=r"starts from a target: \[calibration\] is missing"):
        self_calibrate(Experiment.load(recorded / "experiment.toml"))


def test_shifts_are_put_together():
    one = shift(WRONG)
    assert together(None, None) is None
    assert together(one, None) is together(None, one) is one
    u = np.array([[3.0, -2.0]])
    np.testing.assert_allclose(together(one, one)(u, u), 2 * one(u, u))


def test_the_map_to_the_laboratory_has_the_shift():
    of = camera()
    made = replace(calibrated(), camera=of, model=behind_window(of, Medium(1.0, 1.0)))
    limits = ((-0.7, 0.7), (-0.6, 0.6), (-1.5, 1.5))
    assert made.space(limits).left is None
    assert replace(made, beside=shift(WRONG)).space(limits).left == shift(WRONG)
