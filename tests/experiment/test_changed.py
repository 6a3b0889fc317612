"""Experiments changed in Python: what is kept, what is checked, what each mistake is told."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from test_experiment_file import TEXT

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

SIMULATED = (
    TEXT
    + """
[simulation]
flow = "uniform"
seed = 4
"""
)


@pytest.fixture
def experiment():
    return Experiment.from_dict(tomllib.loads(SIMULATED), "data/run7.toml")


def test_a_key_by_its_name_and_nothing_else(experiment):
    other = experiment.changed(windows=np.array([[64, 64, 16]]), overlap=0.75, directory=Path("finer"))
    assert other.correlation.windows == ((64, 64, 16),)
    assert other.correlation.overlap == 0.75
    assert other.output_directory == Path("data/finer")
    assert other.path == experiment.path
    back = other.changed(windows=experiment.correlation.windows, overlap=experiment.correlation.overlap)
    assert back.changed(directory=experiment.output.directory) == experiment
    assert experiment.correlation.windows == ((128, 128, 32), (64, 64, 16))  # itself is as it was


def test_defaults_that_follow_others_still_follow(experiment):
    assert experiment.changed(windows=[[64, 64, 16]]).correlation.settings().passes[-1].window == (48, 48, 13)
    assert experiment.changed(inner_window=[40, 40, 10]).changed(inner_window=None) == experiment


def test_tables_are_merged_dotted_names_reach_everywhere_and_none_takes_out(experiment):
    other = experiment.changed(volume={"z_mm": (-2.0, 2.0)}, simulation={"seed": 5})
    assert (other.volume.z_mm, other.volume.x_mm) == ((-2.0, 2.0), experiment.volume.x_mm)
    assert (other.simulation.seed, other.simulation.flow) == (5, "uniform")
    assert other.reconstruction.seed == experiment.reconstruction.seed
    assert experiment.changed(**{"simulation.seed": 5}).simulation.seed == 5
    assert experiment.changed(camera={"sensor": {"black_level": 32}}).camera().sensor.black_level == 32
    assert experiment.changed(simulation=None).simulation is None
    assert experiment.changed(f_number=2.0, aperture_mm=None).camera().main_lens.aperture_mm == pytest.approx(25.0)
    assert experiment.changed(simulation=None).changed(simulation={"flow": "abc"}).simulation.flow == "abc"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"seed": 3}, "seed: is a key of [reconstruction] and [simulation]; write changed(**{"),
        ({"window": 3}, "window: unknown key; did you mean correlation.windows?"),
        ({"correlation": {"windws": 1}}, "correlation.windws: unknown key; did you mean windows?"),
        ({"volume.windows": 1}, "volume.windows: unknown key"),
        ({"windows": [[640, 64, 16]]}, "correlation.windows[0]: 640 voxels along x do not fit"),
        ({"dt_s": "1"}, "recording.dt_s: must be a number"),
        ({"f_number": 2.0}, "exactly one of aperture_mm and f_number"),
        ({"volume": None}, "volume: missing; add a [volume] table"),
        ({"correlation": 3}, "correlation: must be a table"),
    ],
)
def test_mistakes_are_told_as_those_of_a_file(experiment, keys, said):
    with pytest.raises(PlenoPIVError) as caught:
        experiment.changed(**keys)
    assert str(caught.value).startswith("data/run7.toml: ")
    assert said in str(caught.value)


def test_a_notebook_shows_it_in_two_lines(experiment):
    text = repr(experiment)
    assert text == str(experiment)
    assert text.count("\n") == 1
    assert "data/run7.toml" in text
    assert "windows 128 x 128 x 32, 64 x 64 x 16 voxels, dt 0.0005 s, results in results" in text
