"""What voxels that are coarse beside a microlens cost, on the axis and off it: coarse_voxels.json.

    python benchmarks/accuracy/coarse_voxels.py

Particles that move alike, seen about x = 0, 3.5 and 7 mm by the paper's cameras of PMR 14 and 8 (M = -1) on sensors as
wide as that takes; 4 mm deep, diffraction, noise. Sides of voxels in the plane are shares of the microlens pitch, in
depth one pitch; windows are as large in mm. Displacements along x are three tenths, a half and seven tenths beyond a
whole voxel. Results: RMS over the three of the mean error along x and z, um, the mean of the stated standard deviation
of a vector along z, and the largest mean error along z. Writes the table of decision 86.
"""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.chain import Chain
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.sensor import Sensor
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

sys.path.append(str(Path(__file__).parents[1]))
import page_tables

RECORD = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).parents[2] / "docs" / "decisions" / "0086-voxels-no-coarser-than-a-quarter-of-a-microlens.md"
CAMERAS, SHARES, PLACES_MM = ("pmr14", "pmr8"), (0.2226, 0.28, 0.39, 0.5), (0.0, 3.5, 7.0)
BEYOND, ALONG_X_MM, YZ_MM = (0.3, 0.5, 0.7), 0.09, (0.03, 0.1)
HALF_MM, PARTICLES, ELECTRONS, WINDOW_MM = (1.5, 0.95, 2.0), 600, 20_000.0, 1.65


def camera_of(name: str, aside_mm: float) -> PlenopticCamera:
    """One of the paper's on a sensor that sees the volume about x = ``aside_mm``."""
    camera = preset(name)
    pitch = camera.sensor.pixel_pitch_mm
    columns, rows = (2 * int((at + half + 0.6) / pitch) for at, half in ((aside_mm, HALF_MM[0]), (0.0, HALF_MM[1])))
    return replace(camera, sensor=Sensor(columns, rows, pitch, 12, 60.0))


def errors_mm(camera: PlenopticCamera, aside_mm: float, share: float, beyond: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean error, and mean of the stated standard deviation of a vector, along x, y, z."""
    pitch = camera.lattice.pitch_mm
    side, middle, half = share * pitch, np.array((aside_mm, 0.0, 0.0)), np.array(HALF_MM)
    moved = np.array(((round(ALONG_X_MM / side) + beyond) * side, *YZ_MM))
    rng = np.random.default_rng(5)
    place = middle + (half + 0.2) * rng.uniform(-1, 1, (PARTICLES, 3))
    light = np.full(PARTICLES, ELECTRONS)
    images = [
        digitise(
            particle_image(camera, Particles(place + way * moved, light), seed=seed, diffraction_nm=532.0),
            camera.sensor,
            SensorNoise(),
            rng,
        )
        for seed, way in enumerate((-0.5, 0.5))
    ]
    limits = [(m - h, m + h) for m, h in zip(middle, half, strict=True)]
    grid = VoxelGrid.covering(*limits, (side, side, pitch))
    across = 8 * round(WINDOW_MM / side / 8)
    settings = ReconstructionSettings().through(camera), CorrelationSettings(windows=((across, across, 24),))
    chain = Chain((camera,), grid, *settings)
    field = chain.displacement(*(chain.reconstruct([image]).volume for image in images))
    found, stated = (np.nanmean(each.reshape(3, -1), 1) * grid.voxel_mm for each in (field.displacement, field.std))
    return found - moved, stated


def measure() -> list[dict[str, float | str]]:
    """All cases, one after the other."""
    told: list[dict[str, float | str]] = []
    for name in CAMERAS:
        for share in SHARES:
            for aside in PLACES_MM:
                each = [errors_mm(camera_of(name, aside), aside, share, beyond) for beyond in BEYOND]
                error, stated = (1e3 * np.array(part) for part in zip(*each, strict=True))
                rms = np.sqrt((error**2).mean(0))
                numbers = {
                    "x": rms[0],
                    "z": rms[2],
                    "stated_z": stated[:, 2].mean(),
                    "worst_z": np.abs(error[:, 2]).max(),
                }
                told.append(
                    {"camera": name, "share": share, "x_mm": aside}
                    | {k: round(float(v), 1) for k, v in numbers.items()}
                )
                print(told[-1], flush=True)
    return told


def table(told: list[dict[str, float | str]]) -> list[str]:
    """Rows of camera and share; cells: RMS along x / z (stated z) at each place."""
    heads = " | ".join(f"x = {place:g} mm" for place in PLACES_MM)
    lines = [f"| camera | voxel / pitch | {heads} |", "|---|---:|" + "---|" * len(PLACES_MM)]
    for name in CAMERAS:
        for share in SHARES:
            cells = [
                f"{row['x']} / {row['z']} ({row['stated_z']})"
                for row in told
                if (row["camera"], row["share"]) == (name, share)
            ]
            lines.append(f"| {name} | {share:.2f} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    warnings.simplefilter("ignore")
    told = json.loads(RECORD.read_text()) if sys.argv[1:] == ["page"] else measure()
    RECORD.write_text(json.dumps(told, indent=1) + "\n")
    page_tables.put(PAGE, "coarse voxels", table(told))


if __name__ == "__main__":
    main()
