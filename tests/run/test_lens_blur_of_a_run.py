"""A run of a recording whose main lens is not sharp: found where the file says "auto", used, kept, and refused."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from conftest import camera, record
from runs import made_once, without_report

import plenopiv
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run.calibrated import calibrated_chain

BLUR_MM = 0.03


@pytest.fixture(scope="module", autouse=True)
def _without_report():
    with pytest.MonkeyPatch.context() as patch:
        without_report(patch)
        yield


@pytest.fixture(scope="session")
def blurred(tmp_path_factory):
    """A recording through a lens that is not sharp, its file as ``simulate_recording`` writes it."""

    def make(folder):
        return record(folder / "recording", through=replace(camera(), blur_mm=BLUR_MM)).directory

    return made_once(tmp_path_factory, "blurred", make)


def run(folder, blur_mm, name, **output):
    """The run of a recording with another ``blur_mm``; its result and results folder."""
    tables = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["main_lens"]["blur_mm"] = blur_mm
    tables["output"] = {"directory": name, **output}
    (folder / f"{name}.toml").write_text(tomli_w.dumps(tables))
    return plenopiv.process(Experiment.load(folder / f"{name}.toml")), folder / name


def test_the_file_of_a_simulation_states_its_blur(blurred):
    assert Experiment.load(blurred / "experiment.toml").camera().blur_mm == BLUR_MM


@pytest.mark.full
def test_the_chain_of_an_auto_blur_has_what_the_particles_show(blurred):
    tables = Experiment.load(blurred / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["main_lens"]["blur_mm"] = "auto"
    experiment = Experiment.from_dict(tables, blurred / "experiment.toml")
    assert experiment.camera().blur_mm == 0
    chain, _, found = calibrated_chain(experiment, experiment.recording())
    assert chain.camera.blur_mm == found["blur_mm"] == pytest.approx(BLUR_MM, rel=0.2)


def test_too_few_particles_leave_the_lens_sharp_and_are_told(blurred):
    tables = Experiment.load(blurred / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["main_lens"]["blur_mm"] = "auto"
    tables["volume"] |= {"x_mm": [-0.2, 0.2], "y_mm": [-0.2, 0.2]}
    tables["correlation"]["windows"] = [[16, 16, 16]]
    experiment = Experiment.from_dict(tables, blurred / "experiment.toml")
    with pytest.warns(PlenoPIVWarning, match="too few particles, or lit .* to tell; the lens is taken as sharp"):
        chain, _, found = calibrated_chain(experiment, experiment.recording())
    assert chain.camera.blur_mm == found["blur_mm"] == 0


@pytest.mark.full
def test_auto_finds_the_blur_measures_with_it_and_keeps_it(blurred, tmp_path):
    found, results = run(blurred, "auto", "auto", volumes=True)
    calibration = json.loads((results / "summary.json").read_text())["calibration"]
    assert calibration["blur_mm"] == pytest.approx(BLUR_MM, rel=0.2)
    assert 0 < calibration["blur_std_mm"] < 0.01
    stated, _ = run(blurred, calibration["blur_mm"], "stated")
    for key in ("u", "v", "w"):
        np.testing.assert_array_equal(found.velocity[key], stated.velocity[key])
    again = plenopiv.correlate(results, out=tmp_path / "again")
    np.testing.assert_array_equal(again.velocity["u"], found.velocity["u"])


@pytest.mark.full
def test_auto_finds_none_of_a_sharp_lens_and_gives_the_same_bits(recorded, tmp_path):
    shutil.copytree(recorded, tmp_path / "recording")
    found, results = run(tmp_path / "recording", "auto", "auto")
    assert json.loads((results / "summary.json").read_text())["calibration"]["blur_mm"] == 0
    sharp, _ = run(tmp_path / "recording", 0.0, "sharp")
    np.testing.assert_array_equal(found.velocity["w"], sharp.velocity["w"])


@pytest.mark.parametrize("value", ["soft", -0.02, True, 20.0, [0.02]])
def test_what_is_no_blur_is_refused_in_one_line(recorded, value):
    tables = Experiment.load(recorded / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    tables["camera"]["main_lens"]["blur_mm"] = value
    with pytest.raises(PlenoPIVError, match=r"camera\.main_lens\.blur_mm.* is neither ") as error:
        Experiment.from_dict(tables, recorded / "experiment.toml")
    assert "\n" not in str(error.value)
    assert "and 1 more" not in str(error.value)
