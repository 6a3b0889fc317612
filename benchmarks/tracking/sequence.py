"""Tracks over the frames of a sequence against the truth: lengths, ghosts, errors, accelerations, time.

    .venv/bin/python benchmarks/tracking/sequence.py [case ...]

writes sequence.json beside itself and the table of docs/tracking.md.

Each case is a simulated sequence of a small camera (PMR 14, M = -1): particles circle about the optical axis in a
Lamb-Oseen vortex, on which an ABC flow lies, so that accelerations are those of curved paths; they are lit within the
volume, which some leave and others enter. It is tracked by plenopiv track with tracking.method = "multi-frame". True
particles count that stay in the volume, beyond 1.5 half dead zones and with all of their light on the sensor,
throughout. CPU seconds of a later frame are all that is done for it until it is written; those of MART are of the first
frames' reconstruction in the same run.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import xarray
from matching import matched
from recorded import camera_and_volume, run_cases, three, write_table

from plenopiv.chain import Chain
from plenopiv.experiment import Experiment
from plenopiv.run.track import track
from plenopiv.run.track_sequence import BEGUN, SequenceJob
from plenopiv.simulation.flows import flow
from plenopiv.simulation.sequence import simulate_sequence
from plenopiv.simulation.simulated_recording import Seeding
from plenopiv.tracking.light import PointLights

RECORD = Path(__file__).with_name("sequence.json")
VOXEL_MM = np.array([0.017, 0.017, 0.077])
DT_S, RAYS, SEED, LONG = 5e-4, 200_000, 11, 10
BASE = {"ppm": 1.0, "depth_mm": 8.0, "electrons": 400.0, "columns": 420, "frames": 30}
CASES = {
    "base": {},
    "dim": {"electrons": 80.0},
    "2 ppm": {"ppm": 2.0, "columns": 360},
}


class Swirl:
    """A vortex about the optical axis, 2 voxels a frame at most, and an ABC flow of half that."""

    def __init__(self, voxels: float = 2.0):
        self.speed = voxels * VOXEL_MM[0] * 1e-3 / DT_S
        radius = 0.6
        circulation = 2.0 * np.pi * radius * self.speed * 1e3 / 0.7153
        self.vortex = flow("lamb-oseen", circulation_mm2_s=circulation, core_radius_mm=radius / 1.1209, axis="z")
        amplitudes = 0.1 * self.speed, 0.4 * self.speed, 0.4 * self.speed
        self.waves = flow("abc", wavelength_mm=2.4, amplitudes_m_s=amplitudes)

    def __call__(self, points_mm):
        """Velocities (n, 3) m/s."""
        return self.vortex(points_mm) + self.waves(points_mm)

    def acceleration(self, points_mm):
        """(n, 3) m/s^2 of the particles at ``points_mm``: the flow is steady, the paths are curved."""
        u, h = self(points_mm), 1e-6
        return (self(points_mm + 1e3 * h * u) - self(points_mm - 1e3 * h * u)) / (2.0 * h)


def measure(ppm: float, depth_mm: float, electrons: float, columns: int, frames: int) -> dict:
    """One case."""
    camera, volume = camera_and_volume(columns, depth_mm)
    moving = Swirl()
    with tempfile.TemporaryDirectory() as folder:
        made = simulate_sequence(
            Path(folder) / "recording",
            camera,
            moving,
            frames,
            dt_s=DT_S,
            volume_mm=volume,
            seeding=Seeding(ppm, electrons_per_pixel=electrons, margin_mm=(0.3, 0.3, 0.1)),
            lit_mm=volume,
            rays=RAYS,
            voxel_mm=tuple(VOXEL_MM),
            windows=((64, 64, 24), (48, 48, 16)),
            seed=SEED,
        )
        path = made.directory / "experiment.toml"
        path.write_text(path.read_text() + '\n[tracking]\nmethod = "multi-frame"\n')
        with Timed(Chain, "reconstruct") as mart, Timed(SequenceJob, "_frame") as each:
            result = track(Experiment.load(path))
        tracks = xarray.load_dataset(result.path)
    positions = np.stack([frame.position_mm for frame in made.frames])
    whole = np.stack([PointLights(camera)(at).whole() > 0.999 for at in positions])
    zone = 1.5 * camera.dead_zone_mm()[1]
    out = _scored(tracks, positions, whole, zone, moving, np.array(volume))
    later = [seconds for k, seconds in enumerate(each.seconds) if k >= BEGUN]
    out["mart_s"], out["later_frame_s"] = float(np.median(mart.seconds)), float(np.median(later))
    out["later_over_mart"] = out["later_frame_s"] / out["mart_s"]
    out["reconstructed"] = len(mart.seconds)
    out["warnings"] = result.summary["warnings"]
    return out


class Timed:
    """CPU seconds of each call of a method."""

    def __init__(self, kind: type, name: str):
        self.kind, self.name, self.seconds = kind, name, []

    def __enter__(self):
        plain = self.plain = getattr(self.kind, self.name)

        def timed(*arguments, **named):
            begun = time.process_time()
            try:
                return plain(*arguments, **named)
            finally:
                self.seconds.append(time.process_time() - begun)

        setattr(self.kind, self.name, timed)
        return self

    def __exit__(self, *_):
        setattr(self.kind, self.name, self.plain)


def _scored(tracks, positions, whole, zone, moving, volume) -> dict:
    """Tracks against all particles (frames, n, 3)."""
    frames, n = positions.shape[:2]
    found = np.stack([tracks[name].values for name in "xyz"], -1)
    number, ids = tracks.frame.values, tracks.track_id.values
    truth = np.full(len(found), -1)
    for k in range(frames):
        own = np.flatnonzero(number == k)
        partner = matched(positions[k], found[own], VOXEL_MM)
        truth[own[partner[partner >= 0]]] = np.flatnonzero(partner >= 0)
    inside = ((positions >= volume[:, 0]) & (positions <= volume[:, 1])).all(2)
    beyond = np.abs(positions[:, :, 2]) > zone
    throughout = (inside & beyond & whole).all(0)
    longest = np.zeros(n, int)
    linked = (ids >= 0) & (truth >= 0)
    pairs, seen = np.unique(np.stack([truth[linked], ids[linked]], 1), axis=0, return_counts=True)
    np.maximum.at(longest, pairs[:, 0], seen)
    of_track, particles = np.unique(pairs[:, 1], return_counts=True)
    at = positions[number, np.maximum(truth, 0)]
    judged = (truth >= 0) & throughout[np.maximum(truth, 0)]
    reported = (np.abs(found[:, 2]) > zone) & ((found >= volume[:, 0]) & (found <= volume[:, 1])).all(1)
    length = np.unique(ids[ids >= 0], return_counts=True)[1]
    long_ids = np.flatnonzero(length >= 4)
    out = {
        "particles": n,
        "throughout": int(throughout.sum()),
        "seen": round(float(judged.sum() / (throughout.sum() * frames)), 4),
        "long": round(float((longest >= LONG)[throughout].mean()), 4),
        "whole": round(float((longest >= frames - 1)[throughout].mean()), 4),
        "ghosts": round(float((reported & (truth < 0)).sum() / reported.sum()), 5),
        "ghosts_of_tracks": round(float((reported & (truth < 0) & np.isin(ids, long_ids)).sum() / reported.sum()), 5),
        "mixed_tracks": round(float((particles > 1).sum() / max(len(of_track), 1)), 5),
        "rms_voxels": np.sqrt((((found - at)[judged] / VOXEL_MM) ** 2).mean(0)).round(4).tolist(),
        "median_voxels": np.median(np.abs((found - at)[judged] / VOXEL_MM), 0).round(4).tolist(),
    }
    for name, names, true in (
        ("position", "xyz", at),
        ("velocity", "uvw", moving(at)),
        ("acceleration", ("ax", "ay", "az"), moving.acceleration(at)),
    ):
        value = np.stack([tracks[each].values for each in names], -1)
        std = np.stack([tracks[f"{each}_std"].values for each in names], -1)
        some = judged & np.isfinite(value).all(1)
        off = np.abs(value - true)[some]
        out[name] = {
            "n": int(some.sum()),
            "rms": np.sqrt((off**2).mean(0)).tolist(),
            "rms_true": np.sqrt((true[some] ** 2).mean(0)).tolist(),
            "within_1_std": (off < std[some]).mean(0).round(3).tolist(),
            "within_2_std": (off < 2 * std[some]).mean(0).round(3).tolist(),
        }
    return out


def page(record: dict) -> None:
    """Write the table into docs/tracking.md."""

    def shares(own: dict) -> str:
        return " | ".join(three([100 * v for v in own[f"within_{k}_std"]], 0) for k in (1, 2))

    lines = [
        "| case | particles | in tracks of 10 frames % | of all frames % | ghosts % | of tracks with two particles % | "
        "RMS x / y / z | median x / y / z | CPU s of a later frame | of MART | ratio |",
        "|---|---:|---:|---:|---:|---:|---|---|---:|---:|---:|",
    ]
    kept = [(case, record[case]) for case in CASES if case in record]
    for case, own in kept:
        lines.append(
            f"| {case} | {own['throughout']} | {100 * own['long']:.1f} | {100 * own['whole']:.1f} | "
            f"{100 * own['ghosts']:.2f} | {100 * own['mixed_tracks']:.1f} | {three(own['rms_voxels'], 3)} | "
            f"{three(own['median_voxels'], 3)} | {own['later_frame_s']:.2f} | {own['mart_s']:.2f} | "
            f"{own['later_over_mart']:.2f} |"
        )
    lines += [
        "",
        "| case | of | RMS error x / y / z | RMS x / y / z | within 1 std % | within 2 std % |",
        "|---|---|---|---|---|---|",
    ]
    for case, own in kept:
        for name, unit, digits in (("velocity", "m/s", 5), ("acceleration", "m/s²", 3)):
            one = own[name]
            lines.append(
                f"| {case} | {name}, {unit} | {three(one['rms'], digits)} | {three(one['rms_true'], digits)} | "
                f"{shares(one)} |"
            )
    write_table("sequence", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, BASE, measure, page)
