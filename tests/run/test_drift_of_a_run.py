"""A run of a recording whose microlenses have moved since the white image: found, followed, said, kept, or refused."""

import json
import shutil

import numpy as np
import pytest
import tomli_w
from conftest import record
from runs import made_once, without_report

import plenopiv
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.drift import MOST, chosen

DRIFT = ArrayDrift((-1.2, 1.6), 0.1)


@pytest.fixture(scope="module", autouse=True)
def _without_report():
    with pytest.MonkeyPatch.context() as patch:
        without_report(patch)
        yield


@pytest.fixture(scope="session")
def moved(tmp_path_factory):
    """A recording of an array that has moved by 2 px."""
    return made_once(tmp_path_factory, "moved", lambda folder: record(folder / "recording", drift=DRIFT).directory)


def changed(folder, drift, name="results", **output):
    """The experiment with another ``recording.drift``."""
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["recording"]["drift"] = drift
    tables["output"] = {"directory": name, **output}
    (folder / f"{name}.toml").write_text(tomli_w.dumps(tables))
    return Experiment.load(folder / f"{name}.toml")


def test_the_chain_has_the_lattice_that_the_frames_show(moved, recorded):
    chain, _, found = calibrated_chain(experiment := Experiment.load(moved / "experiment.toml"), experiment.recording())
    np.testing.assert_allclose(found["drift"]["shift_px"], DRIFT.shift_px, atol=0.05)
    assert found["drift"]["turn_deg"] == pytest.approx(DRIFT.turn_deg, abs=0.03)
    still = calibrated_chain(experiment := changed(moved, "none"), experiment.recording())[0]
    number = np.arange(-5, 6)
    s, t = chain.camera.lattice.centres(number, number)
    s_before, t_before = still.camera.lattice.centres(number, number)
    np.testing.assert_allclose((s - s_before) * 1.0014 / 0.0055, 1.2, atol=0.2)  # +s is to the left
    np.testing.assert_allclose((t - t_before) * 1.0014 / 0.0055, 1.6, atol=0.2)
    assert chain.counts_per_electron == pytest.approx(still.counts_per_electron, rel=1e-3)
    _, _, found = calibrated_chain(experiment := Experiment.load(recorded / "experiment.toml"), experiment.recording())
    assert found["drift"]["shift_px"] == [0.0, 0.0]
    assert found["drift"]["turn_deg"] == found["drift"]["scale"] == 0.0


def test_without_it_the_run_is_refused(moved):
    with pytest.raises(PlenoPIVError, match="off those of the white image"):
        plenopiv.process(changed(moved, "none", "refused"))


@pytest.mark.full
def test_a_run_follows_it_says_so_and_keeps_it(moved, tmp_path):
    shutil.copytree(moved, tmp_path / "recording")
    found = plenopiv.process(changed(tmp_path / "recording", "auto", volumes=True))
    summary = json.loads((tmp_path / "recording" / "results" / "summary.json").read_text())
    said = summary["calibration"]["drift"]
    np.testing.assert_allclose(said["shift_px"], DRIFT.shift_px, atol=0.05)
    assert 0 < said["shift_std_px"] < 0.05
    assert summary["quality"] == "good"
    speeds = [float(np.median(found.velocity[key])) for key in ("u", "v", "w")]
    assert np.all(np.abs(np.subtract(speeds, (0.11, -0.06, 0.17))) < (0.002, 0.002, 0.01))
    again = plenopiv.correlate(tmp_path / "recording" / "results", out=tmp_path / "again")
    np.testing.assert_array_equal(again.velocity["u"], found.velocity["u"])


@pytest.mark.full
def test_none_gives_the_same_bits(recorded, tmp_path):
    shutil.copytree(recorded, tmp_path / "recording")
    found = plenopiv.process(changed(tmp_path / "recording", "auto", "auto"))
    still = plenopiv.process(changed(tmp_path / "recording", "none", "none"))
    np.testing.assert_array_equal(found.velocity["w"], still.velocity["w"])


def test_what_is_no_drift_is_refused_in_one_line(recorded):
    with pytest.raises(PlenoPIVError, match=r"recording\.drift"):
        changed(recorded, "some", "some")


class Frames:
    """As ``Recording`` counts its frames; those ``bad`` cannot be read."""

    def __init__(self, count, bad=()):
        self.pairs, self.bad = tuple((k, k + 1) for k in range(0, count, 2)), bad

    def first_readable_pair(self):
        return next(pair for pair in self.pairs if not set(pair) & set(self.bad)), {}

    def frame(self, k):
        if k in self.bad:
            raise PlenoPIVError("cannot be read")


def test_frames_are_spread_over_the_recording_and_can_be_read():
    assert chosen(Frames(2)) == [0, 1]
    assert chosen(Frames(6)) == [0, 1, 2, 3, 4, 5]
    assert chosen(Frames(6, bad=(3, 1))) == [0, 2, 4, 5]
    many = chosen(Frames(2000))
    assert many[:2] == [0, 1]
    assert len(many) <= MOST
    assert many[-1] > 1600
