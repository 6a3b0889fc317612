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
from plenopiv.run.calibrated import calibrated_camera, calibrated_chain
from plenopiv.run.drift import MOST, alike, chosen, with_drift
from plenopiv.sensor import Sensor

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


@pytest.fixture(scope="session")
def moved_pairs(tmp_path_factory):
    """Three pairs of an array that has moved by 2 px, of few particles."""

    def made(folder):
        for k in (1, 2, 3):
            one = record(folder / "made", drift=DRIFT, seed=k, rays=1500, overwrite=True).directory
            for pulse in "ab":
                shutil.copy(one / f"{pulse}.tif", folder / f"p{k}_{pulse}.tif")
        shutil.copy(one / "white.tif", folder)
        shutil.copy(one / "experiment.toml", folder)
        return folder

    return made_once(tmp_path_factory, "moved-pairs", made)


def of_pairs(folder, count):
    """The experiment whose list names the first ``count`` pairs."""
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["recording"].pop("frames", None)
    tables["recording"]["pairs"] = [[f"p{k}_a.tif", f"p{k}_b.tif"] for k in range(1, count + 1)]
    tables["reconstruction"] = {"iterations": 1}
    return Experiment.from_dict(tables, folder / "experiment.toml")


def test_a_recording_that_grows_keeps_the_drift_of_its_finished_pairs(moved_pairs):
    two, three = (of_pairs(moved_pairs, count).recording() for count in (2, 3))
    camera, _ = calibrated_camera(of_pairs(moved_pairs, 2), two)
    first, found = with_drift(camera, two)
    anew, other = with_drift(camera, three)
    assert anew != first  # three pairs tell it a little otherwise
    before = json.loads(json.dumps({"camera": {}, **found}))  # as the manifest has it
    assert with_drift(camera, three, before) == (first, found)
    assert with_drift(camera, three, {"drift": None}) == (anew, other)  # 2 px are another array


def test_pairs_are_kept_though_more_of_them_tell_the_drift_otherwise(moved_pairs, tmp_path):
    shutil.copytree(moved_pairs, tmp_path / "recording")
    plenopiv.process(of_pairs(tmp_path / "recording", 2), pairs=(0, 0))
    (kept,) = (tmp_path / "recording" / "results" / ".plenopiv" / "pairs").glob("*.json")
    written = kept.stat().st_mtime_ns
    found = plenopiv.process(of_pairs(tmp_path / "recording", 3), pairs=(0, 0))
    assert found.measured == (1, 3)
    assert kept.stat().st_mtime_ns == written


SENSOR = Sensor(1200, 1600, 0.0055, 12, 60)  # corners are 1000 px from the middle


@pytest.mark.parametrize(
    ("shift_px", "turn_deg", "scale", "std_px", "same"),
    [
        ((-1.2, 1.6), 0.1, 0.0, 0.002, True),
        ((-1.15, 1.65), 0.1, 0.0, 0.002, True),
        ((-1.1, 1.7), 0.1, 0.0, 0.002, False),  # it moved on
        ((-1.1, 1.7), 0.1, 0.0, 0.03, True),  # or is not known so well
        ((-1.2, 1.6), 0.105, 0.0, 0.002, True),  # .09 px in a corner
        ((-1.2, 1.6), 0.107, 0.0, 0.002, False),
        ((-1.2, 1.6), 0.1, 0.0002, 0.002, False),
        (None, None, None, None, False),
    ],
)
def test_drifts_are_one_where_they_differ_by_less_than_they_are_known(shift_px, turn_deg, scale, std_px, same):
    def stated(shift_px, turn_deg, scale, std_px):
        std = {"shift_std_px": std_px, "turn_std_deg": 0.0, "scale_std": 0.0}
        return {"shift_px": list(shift_px), "turn_deg": turn_deg, "scale": scale, **std}

    one = stated((-1.2, 1.6), 0.1, 0.0, 0.002)
    other = None if shift_px is None else stated(shift_px, turn_deg, scale, std_px)
    assert alike(one, other, SENSOR) == alike(other, one, SENSOR) == same
    none = stated((0.0, 0.0), 0.0, 0.0, 0.002)
    assert alike(none, None, SENSOR)
    assert alike(None, None, SENSOR)


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
