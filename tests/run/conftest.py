"""A small simulated recording, its run, and the truth."""

import json
import shutil
import subprocess
import sys
import tomllib
from typing import NamedTuple

import numpy as np
import pytest
import tifffile
import tomli_w
from runs import made_once, without_report

import plenopiv
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

HOT = (slice(100, 300, 7), slice(200, 340, 7))  # rows, columns
VELOCITY_M_S = (0.11, -0.06, 0.17)  # 3.2, -1.8 and 1.1 voxels in 0.5 ms: another size and sign on each axis


def camera(columns=420, rows=380):
    return PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
        0.308,
        Sensor(columns, rows, 0.0055, 12, 60),
    )


def record(folder, through=None, **options):
    settings = {
        "dt_s": 0.0005,
        "volume_mm": ((-0.75, 0.75), (-0.65, 0.65), (-1.6, 1.6)),
        "windows": ((48, 48, 20), (32, 32, 16)),
        "rays": 4000,
        "seed": 3,
    }
    return simulate_recording(
        folder, through or camera(), flow("uniform", velocity_m_s=VELOCITY_M_S), **settings | options
    )


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """The folder of an upright recording of a uniform flow."""
    return made_once(tmp_path_factory, "upright", lambda folder: record(folder / "recording").directory)


@pytest.fixture
def experiment(recorded, tmp_path):
    """The same in a folder of its own."""
    shutil.copytree(recorded, tmp_path / "recording")
    return Experiment.load(tmp_path / "recording" / "experiment.toml")


@pytest.fixture(name="without_report")
def _without_report(monkeypatch):
    without_report(monkeypatch)


@pytest.fixture(scope="session")
def three_pairs(tmp_path_factory):
    """A folder of three pairs, p1_a.tif to p3_b.tif, and a quick experiment; not to be changed."""

    def made(folder):
        for k in (1, 2, 3):
            one = record(folder / "made", seed=k, overwrite=True).directory
            for pulse in "ab":
                shutil.copy(one / f"{pulse}.tif", folder / f"p{k}_{pulse}.tif")
        shutil.copy(one / "white.tif", folder)
        tables = tomllib.loads((one / "experiment.toml").read_text())
        tables["recording"].pop("frames")
        tables["recording"]["pairs"] = "p*_{a,b}.tif"
        tables["reconstruction"] = {"iterations": 2}
        (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
        shutil.rmtree(folder / "made")
        return folder

    return made_once(tmp_path_factory, "pairs", made)


@pytest.fixture(scope="session")
def upright(recorded, tmp_path_factory):
    """The result of a run with all that may be asked of one: volumes of its frames, and a score; not to be changed."""

    def made(folder):
        folder /= "recording"
        shutil.copytree(recorded, folder)
        text = (folder / "experiment.toml").read_text()
        (folder / "experiment.toml").write_text(text + "volumes = true\n")  # [output] is the last table
        experiment = plenopiv.load(folder / "experiment.toml")
        with pytest.MonkeyPatch.context() as patch:
            without_report(patch)
            return plenopiv.process(experiment, score=lambda velocity: {"largest w (m/s)": float(velocity.w.max())})

    return made_once(tmp_path_factory, "all", made)


class Finished(NamedTuple):
    """A run from the command line in a process of its own: its experiment, what it printed, and its summary."""

    experiment: Experiment
    out: str
    err: str
    summary: dict


@pytest.fixture(scope="session")
def finished(recorded, tmp_path_factory):
    """The recording run once for all tests that only read what a run leaves; not to be changed."""

    def made(folder):
        shutil.copytree(recorded, folder / "recording")
        file = folder / "recording" / "experiment.toml"
        return file, *_run_alone(file)

    file, out, err = made_once(tmp_path_factory, "finished", made)
    experiment = Experiment.load(file)
    summary = json.loads((experiment.output_directory / "summary.json").read_text())
    return Finished(experiment, out, err, summary)


def _run_alone(file):
    """What a run from the command line prints on stdout and stderr."""
    program = "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))"
    # by way of a small process: Linux counts what the one before had in memory as the new one's peak
    between = "import subprocess, sys; sys.exit(subprocess.run(sys.argv[1:]).returncode)"
    command = [sys.executable, "-c", between, sys.executable, "-c", program, "run", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout, ended.stderr


def sequence(recorded, folder, names, **recording):
    """The recording in ``folder`` as a sequence of the frames ``names``, copies of a.tif and b.tif in turn, with its
    volumes kept and quickly reconstructed."""
    shutil.copytree(recorded, folder)
    for k, name in enumerate(names[2:]):
        shutil.copy(folder / f"{'ab'[k % 2]}.tif", folder / name)
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"] |= {"frames": names} | recording
    tables["reconstruction"] = {"iterations": 2}
    tables["output"] = {"volumes": True}
    (folder / "experiment.toml").write_text(tomli_w.dumps(tables))
    return Experiment.load(folder / "experiment.toml")


@pytest.fixture(scope="session")
def masked(recorded, tmp_path_factory):
    """The results of a sequence of three frames, a part of the sensor masked and pixels hot; not to be changed."""

    def made(folder):
        folder /= "recording"
        polygon = [[0, 0], [140, 0], [140, 150], [0, 150]]
        shape = tifffile.imread(recorded / "a.tif").shape
        dark = np.full(shape, 60, np.uint16)
        dark[HOT] = 400
        experiment = sequence(recorded, folder, ["a.tif", "b.tif", "c.tif"], mask=[polygon], dark="dark.tif")
        tifffile.imwrite(folder / "dark.tif", dark)
        with pytest.MonkeyPatch.context() as patch:
            without_report(patch)
            return plenopiv.process(experiment).directory

    return made_once(tmp_path_factory, "masked", made)
