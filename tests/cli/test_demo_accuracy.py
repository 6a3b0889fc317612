"""The demo's score, on fields whose errors are known."""

import numpy as np
import pytest
import xarray as xr

from plenopiv.cli.demo import TABLES, accuracy
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import flow


def test_known_errors_are_scored():
    truth = flow("rotation", rate_rad_s=80.0, drift_m_s=[0.0, 0.1, 0.0])
    axes = {"time": [0.0], "z": np.linspace(-2, 2, 5), "y": np.linspace(-1, 1, 4), "x": np.linspace(-1, 1, 5)}
    z, y, x = np.meshgrid(axes["z"], axes["y"], axes["x"], indexing="ij")
    velocity = truth(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(5, 4, 5, 3)
    voxel_mm, dt_s = (0.02, 0.02, 0.08), 0.0005
    velocity += np.array([0.1, -0.2, 0.3]) * voxel_mm / (1e3 * dt_s)  # voxels to m/s
    velocity[0, 0, 0] += 3 * 0.02 / (1e3 * dt_s)  # gross: counted, not in the RMS
    valid = np.ones((5, 4, 5), np.int8)
    velocity[1, 1, 1], valid[1, 1, 1] = 1e6, 0  # replaced: left out
    dims = ("time", "z", "y", "x")
    values = {name: (dims, velocity[None, ..., i]) for i, name in enumerate("uvw")} | {"valid": (dims, valid[None])}
    scores = accuracy(xr.Dataset(values, axes), truth, voxel_mm, dt_s)
    assert scores["vectors"] == 99
    assert scores["gross errors (%)"] == pytest.approx(100 / 99)
    assert [scores[f"RMS along {axis} (voxel)"] for axis in "xyz"] == pytest.approx([0.1, 0.2, 0.3])


def test_the_demo_is_seen_by_every_view_and_loads():
    experiment = Experiment.from_dict(TABLES)
    assert experiment.warnings() == []
    flow(experiment.simulation.flow, **experiment.simulation.parameters)
