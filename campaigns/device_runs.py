"""Whole runs by the code for a graphics processor, on this processor, beside the usual ones:  device_runs.py

Recordings of conditions (benchmarks/accuracy/conditions.py) under build/device_runs, each run twice from images to
vectors by ``plenopiv run``, with ``--device cpu`` and ``--device jax-cpu``. A name that is a folder's path: the
recording there (experiment.toml, truth_particles.npz), which is copied. Writes campaigns/results/device_runs.json after
each: how far vectors are apart, RMS along x, y, z in voxels, where both are valid; share of equal valid flags; RMS
errors of both against the particles; seconds and memory; of the first condition also whether a second run on the device
gives the same bits; a hash of the sources that this holds for. What is recorded for the sources as they are is not run
again. Exit code 1 where vectors differ by .005 voxel RMS or RMS errors by 1 %, or bits.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numba_versions import sources_hash

from plenopiv.experiment import Experiment
from plenopiv.io.netcdf import read_velocity

ROOT = Path(__file__).parents[1]
BUILD, RESULTS = ROOT / "build" / "device_runs", ROOT / "campaigns" / "results" / "device_runs.json"
NAMES = "base", "square", "dim", "vortex-ring", "half"
TWICE = ("base",)
DEVICES = "cpu", "jax-cpu"
APART_VOXELS, OF_SCORES = 0.005, 0.01  # at most, RMS of vectors and share of RMS errors
SIMULATE = "import sys; sys.path.insert(0, 'benchmarks/accuracy'); import run_conditions as r; r.main()"
RUN = [sys.executable, "-c", "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))", "run", "-q"]


def computed(name: str, device: str, results: str = "") -> Path:
    """The ``results`` of a recording on a device, in a folder of that name, by default the device's."""
    folder = BUILD / Path(name).name
    if name != folder.name and not folder.exists():
        shutil.copytree(name, folder)
    if not (folder / "experiment.toml").exists():
        command = [sys.executable, "-c", SIMULATE, name, "--out", str(BUILD), "--simulate-only"]
        subprocess.run(command, cwd=ROOT, check=True)
    results = results or device
    of_device = folder / f"{results}.toml"
    text = (folder / "experiment.toml").read_text().partition("[output]")[0]
    of_device.write_text(text + f'\n[output]\ndirectory = "{results}"\n')
    subprocess.run([*RUN, str(of_device), "--device", device, "--overwrite"], cwd=ROOT, check=True)
    return folder / results


def rms_errors(velocity: xr.Dataset, experiment: Experiment) -> list[float]:
    """RMS errors along x, y, z against the particles, in voxels."""
    sys.path.insert(0, str(ROOT / "benchmarks" / "accuracy"))
    from true_particles import scored

    return list(scored(velocity, experiment).as_dict()["final"]["rms"])


def beside(name: str) -> dict[str, Any]:
    """Both runs of a recording."""
    folders = [computed(name, device) for device in DEVICES]
    experiment = Experiment.load(folders[0].parent / "experiment.toml")
    usual, found = (read_velocity(folder / "velocity.nc") for folder in folders)
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in folders]
    both = (usual.valid.values == 1) & (found.valid.values == 1)
    step = 1e-3 * np.array(experiment.volume.voxel_mm) / experiment.recording_table.dt_s
    apart = [np.sqrt(np.mean((found[k].values - usual[k].values)[both] ** 2)) for k in "uvw"] / step
    errors = [rms_errors(velocity, experiment) for velocity in (usual, found)]
    again = {}
    if name in TWICE:
        twice = read_velocity(computed(name, DEVICES[-1], "again") / "velocity.nc")
        again["same_bits"] = all(twice[key].equals(found[key]) for key in found.data_vars)
    return again | {
        "vectors": int(both.size),
        "same_valid": float(np.mean(usual.valid.values == found.valid.values)),
        "apart_voxels": apart.tolist(),
        "rms": dict(zip(DEVICES, errors, strict=True)),
        "timings_s": {d: s["timings_s"] for d, s in zip(DEVICES, summaries, strict=True)},
        "peak_memory_gb": {d: s["peak_memory_gb"] for d, s in zip(DEVICES, summaries, strict=True)},
    }


def agree(line: dict[str, Any]) -> bool:
    """Whether the runs of a recording agree as they should."""
    one, other = (np.array(line["rms"][device]) for device in DEVICES)
    alike = max(line["apart_voxels"]) < APART_VOXELS and (abs(other / one - 1) < OF_SCORES).all()
    return bool(alike and line.get("same_bits", True))


def main() -> None:
    """Run what is not recorded yet; exit 1 where the runs of a recording differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"conditions or folders, default {' '.join(NAMES)}")
    names, state = parser.parse_args().names or NAMES, sources_hash(("src/plenopiv",))
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if found.get("sources") != state:
        found = {"sources": state, "runs": {}}
    for each in names:
        name = Path(each).name
        if name not in found["runs"]:
            found["runs"][name] = beside(each)
            RESULTS.write_text(json.dumps(found, indent=1) + "\n")
        line = found["runs"][name]
        rms = "  ".join(f"{device} {np.round(line['rms'][device], 4)}" for device in DEVICES)
        print(f"{name:12s} apart {np.array(line['apart_voxels'])} voxel  {rms}", flush=True)
    sys.exit(not all(agree(line) for line in found["runs"].values()))


if __name__ == "__main__":
    main()
