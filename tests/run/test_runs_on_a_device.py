"""Vectors and whole runs by the code of a graphics processor, on this processor, through the same commands."""

import json
import tomllib

import numpy as np
import pytest

pytest.importorskip("jax")

import plenopiv
from plenopiv.cli import main
from plenopiv.io.manifest import Manifest
from plenopiv.io.netcdf import read_velocity

pytestmark = [pytest.mark.usefixtures("without_report"), pytest.mark.full]


def apart_voxels(one, other, experiment):
    """RMS (u, v, w) between the vectors of two fields that both measured, in voxels."""
    both = (one.valid.values == 1) & (other.valid.values == 1)
    assert both.mean() > 0.95
    step = 1e-3 * np.array(experiment.volume.voxel_mm) / experiment.recording_table.dt_s  # m/s
    found = [np.sqrt(np.mean((one[k].values - other[k].values)[both] ** 2)) for k in "uvw"]
    return np.array(found) / step


def test_vectors_of_kept_volumes(upright, tmp_path, capsys):
    out = tmp_path / "again"
    command = ["correlate", str(upright.directory), "--out", str(out), "--device", "jax-cpu"]
    assert main(command) == 0
    assert "device: this processor, JAX" in capsys.readouterr().err
    experiment = plenopiv.load(upright.directory / "experiment.toml")
    found, usual = read_velocity(out / "velocity.nc"), read_velocity(upright.directory / "velocity.nc")
    assert (apart_voxels(found, usual, experiment) < 0.005).all()
    np.testing.assert_allclose(found.u_std, usual.u_std, rtol=0.02)
    np.testing.assert_array_equal(found.valid, usual.valid)

    summary = json.loads((out / "summary.json").read_text())
    assert summary["device"] == "jax-cpu: this processor"
    assert summary["device_memory_estimate_gb"] > 0
    assert {"jax", "jaxlib"} < set(summary["versions"])
    assert tomllib.loads((out / "experiment.toml").read_text())["compute"] == {"device": "jax-cpu"}
    inputs = Manifest.read(out / "manifest.jsonl").inputs
    assert (inputs["device"], inputs["versions"]["jax"]) == (summary["device"], summary["versions"]["jax"])

    before = (out / "velocity.nc").read_bytes()
    assert main(command) == 0
    assert "nothing to do" in capsys.readouterr().err
    assert main([*command[:-1], "cpu"]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert "device: was" in told
    assert "--overwrite" in told
    assert (out / "velocity.nc").read_bytes() == before


def test_a_whole_run_and_the_usual_one(experiment, upright, capsys):
    """From images to vectors: candidates, MART and correlation on the device."""
    assert main(["run", str(experiment.path), "--device", "jax-cpu"]) == 0
    told = capsys.readouterr().err
    assert "device: this processor, JAX" in told
    found, usual = (
        read_velocity(folder / "velocity.nc") for folder in (experiment.output_directory, upright.directory)
    )
    apart = apart_voxels(found, usual, experiment)
    assert (apart < 0.005).all(), apart
    assert (found.valid.values == usual.valid.values).mean() > 0.99
    one, other = (
        json.loads((folder / "summary.json").read_text())["reconstruction"]["a.tif"]
        for folder in (experiment.output_directory, upright.directory)
    )
    assert one["candidate_share"] == pytest.approx(other["candidate_share"], rel=1e-4)
    np.testing.assert_allclose(one["residual_counts_by_iteration"], other["residual_counts_by_iteration"], rtol=1e-3)


def test_ensembles_stay_on_this_processor(upright, tmp_path, capsys):
    command = ["correlate", str(upright.directory), "--out", str(tmp_path / "out"), "--ensemble", "--device", "jax-cpu"]
    assert main(command) == 2
    assert "give --device cpu" in capsys.readouterr().err
