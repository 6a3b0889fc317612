"""Tracks of the paper's jet beside correlation, where windows do not resolve it: jet.json.

    .venv/bin/python benchmarks/tracking/jet.py

The cut of the jet of ``paper/comparison.py`` (7.5 x 6 x 20 mm, 1 particle per microlens, 12 voxels between frames at
the jet's velocity) is simulated, measured by ``plenopiv run`` with sub-windows and without, and by ``plenopiv
track``. Judged are the same vectors of all fields, whose whole window (64 x 64 x 16 voxels) every view sees and that
lie within 6 x 4.5 mm, against the mean of the DNS over the window. The field of tracks is averaged over the window;
beside it stand linear fits of the window's tracks, with the weight of their error bars, and what perfect tracks give:
the true particles, fitted so, or through thin plate splines (``paper/needed.py``) and averaged. Particles and links
are judged as in ``particles.py``.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import xarray
from fields_of_tracks import linear_fits
from numpy.typing import NDArray
from recorded import run_cases, three, write_table
from scipy.interpolate import RBFInterpolator
from tracks_judged import judged

import plenopiv
from plenopiv.accuracy.truth import true_displacements
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run.track import track
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording
from plenopiv.tracking.light import PointLights

sys.path.append(str(Path(__file__).parents[2] / "paper"))
from comparison_scores import inside_window, point_displacement, window_mean
from comparison_settings import DT_S, REDUCED, TARGET_DEPTH_MM, TINY, VOXEL_MM, Comparison
from lightfield_case import camera_of, windows_seen

RECORD = Path(__file__).with_name("jet.json")
CASES = {"cut": {"size": REDUCED}}
RAYS, SEED = 100_000, 0
GRID_MM, SAMPLES = 0.2, 4  # of the field of tracks; along each axis of a window
NEAREST = 60  # tracks that a smooth field takes account of
BANDS = {"to 6 mm": (0.0, TARGET_DEPTH_MM), "beyond 6 mm": (TARGET_DEPTH_MM, np.inf)}  # of |z|
Array = NDArray[np.float64]


def measure(size: Comparison) -> dict:
    """One cut."""
    light, moving = size.light_field, flow("jet", at_mm=size.jet_at_mm)
    camera, voxel = camera_of(light), np.array(VOXEL_MM)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        made = simulate_recording(
            folder, camera, moving, dt_s=DT_S, volume_mm=light.volume_mm, voxel_mm=VOXEL_MM, windows=light.windows,
            seeding=Seeding(light.particles_per_microlens), rays=RAYS, seed=SEED, overwrite=True,
        )  # fmt: skip
        experiment = Experiment.load(Path(folder) / "experiment.toml")
        fields = {
            "sub-windows": plenopiv.process(experiment, overwrite=True).velocity.load(),
            "single windows": plenopiv.process(
                experiment.changed(inner_window=list(light.windows[-1])), overwrite=True
            ).velocity.load(),
        }
        found = track(experiment.changed(grid_mm=GRID_MM))
        fields["field of tracks"] = xarray.load_dataset(found.velocity)
        tracks = xarray.load_dataset(found.path)
    fields = {name: each.isel(time=0) if "time" in each.dims else each for name, each in fields.items()}
    truth = made.a.position_mm, made.b.position_mm
    half = 0.5 * voxel * light.windows[-1]
    at = _judged(fields["sub-windows"], camera, half, light.judged_mm)
    mean, _ = window_mean(moving, at, half)
    over = (at[:, None] + inside_window(half, SAMPLES)).reshape(-1, 3)
    through = RBFInterpolator(0.5 * (truth[0] + truth[1]), truth[1] - truth[0], neighbors=NEAREST)
    moved = {name: _displacements(each, at) for name, each in fields.items()}
    moved["field of tracks, mean"] = _displacements(fields["field of tracks"], over).reshape(len(at), -1, 3).mean(1)
    moved["perfect tracks, mean"] = through(over).reshape(len(at), -1, 3).mean(1)
    moved["tracks in the window"] = linear_fits(tracks, at, half)
    moved["perfect tracks in the window"] = true_displacements(at, *truth, half).window
    true = {"window_mean": mean, "point": point_displacement(moving, at)}
    out = {"particles": len(truth[0]), "found": judged(tracks, truth, PointLights(camera), voxel, BANDS)}
    for band, (low, high) in BANDS.items():
        here = (np.abs(at[:, 2]) >= low) & (np.abs(at[:, 2]) < high)
        here &= np.isfinite(np.stack(list(moved.values()))).all((0, 2))
        out[band] = {"vectors": int(here.sum())} | {
            name: {
                of: np.sqrt((((each - right) / voxel)[here] ** 2).mean(0)).round(4).tolist()
                for of, right in true.items()
            }
            for name, each in moved.items()
        }
    return out


def _judged(field: xarray.Dataset, camera, half_mm: Array, limits_mm) -> Array:
    """Places (n, 3) in mm of the vectors that are judged."""
    axes = field.x.values.astype(float), field.y.values.astype(float), field.z.values.astype(float)
    chosen = windows_seen(camera, axes, half_mm)
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    at = np.stack([x, y, z], -1)
    for axis, (low, high) in enumerate(limits_mm or ()):
        chosen &= (at[..., axis] - half_mm[axis] >= low) & (at[..., axis] + half_mm[axis] <= high)
    return at[chosen]


def _displacements(field: xarray.Dataset, at_mm: Array) -> Array:
    """Displacements (n, 3) in mm at places (n, 3) in mm, linear between the field's vectors."""
    places = {name: ("n", at_mm[:, k]) for k, name in enumerate("xyz")}
    return 1e3 * DT_S * np.stack([field[name].astype(float).interp(places).values for name in "uvw"], -1)


def page(record: dict) -> None:
    """Write the tables into docs/tracking.md."""
    lines = [
        "| depth | vectors | field | against the mean over the window | at the vector |",
        "|---|---:|---|---|---|",
    ]
    for own in record.values():
        for band in BANDS:
            for name, one in own[band].items():
                if name != "vectors":
                    rms = " | ".join(three(one[key]) for key in ("window_mean", "point"))
                    lines.append(f"| {band} | {own[band]['vectors']} | {name} | {rms} |")
    lines += ["", "| depth | n | found % | ghosts % | RMS x / y / z | found in both | linked % | wrong % |"]
    lines.append("|---|---:|---:|---:|---|---:|---:|---:|")
    for own in record.values():
        for band, one in own["found"].items():
            shares = [f"{100 * one[key]:.1f}" for key in ("found", "ghosts", "linked", "wrong")]
            lines.append(
                f"| {band} | {one['n']} | {shares[0]} | {shares[1]} | {three(one['rms'])} | {one['both_found']} | "
                f"{shares[2]} | {shares[3]} |"
            )
    write_table("jet", lines)


if __name__ == "__main__":
    if sys.argv[1:] == ["tiny"]:
        print(measure(TINY))
    else:
        run_cases(RECORD, CASES, {}, measure, page)
