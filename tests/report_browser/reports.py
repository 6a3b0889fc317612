"""The reports that the browser sees: the demo's, one of a rotation before another camera, one of a recording."""

import os
from pathlib import Path

import pytest

import plenopiv
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

ROOT = Path(__file__).parents[2]


def demo(folder):
    """As ``make demo`` left it."""
    path = ROOT / "demo" / "results" / "report.html"
    if not path.exists():
        pytest.skip(f"{path} is missing: make demo")
    return path


def rotation(folder):
    """Solid-body rotation before a camera unlike the demo's: square microlenses, M = -0.8, stored as on the chip; the
    truth is not known to the run."""
    camera = PlenopticCamera(
        MainLens(50.0, 22.5, -0.8),
        Lattice("square", 0.077, -0.005, (0.02, -0.03)),
        0.308,
        Sensor(560, 420, 0.0055, 12, 60),
    )
    made = simulate_recording(
        folder / "recording",
        camera,
        flow("rotation", rate_rad_s=60.0),
        dt_s=0.0005,
        volume_mm=((-1.1, 1.1), (-0.8, 0.8), (-2.6, 2.6)),
        windows=((40, 40, 16), (32, 32, 12)),
        orientation="sensor",
        rays=2000,
        seed=11,
    )
    return plenopiv.process(plenopiv.load(made.directory / "experiment.toml")).directory / "report.html"


def recording(folder):
    """One with inner windows as large as the last, volumes beside the field, and a result that was scored."""
    camera = PlenopticCamera(
        MainLens(50.0, 25.0, -1.0),
        Lattice("hexagonal", 0.077, 0.003, (0.01, 0.02)),
        0.308,
        Sensor(700, 560, 0.0055, 12, 60),
    )
    made = simulate_recording(
        folder / "recording",
        camera,
        flow("vortex-ring", radius_mm=0.9, core_radius_mm=0.4, circulation_mm2_s=300.0, drift_m_s=(0.0, 0.1, 0.05)),
        dt_s=0.0005,
        volume_mm=((-1.5, 1.5), (-1.1, 1.1), (-2.5, 2.5)),
        windows=((64, 64, 24), (48, 48, 16)),
        rays=2000,
        seed=12,
    )
    experiment = Experiment.load(made.directory / "experiment.toml")
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["correlation"]["inner_window"] = tables["correlation"]["windows"][-1]
    tables["output"]["volumes"] = True
    changed = Experiment.from_dict(tables, experiment.path)
    scored = plenopiv.process(changed, score=lambda velocity: {"largest u (m/s)": float(velocity.u.max())})
    return scored.directory / "report.html"


def named(folder):
    """The one that PLENOPIV_REPORT names."""
    return Path(os.environ["PLENOPIV_REPORT"]).resolve()


MAKERS = {"named": named} if "PLENOPIV_REPORT" in os.environ else {f.__name__: f for f in (demo, rotation, recording)}
