"""What the numbers of a run look like when something is wrong: the table of docs/first-steps.md.

    python benchmarks/accuracy/spoilt_table.py [NAME ...]     all cases, or some; prints a row of the table for each

One recording, 800 x 640 px at PMR 14 and M = -1, rotation about y with a drift, windows of 48 x 48 x 16 voxels, spoilt
in one way at a time: light, seeding, displacement, an unrelated second frame, or a wrong key of the experiment file.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from small_recording import CAMERA, DRIFT_M_S, DT_S, VOLUME_MM, WINDOWS, rotation

import plenopiv
from plenopiv.accuracy import score_velocity
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording


@dataclass(frozen=True)
class Case:
    """A recording and what is wrong with it; ``tables`` of the experiment file that are stated otherwise."""

    what: str
    seeding: Seeding = field(default_factory=Seeding)
    noise: SensorNoise = field(default_factory=SensorNoise)
    drift_m_s: float = DRIFT_M_S
    other_second_frame: bool = False
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)


CASES = {
    "good": Case("nothing wrong, 32 particles a window"),
    "dim": Case("dim: 9 counts a particle, 2.3 of noise", Seeding(electrons_per_pixel=20.0), SensorNoise(0.5, 5.0)),
    "thin": Case("thin seeding: 7 particles a window", Seeding(particles_per_microlens=0.1)),
    "dense": Case("dense seeding: 192 particles a window", Seeding(particles_per_microlens=6.0)),
    "shallow": Case("volume half as deep as the illuminated one", tables={"volume": {"z_mm": [-1.25, 1.25]}}),
    "fast": Case("35 voxels per frame along y, where the search range is 24", drift_m_s=1.2),
    "unrelated": Case("second frame of another recording", other_second_frame=True),
    "wrong f_l": Case("f_l stated 10 % too small", tables={"camera": {"microlens_array": {"focal_length_mm": 0.277}}}),
    "wrong f_l, P_m": Case(
        "the same, aperture 11 % too large to match",
        tables={"camera": {"microlens_array": {"focal_length_mm": 0.277}, "main_lens": {"aperture_mm": 27.8}}},
    ),
}


def changed(tables: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Nested tables with some keys replaced."""
    return tables | {
        key: changed(tables[key], value) if isinstance(value, dict) else value for key, value in changes.items()
    }


def row(case: Case, folder: Path) -> str:
    """Simulate, spoil, run, score."""
    flow = rotation(case.drift_m_s)
    how = {"dt_s": DT_S, "volume_mm": VOLUME_MM, "windows": WINDOWS, "noise": case.noise, "seeding": case.seeding}
    made = simulate_recording(folder / "a", CAMERA, flow, seed=5, **how)
    if case.other_second_frame:
        other = simulate_recording(folder / "b", CAMERA, flow, seed=99, **how)
        shutil.copy(other.directory / "b.tif", made.directory / "b.tif")
    stated = Experiment.load(made.directory / "experiment.toml")
    tables = changed(stated.model_dump(by_alias=True, exclude_none=True), case.tables)
    experiment = Experiment.from_dict(tables, stated.path)
    result = plenopiv.process(experiment, force=True)
    velocity, summary, voxel_mm = result.velocity, result.summary, experiment.volume.voxel_mm
    to_voxels = 1e3 * DT_S / np.asarray(voxel_mm)
    std = to_voxels * [float(velocity[f"{name}_std"].median()) for name in "uvw"]
    raw = velocity["u_raw"].values.ravel() * to_voxels[0]
    whole = float(np.mean(np.abs(raw - np.rint(raw)) < 0.1)) / 0.2
    residual = next(iter(summary["reconstruction"].values()))["residual_counts_by_iteration"]
    try:
        particles = made.a.position_mm, made.b.position_mm
        score = score_velocity(
            velocity, *particles, CAMERA, dt_s=DT_S, voxel_mm=voxel_mm, window_voxels=experiment.correlation.windows[-1]
        ).final
        gross = f"{100 * score.gross:.0f}"
        error = " / ".join(f"{e:.2f}" for e in score.rms) if score.gross < 0.5 else "none of use"
    except PlenoPIVError as problem:
        gross, error = "", str(problem)
    cells = [
        case.what,
        f"{100 * summary['replaced_share']:.1f}",
        f"{summary['median_peak_ratio']:.1f}",
        " / ".join(f"{s:.2f}" for s in std),
        f"{whole:.1f}",
        f"{residual[0]:.0f}, {residual[1]:.0f}, {residual[-1]:.0f}",
        str(len(summary["warnings"])),
        error,
        gross,
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """All cases, or those named."""
    warnings.simplefilter("ignore", PlenoPIVWarning)
    for name in sys.argv[1:] or CASES:
        with tempfile.TemporaryDirectory() as folder:
            print(row(CASES[name], Path(folder)), flush=True)


if __name__ == "__main__":
    main()
