"""Particles of four pinhole cameras against the truth, by seeding density: pinholes.json.

    .venv/bin/python benchmarks/tracking/pinholes.py [case ...]

Four cameras at +-20 degrees about both axes, 400 x 400 px each, 0.0176 mm/px (a full-size volume's 36 mm over 2048 px),
a volume 4.4 x 4.4 x 4.4 mm, images of 2.7 px, 2000 electrons a particle with a spread of 30 %, read noise 3. Cases are
particles per pixel. "MART" are the maxima of the volume that the chain reconstructs; "crossings" begins instead with
places where lines of sight to bright spots cross. Both are fitted to the raw pixels. Errors in voxels of a pixel's
width; the bound is each particle's Cramer-Rao bound among its neighbours.
"""

from __future__ import annotations

import time
from itertools import product
from pathlib import Path

import numpy as np
from matching import bound_mm, matched
from recorded import run_cases, three, write_table

from plenopiv.cameras.pinhole import looking_at
from plenopiv.chain import Chain
from plenopiv.reconstruction.settings import TOMOGRAPHY
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pinhole_light import PinholeLights, measured_image_px
from plenopiv.tracking.pixels import Pixels
from plenopiv.volume import VoxelGrid

RECORD = Path(__file__).with_name("pinholes.json")
SCALE_MM, SIDE_MM, DISTANCE_MM, ANGLE_DEG = 0.0176, 4.4, 500.0, 20.0
DIAMETER_PX, ELECTRONS, SPREAD, BLACK, SEED = 2.7, 2000.0, 0.3, 60.0, 3
VOXEL_MM = np.full(3, SCALE_MM)
MARGIN_MM = 0.05
CASES = {f"{ppp:g}": {"ppp": ppp} for ppp in (0.005, 0.02, 0.05)}
WAYS = "MART", "crossings"


SENSOR = Sensor(400, 400, 0.0055, 12, BLACK)
CAMERAS = [
    looking_at((0, 0, 0), SENSOR, scale_mm_px=SCALE_MM, distance_mm=DISTANCE_MM, about_y_deg=y, about_x_deg=x)
    for y, x in product((-ANGLE_DEG, ANGLE_DEG), repeat=2)
]
LIMITS = ((-SIDE_MM / 2, SIDE_MM / 2),) * 3


def recorded_frame(ppp: float, seed: int = SEED) -> tuple[Particles, list[np.ndarray]]:
    """Particles, and their images in counts."""
    rng = np.random.default_rng(seed)
    count = round(ppp * (SIDE_MM / SCALE_MM) ** 2)
    light = ELECTRONS * np.exp(SPREAD * rng.standard_normal(count) - 0.5 * SPREAD**2)
    truth = Particles(rng.uniform(-SIDE_MM / 2, SIDE_MM / 2, (count, 3)), light)
    means = (pinhole_image(camera, truth, diameter_px=DIAMETER_PX) for camera in CAMERAS)
    return truth, [digitise(mean, SENSOR, SensorNoise(), rng) for mean in means]


def measure(ppp: float) -> dict:
    """One density, both ways."""
    cameras, limits, noise = CAMERAS, LIMITS, SensorNoise()
    truth, counts = recorded_frame(ppp)
    count = len(truth.electrons)
    chain = Chain(
        tuple(cameras),
        VoxelGrid.covering(*limits, tuple(VOXEL_MM)),
        reconstruction=TOMOGRAPHY,
        counts_per_electron=noise.gain,
        poses=(),
    )
    begun = time.process_time()
    made = chain.reconstruct(counts)
    mart_s = time.process_time() - begun
    pixels = Pixels.of_cameras(
        [Pixels.of_image(image, BLACK, 4095, made.noise.dark, chain.counts_per_electron) for image in counts]
    )
    of_points = PinholeLights(cameras, [measured_image_px(image) for image in counts])
    around = tuple((lo - MARGIN_MM, hi + MARGIN_MM) for lo, hi in limits)
    bound = bound_mm(of_points, pixels, truth.position_mm, noise.gain * truth.electrons)
    out = {"particles": count, "mart_s": mart_s, "image_px": of_points.image_px}
    for way in WAYS:
        begun = time.process_time()
        if way == "MART":
            guess = peaks(made.volume)
            maxima = guess[0]
            out["maxima"] = _scored(truth.position_mm, maxima)
        else:
            places, _ = of_points.places((pixels.counts - np.median(pixels.counts)) / made.noise.dark, around)
            guess = places, np.full(len(places), noise.gain * ELECTRONS)
        found = particles_of_frame(of_points, pixels, *guess, around)
        seconds = time.process_time() - begun
        std = np.sqrt(np.einsum("nii->ni", found.covariance))[:, :3]
        out[way] = _scored(truth.position_mm, found.position_mm, std, bound)
        out[way] |= {"chi2": found.chi2, "ms_per_particle": 1e3 * seconds / len(found.light)}
    return out


def _scored(
    truth: np.ndarray, found: np.ndarray, std: np.ndarray | None = None, bound: np.ndarray | None = None
) -> dict:
    """Found, ghosts and errors; with error bars and the bound, how far they hold."""
    partner = matched(truth, found, VOXEL_MM)
    both = np.flatnonzero(partner >= 0)
    off = np.abs(found[partner[both]] - truth[both])
    out = {
        "found": len(both) / len(truth),
        "ghosts": 1.0 - len(both) / max(len(found), 1),
        "rms": np.sqrt(((off / VOXEL_MM) ** 2).mean(0)),
        "median": np.median(off / VOXEL_MM, 0),
    }
    if std is not None and bound is not None:
        own = std[partner[both]]
        out |= {
            "median_over_bound": np.median(off / bound[both], 0),
            "inside_1_std": (off < own).mean(0),
            "inside_2_std": (off < 2 * own).mean(0),
        }
    return {name: np.round(value, 4).tolist() for name, value in out.items()}


def page(record: dict) -> None:
    """Write the table into docs/tracking.md."""
    lines = [
        "| particles per pixel | n | first guess | found % | ghosts % | RMS x / y / z | median x / y / z | "
        "over bound x / y / z | within 1 std % | within 2 std % | chi² | CPU ms a particle |",
        "|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for case, own in record.items():
        for way in ("maxima", *WAYS):
            one, name = own[way], "maxima of MART, not fitted" if way == "maxima" else way
            line = f"| {case} | {own['particles']} | {name} | {100 * one['found']:.1f} | {100 * one['ghosts']:.1f} | "
            line += f"{three(one['rms'])} | {three(one['median'])} | "
            if way == "maxima":
                lines.append(line + "| | | | |")
                continue
            inside = " | ".join(three([100 * v for v in one[f"inside_{k}_std"]], 0) for k in (1, 2))
            over = three(one["median_over_bound"], 2)
            lines.append(line + f"{over} | {inside} | {one['chi2']:.2f} | {one['ms_per_particle']:.0f} |")
    write_table("pinholes", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, {}, measure, page)
