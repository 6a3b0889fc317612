"""Particles of frames and links of pairs against the truth: found, ghosts, errors, error bars, links.

    .venv/bin/python benchmarks/tracking/particles.py [case ...]

writes particles.json beside itself, the table of docs/tracking.md and its figure (``density_figure``).

Each case is a simulated pair of frames of a small camera (PMR 14, M = -1), reconstructed, tracked and linked as
``plenopiv track`` does. True particles count where all of their light falls on the sensor. "Beyond" is beyond 1.5 half
dead zones, "inside" within. Errors are in voxels of 0.017 x 0.017 x 0.077 mm; the bound is the Cramer-Rao bound of each
particle among its neighbours, positions and light unknown.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import density_figure
import numpy as np
from matching import bound_mm, matched
from recorded import camera_and_volume, run_cases, three, write_table

from plenopiv.chain import Chain
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.run.track_pair import linked, search
from plenopiv.simulation.flows import flow
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import Seeding, seed_pair
from plenopiv.tracking.expected import expected
from plenopiv.tracking.frame import particles_of_frame, particles_of_second_frame
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pixels import Pixels
from plenopiv.volume import VoxelGrid

RECORD = Path(__file__).with_name("particles.json")
VOXEL_MM = np.array([0.017, 0.017, 0.077])
DT_S, RAYS, BACKGROUND, SEED = 5e-4, 200_000, 4.0, 11
MARGIN = 0.07  # voxels' worth of mm beyond the volume in which particles are looked for
BASE = {"ppm": 1.0, "depth_mm": 8.0, "electrons": 400.0, "columns": 420, "blur_um": 0.0}
CASES = {
    "base": {},
    "dim": {"electrons": 80.0},
    "0.1 ppm": {"ppm": 0.1, "columns": 560},
    "0.25 ppm": {"ppm": 0.25},
    "0.5 ppm": {"ppm": 0.5},
    "2 ppm": {"ppm": 2.0, "columns": 360},
    "4 ppm": {"ppm": 4.0, "columns": 330},
    "20 mm deep": {"depth_mm": 20.0, "columns": 560},
    "blur 20 um": {"blur_um": 20.0},
    "blur 40 um": {"blur_um": 40.0},
}


def measure(ppm: float, depth_mm: float, electrons: float, columns: int, blur_um: float) -> dict:
    """One case."""
    camera, volume = camera_and_volume(columns, depth_mm)
    camera = replace(camera, blur_mm=1e-3 * blur_um)
    chain = Chain(
        (camera,),
        VoxelGrid.covering(*volume, tuple(VOXEL_MM)),
        reconstruction=ReconstructionSettings().through(camera),
        correlation=CorrelationSettings(((64, 64, 24), (48, 48, 16))),
        counts_per_electron=SensorNoise().gain,
    )
    rng = np.random.default_rng(SEED)
    # amplitudes of 3 voxels in the plane
    speed = 3 * VOXEL_MM[0] * 1e-3 / DT_S
    moving = flow("abc", wavelength_mm=4.8, amplitudes_m_s=(0.3 * speed, speed, speed), drift_m_s=(0.0, 0.0, 0.1))
    seeding = Seeding(ppm, electrons_per_pixel=electrons)
    truth = seed_pair(camera, moving, DT_S, volume, seeding, rng)
    of_points = PointLights(camera)
    volumes, frames, frames_s = [], [], []
    for number, particles in enumerate(truth):
        light = particle_image(camera, particles, rays=RAYS, diffraction_nm=532.0, seed=SEED + number)
        counts = digitise(light + BACKGROUND, camera.sensor, SensorNoise(), rng)
        made = chain.reconstruct([counts])
        pixels = Pixels.of_image(counts, 60.0, 4095, made.noise.dark, chain.counts_per_electron)
        around = tuple((lo - MARGIN, hi + MARGIN) for lo, hi in volume)
        volumes.append(made.volume)
        if number:  # as a run does
            moved = chain.displacement(*volumes)
            guess = expected(frames[0], *peaks(made.volume), *search(moved, chain.grid, TrackingTable()))
        begun = time.process_time()
        if number:
            frames.append(particles_of_second_frame(of_points, pixels, *guess, around))
        else:
            frames.append(particles_of_frame(of_points, pixels, *peaks(made.volume), around))
        frames_s.append(time.process_time() - begun)
    links = linked(*frames, moved, chain.grid, TrackingTable())
    partners = [matched(t.position_mm, f.position_mm, VOXEL_MM) for t, f in zip(truth, frames, strict=True)]
    whole = [of_points(t.position_mm).whole() > 0.999 for t in truth]
    zone = 1.5 * camera.dead_zone_mm()[1]
    bands = {"inside": (0.0, zone), "beyond": (zone, np.inf)}
    if depth_mm > 12.0:
        bands |= {"beyond, to 6 mm": (zone, 6.0), "beyond 6 mm": (6.0, np.inf)}
    gain = SensorNoise().gain
    bounds = [bound_mm(of_points, pixels, each.position_mm, gain * each.electrons) for each in truth]
    out = {"particles": len(truth[0].electrons), "ms_per_particle": 1e3 * np.mean(frames_s) / len(frames[0].light)}
    out["of_second_frame"] = float(frames_s[1] / frames_s[0])
    out["chi2"] = float(np.median(frames[0].misfit))
    for name, band in bands.items():
        out[name] = _scored(truth[0], frames[0], partners[0], whole[0], bounds[0], band)
        out[f"{name}, second frame"] = _scored(truth[1], frames[1], partners[1], whole[1], bounds[1], band)
    return out | {"links": _links(links, partners, whole)}


def _scored(truth, found, partner, whole, bound, band) -> dict:
    """Found, ghosts, errors and error bars of particles with |z| in a band."""
    judged = whole & (np.abs(truth.position_mm[:, 2]) >= band[0]) & (np.abs(truth.position_mm[:, 2]) < band[1])
    reported = (np.abs(found.position_mm[:, 2]) >= band[0]) & (np.abs(found.position_mm[:, 2]) < band[1])
    ghost = np.ones(len(found.light), bool)
    ghost[partner[partner >= 0]] = False
    both = np.flatnonzero(judged & (partner >= 0))
    off = found.position_mm[partner[both]] - truth.position_mm[both]
    std = np.sqrt(np.einsum("nii->ni", found.covariance))[partner[both], :3]
    error = np.abs(off / VOXEL_MM)
    rounded = {
        "rms": np.sqrt((error**2).mean(0)),
        "median": np.median(error, 0),
        "p95": np.quantile(error, 0.95, 0),
        "p99": np.quantile(error, 0.99, 0),
        "median_over_bound": np.median(np.abs(off) / bound[both], 0),
        "inside_1_std": (np.abs(off) < std).mean(0),
        "inside_2_std": (np.abs(off) < 2 * std).mean(0),
    }
    return {
        "n": int(judged.sum()),
        "found": round(len(both) / judged.sum(), 4),
        "ghosts": round(float((ghost & reported).sum() / max(reported.sum(), 1)), 4),
    } | {name: np.round(values, 4).tolist() for name, values in rounded.items()}


def _links(links, partners, whole) -> dict:
    """Of the particles found in both frames, the share that is linked; of the links between found particles, those that
    join two different ones."""
    a, b = partners
    both = whole[0] & whole[1] & (a >= 0) & (b >= 0)
    to = np.full(max(a.max(initial=-1), links.a.max(initial=-1)) + 1, -1)
    to[links.a] = links.b
    right = to[a[both]] == b[both]
    wrong = (to[a[both]] >= 0) & ~right
    return {
        "both_found": int(both.sum()),
        "linked": round(float(right.mean()), 4),
        "wrong": round(float(wrong.sum() / max((right | wrong).sum(), 1)), 4),
        "left_by_predictor_voxels": np.round(links.scatter_mm / VOXEL_MM, 3).tolist(),
    }


def page(record: dict) -> None:
    """Write the tables and the figure of docs/tracking.md."""
    lines = [
        "| case | particles | n | found % | ghosts % | RMS x / y / z | median x / y / z | 99 % x / y / z | "
        "over bound x / y / z | within 1 std % | within 2 std % |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for case in CASES:
        for band in ("beyond", "beyond, to 6 mm", "beyond 6 mm", "inside"):
            if (own := record.get(case, {}).get(band)) is not None:
                inside = (three([100 * v for v in own[f"inside_{k}_std"]], 0) for k in (1, 2))
                lines.append(
                    f"| {case} | {band} | {own['n']} | {100 * own['found']:.1f} | {100 * own['ghosts']:.1f} | "
                    f"{three(own['rms'])} | {three(own['median'])} | {three(own['p99'])} | "
                    f"{three(own['median_over_bound'], 2)} | {' | '.join(inside)} |"
                )
    lines += [
        "",
        "| case | found in both | linked % | wrong % | chi² | CPU ms a particle, first frame |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for case in CASES:
        if case in record:
            own, links = record[case], record[case]["links"]
            lines.append(
                f"| {case} | {links['both_found']} | {100 * links['linked']:.1f} | {100 * links['wrong']:.1f} | "
                f"{own['chi2']:.2f} | {own['ms_per_particle']:.0f} |"
            )
    write_table("particles", lines)
    density_figure.draw(record)


if __name__ == "__main__":
    run_cases(RECORD, CASES, BASE, measure, page)
