"""``plenopiv demo``: a small synthetic recording of a known flow, measured and scored against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.accuracy.profile import error_by_depth
from plenopiv.cli.progress import Progress
from plenopiv.cli.simulate import recorded
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.run.series import run as run_series
from plenopiv.simulation.flows import Velocity, flow

if TYPE_CHECKING:
    import xarray

GROSS_VOXELS = 2.0  # an error of more than this on any axis is a gross one
TABLES = {
    "camera": {
        "kind": "plenoptic",
        "main_lens": {"focal_length_mm": 50.0, "aperture_mm": 25.0, "magnification": -1.0},
        "microlens_array": {
            "lattice": "hexagonal",
            "pitch_mm": 0.077,
            "focal_length_mm": 0.308,
            "rotation_deg": 0.15,
            "offset_mm": [0.02, -0.01],
        },
        "sensor": {"columns": 700, "rows": 560, "pixel_pitch_mm": 0.0055, "bit_depth": 12, "black_level": 60},
    },
    "recording": {"white": "white.tif", "frames": ["a.tif", "b.tif"], "dt_s": 0.0005, "orientation": "upright"},
    "volume": {
        "x_mm": [-1.5, 1.5],
        "y_mm": [-1.1, 1.1],
        "z_mm": [-2.5, 2.5],
        "voxel_mm": [0.017142857143, 0.017142857143, 0.077],
    },
    "correlation": {"windows": [[64, 64, 24], [48, 48, 16]]},
    "simulation": {
        "flow": "rotation",  # about the y axis, so that depth is measured along x and x along depth
        "parameters": {"rate_rad_s": 80.0, "drift_m_s": [0.0, 0.1, 0.0]},
        "seed": 7,
    },
}


def demo(folder: Path, overwrite: bool) -> str:
    """Simulate, run, score; returns the errors and where the report is.

    Raises:
        PlenoPIVError: the folder already holds a recording or a run.
    """
    if folder.exists() and any(folder.iterdir()) and not overwrite:
        raise PlenoPIVError(f"{folder}: is not empty; name another folder, or use --overwrite")
    wanted = Experiment.from_dict(TABLES)
    made = recorded(wanted, folder, overwrite)
    experiment = Experiment.load(made.directory / "experiment.toml")
    assert wanted.simulation is not None
    truth = flow(wanted.simulation.flow, **wanted.simulation.parameters)
    scores: dict[str, float] = {}

    def score(dataset: xarray.Dataset) -> dict[str, Any]:
        against = truth, experiment.volume.voxel_mm, experiment.recording_table.dt_s
        scores.update(accuracy(dataset, *against))
        return {**scores, "by_depth": error_by_depth(dataset, *against)}

    with Progress() as progress:
        run_series(experiment, progress, overwrite, score)
    width = max(map(len, scores))
    return "\n".join(
        [
            "Solid-body rotation about y at 80 rad/s with a drift of 0.1 m/s along y, against the truth:",
            *(f"  {name:<{width}}  {value:.3f}" for name, value in scores.items()),
            f"Report: {experiment.output_directory / 'report.html'}",
        ]
    )


def accuracy(
    dataset: xarray.Dataset, truth: Velocity, voxel_mm: tuple[float, float, float], dt_s: float
) -> dict[str, float]:
    """Errors of the measured vectors against a flow at the vectors, in voxels per frame.

    ``truth``: velocity in m/s at (n, 3) mm. Vectors that were replaced are left out, gross errors are counted and left
    out of the RMS.
    """
    z, y, x = np.meshgrid(*(dataset[axis].values for axis in "zyx"), indexing="ij")
    field = dataset.isel(time=0)
    true = truth(np.stack([x, y, z], -1).reshape(-1, 3))
    measured = np.stack([field[name].values for name in "uvw"], -1).reshape(-1, 3)
    error = (measured - true) * 1e3 * dt_s / np.asarray(voxel_mm)
    error = error[(field["valid"].values.reshape(-1) == 1) & np.isfinite(error).all(axis=1)]
    gross = (np.abs(error) > GROSS_VOXELS).any(axis=1)
    good = error[~gross]
    share = float(gross.mean()) if len(gross) else float("nan")
    scores = {"vectors": float(len(error)), "gross errors (%)": 100 * share}
    for i, axis in enumerate("xyz"):
        scores[f"RMS along {axis} (voxel)"] = float(np.sqrt(np.mean(good[:, i] ** 2))) if len(good) else float("nan")
    return scores
