"""The field of tracks beside correlation, on the same recordings: fields_of_tracks.json.

    .venv/bin/python benchmarks/tracking/fields_of_tracks.py [case ...]

Pairs of the camera of benchmarks/accuracy (PMR 14, M = -1, 8 mm deep, 1 particle per microlens) are measured by
``plenopiv run``, with sub-windows and without, and by ``plenopiv track``. Both are judged where a whole window (64 x 64
x 16 voxels) is seen: against the flow at the vector (*point*), and against what a perfect correlation of the window's
particles would find (``accuracy.truth``, *window*), for which tracks are fitted linearly in the window, as true
particles are, with the weight of their error bars; so is the field of tracks, where there are tracks. Error bars are
judged by the window for correlation, by the flow at the vector for the field of tracks. Waves: the share of a sine of
.7 voxel that is left, of 1, 1.5 and 2 windows' length, beyond 1.5 half dead zones. RMS in voxels.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from recorded import run_cases, three, write_table

import plenopiv
from plenopiv.accuracy.truth import true_displacements
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run.track import track
from plenopiv.simulation.flows import Velocity, advect, flow
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

sys.path.append(str(Path(__file__).parents[1] / "accuracy"))
from conditions import CONDITIONS, DT_S, Condition

RECORD = Path(__file__).with_name("fields_of_tracks.json")
BASE = CONDITIONS["base"]
WINDOW, RAYS, SEED = (64, 64, 16), 100_000, 7
AMPLITUDE, DRIFT = 0.7, np.array([2.3, -1.4, 0.37])  # voxels, of waves
BEYOND_HALF_DEAD_ZONES = 1.5
FINE_MM = 0.15  # of the field of tracks that is taken at the tracks
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Wave:
    """A sine along ``axis`` of the displacement along ``across``, ``windows`` long, on a drift."""

    axis: int
    across: int
    windows: float
    voxel_mm: tuple[float, float, float]

    def at(self, place_mm: Array) -> Array:
        """Voxels, at places along the axis."""
        phase = np.random.default_rng(SEED).uniform(0, 2 * np.pi)
        k = 2 * np.pi / (self.windows * WINDOW[self.axis] * self.voxel_mm[self.axis])
        return AMPLITUDE * np.sin(k * place_mm + phase)

    def __call__(self, points_mm: Array) -> Array:
        """Velocities (n, 3) in m/s."""
        moved = DRIFT + self.at(points_mm[:, self.axis, None]) * (np.arange(3) == self.across)
        return moved * self.voxel_mm * 1e-3 / DT_S


def wave(axis: str, across: str, windows: float) -> dict[str, Any]:
    """A case."""
    return {"flow_name": "wave", "parameters": ("xyz".index(axis), "xyz".index(across), windows)}


CASES: dict[str, dict[str, Any]] = {
    "rotation": {"flow_name": "rotation"},
    "abc": {"flow_name": "abc"},
    "ring": {"flow_name": "vortex-ring"},
    **{f"wave along x of y, {w:g} windows": wave("x", "y", w) for w in (1.0, 1.5, 2.0)},
    **{f"wave along z of x, {w:g} windows": wave("z", "x", w) for w in (1.0, 1.5, 2.0)},
    **{f"wave along x of z, {w:g} windows": wave("x", "z", w) for w in (1.0, 1.5, 2.0)},
}
FLOWS = {
    "abc": replace(BASE, flow_name="abc", strength=3.0, drift_voxels=(0.0, 0.0, 1.8)),
    "vortex-ring": replace(BASE, flow_name="vortex-ring", strength=5.0, drift_voxels=(0.0, 0.0, 0.5)),
}


def moving(flow_name: str, condition: Condition, parameters: tuple) -> Velocity:
    """The flow of a case."""
    if flow_name == "wave":
        return Wave(*parameters, condition.voxel_mm())
    if flow_name == "rotation":
        return flow("rotation", rate_rad_s=80.0, drift_m_s=(0.0, 0.1, 0.0))
    return condition.flow()


def measure(flow_name: str, parameters: tuple = ()) -> dict:
    """One case."""
    condition = FLOWS.get(flow_name, BASE)
    velocity = moving(flow_name, condition, parameters)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        simulate_recording(
            folder, condition.camera(), velocity, dt_s=DT_S, volume_mm=condition.volume_mm(), seeding=Seeding(),
            voxel_mm=condition.voxel_mm(), windows=condition.windows, seed=SEED, rays=RAYS, overwrite=True,
        )  # fmt: skip
        experiment = Experiment.load(Path(folder) / "experiment.toml")
        fields = {
            "sub-windows": plenopiv.process(experiment, overwrite=True).velocity.load(),
            "single windows": plenopiv.process(
                experiment.changed(inner_window=list(experiment.correlation.windows[-1])), overwrite=True
            ).velocity.load(),
        }
        found = track(experiment)
        fields["tracks"] = xarray.load_dataset(found.velocity)
        tracks = xarray.load_dataset(found.path)
        if not isinstance(velocity, Wave):
            fine = xarray.load_dataset(track(experiment.changed(grid_mm=FINE_MM), overwrite=True).velocity)
        with np.load(Path(folder) / "truth_particles.npz") as particles:
            truth = particles["a"], particles["b"]
    fields = {name: field.isel(time=0) if "time" in field.dims else field for name, field in fields.items()}
    if isinstance(velocity, Wave):
        return {name: {"response": _response(field, velocity, condition)} for name, field in fields.items()}
    out = {name: _scored(field, truth, velocity, condition) for name, field in fields.items() if name != "tracks"}
    out["tracks"] = _scored(fields["tracks"], truth, velocity, condition, tracks)
    averaged = _scored(fields["tracks"], truth, velocity, condition, smooth(tracks, fine.squeeze()))
    return out | {"field of tracks in the window": {key: averaged[key] for key in ("window", "window_beyond")}}


def _scored(
    field: xarray.Dataset,
    truth: tuple[Array, Array],
    velocity: Velocity,
    condition: Condition,
    tracks: xarray.Dataset | None = None,
) -> dict:
    """RMS against the flow at the vector and in the window, also beyond 1.5 half dead zones, and the share of errors
    within one and two error bars. With ``tracks`` in the window their linear fits are judged, at the vector their
    field's error bars."""
    voxel = np.array(condition.voxel_mm())
    half, to_voxels = 0.5 * voxel * WINDOW, 1e3 * DT_S / voxel
    z, y, x = np.meshgrid(field.z.values, field.y.values, field.x.values, indexing="ij")
    at = np.stack([x, y, z], -1).reshape(-1, 3)
    values, std = (
        np.stack([field[name + end].values.astype(float).ravel() for name in "uvw"], -1) * to_voxels
        for end in ("", "_std")
    )
    middle = 0.5 * (truth[0] + truth[1])
    seen = np.array([min(side) for side in seen_by_every_view_mm(condition.camera(), condition.z_mm)])
    chosen = ((at >= middle.min(0) + half) & (at <= middle.max(0) - half)).all(1)
    chosen &= (np.abs(at[:, :2]) + half[:2] <= seen).all(1) & np.isfinite(values).all(1)
    true = true_displacements(at[chosen], *truth, half)
    window = values[chosen] if tracks is None else linear_fits(tracks, at[chosen], half) / voxel
    off = {"window": window - true.window / voxel, "point": values[chosen] - symmetric(velocity, at[chosen]) / voxel}
    beyond = np.abs(at[chosen, 2]) > _zone_mm(condition)
    error, bar = np.abs(off["window" if tracks is None else "point"]), std[chosen]
    known = np.isfinite(error).all(1)
    return {
        "vectors": int(chosen.sum()),
        **{name: np.sqrt(np.nanmean(each**2, 0)).round(4).tolist() for name, each in off.items()},
        **{f"{name}_beyond": np.sqrt(np.nanmean(e[beyond] ** 2, 0)).round(4).tolist() for name, e in off.items()},
        **{f"inside_{n}_std": (error <= n * bar)[known].mean(0).round(3).tolist() for n in (1, 2)},
    }


def symmetric(velocity: Velocity, at_mm: Array) -> Array:
    """Displacements (n, 3) in mm of the particles that are as far before ``at_mm`` in the first frame as beyond it in
    the second: where a pair has its vectors. In a rotation these are longer than of particles there at mid-time, by a
    part in ten thousand at a thirtieth of a radian."""
    start = np.array(at_mm)
    for _ in range(6):
        before, after = (advect(velocity, start, sign * 0.5 * DT_S) for sign in (-1, 1))
        start += at_mm - 0.5 * (before + after)
    return advect(velocity, start, 0.5 * DT_S) - advect(velocity, start, -0.5 * DT_S)


def linear_fits(tracks: xarray.Dataset, at_mm: Array, half_mm: Array) -> Array:
    """Displacements (n, 3) in mm at ``at_mm`` of linear fits of the links in windows, each axis weighted with the
    links' error bars and, once more, with what the linear fit leaves beside these."""
    first = tracks.isel(obs=np.flatnonzero((tracks.frame.values == 0) & np.isfinite(tracks.u.values)))
    to_mm = 1e3 * DT_S
    moved, std = (to_mm * np.stack([first[name + end].values for name in "uvw"], -1) for end in ("", "_std"))
    middle = np.stack([first[name].values for name in "xyz"], -1) + 0.5 * moved
    out = np.full(at_mm.shape, np.nan)
    for n, vector in enumerate(at_mm):
        near = (np.abs(middle - vector) <= half_mm).all(1)
        if near.sum() < 8:
            continue
        terms = np.column_stack([np.ones(near.sum()), (middle[near] - vector) / half_mm])
        for axis in range(3):
            left = 0.0
            for _ in range(3):
                weight = 1.0 / np.sqrt(std[near, axis] ** 2 + left)
                found = np.linalg.lstsq(terms * weight[:, None], moved[near, axis] * weight, rcond=None)[0]
                square = (moved[near, axis] - terms @ found) ** 2
                left = max(float(np.median(square)) / 0.455 - float(np.median(std[near, axis])) ** 2, 1e-12)
            out[n, axis] = found[0]
    return out


def smooth(tracks: xarray.Dataset, field: xarray.Dataset) -> xarray.Dataset:
    """The tracks with the velocities of their ``field`` where they are, all with the same error bars."""
    place = np.stack([tracks[name].values for name in "xyz"], -1)
    moving = np.stack([tracks[name].values for name in "uvw"], -1)
    middle = {name: ("obs", each) for name, each in zip("xyz", (place + 0.5e3 * DT_S * moving).T, strict=True)}
    known = {name: ("obs", field[name].astype(float).interp(middle).values) for name in "uvw"}
    return tracks.assign(known | {f"{name}_std": ("obs", np.ones(len(place))) for name in "uvw"})


def _response(field: xarray.Dataset, velocity: Wave, condition: Condition) -> float:
    """Measured over true amplitude at vectors a window from the ends of the wave's axis."""
    z, y, x = np.meshgrid(field.z.values, field.y.values, field.x.values, indexing="ij")
    place = (x, y, z)[velocity.axis]
    edge = 0.5 * WINDOW[velocity.axis] * condition.voxel_mm()[velocity.axis]
    values = field["uvw"[velocity.across]].values
    moved = values * DT_S * 1e3 / condition.voxel_mm()[velocity.across] - DRIFT[velocity.across]
    lo, hi = condition.volume_mm()[velocity.axis]
    kept = (np.abs(z) > _zone_mm(condition)) & (place > lo + 2 * edge) & (place < hi - 2 * edge) & np.isfinite(moved)
    true = velocity.at(place)[kept]
    return float(moved[kept] @ true / (true @ true))


def _zone_mm(condition: Condition) -> float:
    """|z| from which on vectors are beyond 1.5 half dead zones."""
    return BEYOND_HALF_DEAD_ZONES * float(np.abs(condition.camera().dead_zone_mm()).max())


def page(record: dict) -> None:
    """Write the table into docs/tracking.md."""
    lines = [
        "| flow | field | against the flow at the vector | in the window | in the window, beyond | within 1 std % | "
        "within 2 std % |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for case, own in record.items():
        for name, one in own.items():
            if "window" in one:
                inside = (three([100 * v for v in one.get(f"inside_{k}_std", ())], 0) for k in (1, 2))
                rms = (three(one.get(key, ())) for key in ("point", "window", "window_beyond"))
                lines.append(f"| {case} | {name} | {' | '.join(rms)} | {' | '.join(inside)} |")
    waves = {case: own for case, own in record.items() if case.startswith("wave")}
    if waves:
        names = next(iter(waves.values()))
        lines += ["", "| share that is left | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
        for case, own in waves.items():
            lines.append(f"| {case} | " + " | ".join(f"{own[name]['response']:.2f}" for name in names) + " |")
    write_table("fields", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, {}, measure, page)
