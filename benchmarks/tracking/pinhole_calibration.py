"""Pinhole cameras that are a little wrong, corrected by the particles: pinhole_calibration.json.

    .venv/bin/python benchmarks/tracking/pinhole_calibration.py [case ...]

The cameras and frames of pinholes.py. Each of a camera's seven numbers is off by a random amount that shifts images by
as much as the others; cases are the shift of all together, px RMS, and particles per pixel. What matters of a shift is
what particles elsewhere do not make; it is told before and after. Two frames, of other particles.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from pinholes import BLACK, CAMERAS, LIMITS, recorded_frame
from recorded import run_cases, write_table

from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.tracking.camera_changes import NUMBERS, apart_px, changed, pixels_by_number, self_calibrated
from plenopiv.tracking.pinhole_light import PinholeLights, measured_image_px
from plenopiv.tracking.pixels import Pixels

RECORD = Path(__file__).with_name("pinhole_calibration.json")
SEED, POINTS = 5, 500
BASE = {"off_px": 1.0, "ppp": 0.005}
CASES = {
    f"{off:g} px, {ppp:g}": {"off_px": off, "ppp": ppp}
    for ppp, all_off in ((0.005, (0.0, 0.3, 1.0, 2.0, 3.0)), (0.02, (0.0, 0.3, 1.0, 2.0)))
    for off in all_off
}


def measure(off_px: float, ppp: float) -> dict:
    """One case."""
    rng = np.random.default_rng(SEED)
    at = rng.uniform(*np.array(LIMITS).T, (POINTS, 3))
    wrong = []
    for camera in CAMERAS:
        each_px = np.sqrt((pixels_by_number(camera, at) ** 2).sum(1).mean(0))
        wrong.append(changed(camera, off_px * rng.normal(size=NUMBERS) / each_px / np.sqrt(NUMBERS)))
    frames, noise = [recorded_frame(ppp, seed)[1] for seed in (1, 2)], SensorNoise()
    pixels = [
        Pixels.of_cameras(
            [
                Pixels.of_image(image, BLACK, 4095, noise.gain * noise.read_noise_electrons, noise.gain)
                for image in images
            ]
        )
        for images in frames
    ]
    of_points = PinholeLights(wrong, [measured_image_px(image) for image in frames[0]])
    begun = time.process_time()
    found = self_calibrated(of_points, *pixels, LIMITS)
    taken = time.process_time() - begun
    return {
        "before_px": apart_px(CAMERAS, wrong, at),
        "after_px": apart_px(CAMERAS, found.cameras, at),
        "corrected": found.corrected,
        "std_px": found.std_px,
        "apart_px": found.apart_px,
        "chi2": found.chi2,
        "cpu_s": taken,
    }


def page(record: dict) -> None:
    """Write the table into docs/tracking.md."""
    lines = [
        "| wrong by, particles per pixel | before, px | after | std | frames apart | chi² | after | taken | CPU s |",
        "|---|---:|---:|---:|---:|---:|---:|---|---:|",
    ]
    for case in CASES:
        if (own := record.get(case)) is not None:
            numbers = (f"{own[key]:.4f}" for key in ("before_px", "after_px", "std_px", "apart_px"))
            chi2 = (f"{each:.2f}" for each in own["chi2"])
            taken = "yes" if own["corrected"] else "no"
            lines.append(f"| {' | '.join([case, *numbers, *chi2, taken])} | {own['cpu_s']:.0f} |")
    write_table("pinhole-calibration", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, BASE, measure, page)
