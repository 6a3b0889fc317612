"""What a check says of microlenses that have moved since the white image."""

import re

import numpy as np
import pytest
from recordings import camera, record, wrong

from plenopiv.calibration.drift import DriftFit
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.checks import check
from plenopiv.checks.drift import NAME, finding
from plenopiv.checks.fit import Fit
from plenopiv.checks.fit import finding as of_fit
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

DRIFT = ArrayDrift((1.6, -1.2), 0.1)


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A recording whose microlenses have moved by 2 px."""
    return simulate_recording(
        tmp_path_factory.mktemp("moved") / "r",
        camera(),
        flow("uniform", velocity_m_s=(0.11, -0.06, 0.17)),
        dt_s=0.0005,
        volume_mm=((-0.7, 0.7), (-0.62, 0.62), (-1.6, 1.6)),
        windows=((48, 48, 20), (32, 32, 16)),
        drift=DRIFT,
        rays=1500,
    ).directory


def findings(folder, drift_measured):
    experiment = Experiment.load(folder / "experiment.toml")
    given = experiment.recording(), experiment.camera(), experiment.grid(), experiment.correlation.settings()
    return check(*given, drift_measured=drift_measured)


@pytest.mark.usefixtures("still")
def test_a_drift_is_named_and_nothing_else_is_wrong(moved):
    found = findings(moved, True)
    assert wrong(found) == {}
    (said,) = [each for each in found.findings if each.name == NAME]
    assert said.number == pytest.approx(2.5, abs=0.2)
    right, down = map(float, re.findall(r"([+-][\d.]+) px", said.words))
    assert (right, down) == (pytest.approx(1.6, abs=0.05), pytest.approx(-1.2, abs=0.05))
    assert "counter-clockwise, which a run takes into account" in said.words
    assert found.fit.shift_px < 0.2
    assert found.camera.lattice != found.lattice.lattice


@pytest.mark.usefixtures("still")
def test_where_it_is_not_to_be_followed_the_recording_is_refused(moved):
    assert not findings(moved, False).usable


@pytest.mark.usefixtures("still")
def test_nothing_is_said_of_an_array_that_stayed(recorded):
    found = findings(recorded(), True)
    assert NAME not in [each.name for each in found.findings]
    assert found.drift is None


@pytest.mark.usefixtures("still")
def test_a_white_image_of_another_lattice_is_judged_as_before(recording, tmp_path):
    other = record(tmp_path / "other", of=camera(rotation_rad=0.08, offset_mm=(0.03, 0.02)))
    (recording / "white.tif").write_bytes((other / "white.tif").read_bytes())
    assert findings(recording, True).drift is None
    assert wrong(findings(recording, True)) == wrong(findings(recording, False)) != {}


@pytest.mark.parametrize(
    ("drift", "words"),
    [
        (ArrayDrift((0.5, -0.25)), "+0.50 px to the right, -0.25 px down, which"),
        (ArrayDrift((0.5, -0.25), -0.02), "-0.25 px down, -0.020 degrees counter-clockwise, which"),
        (ArrayDrift(scale=5e-4), "+0.00 px down, +0.050 % further apart, which"),
    ],
)
def test_what_is_said_of_a_drift(drift, words):
    said = finding(DriftFit(drift, drift, 0.01, 1e-3, 1e-5, 0.02, 9), camera().sensor)
    assert words in said.words
    assert said.number == pytest.approx(drift.most_px(camera().sensor))
    assert finding(DriftFit(ArrayDrift(), drift, 0.01, 1e-3, 1e-5, 0.02, 9), camera().sensor) is None


def test_a_small_shift_that_is_not_followed_says_how_to_follow_it():
    seen = Fit({"as it is": 0.9}, 0.5, np.zeros((1, 2)), np.array([[0.5, 0.3]]))
    assert 'set recording.drift = "auto"' in of_fit(seen, "a.tif").advice
