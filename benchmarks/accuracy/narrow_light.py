"""The blur that is found of a main lens where particles fill a part of the volume: narrow_light.json.

    python benchmarks/accuracy/narrow_light.py

The camera and volume of small_recording.py, 1000 rays a particle, noise, stray light of 4 counts. Particles are lit in
all of the volume, or in a part of it along x or along both x and y, as by a laser sheet that is narrower than what the
camera sees. Results: the blur found, um, of each recording, 0 where it is not beyond doubt. Writes the table of
decision 87.
"""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from small_recording import CAMERA, NOISE, VOLUME_MM

from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.lens_blur import lens_blur
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import seed_box
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.volume import VoxelGrid

sys.path.append(str(Path(__file__).parents[1]))
import page_tables

RECORD = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).parents[2] / "docs" / "decisions" / "0087-the-blur-of-the-main-lens-where-light-is-even.md"
LIT = {"all": (1.0, 1.0), "half along x": (0.5, 1.0), "0.3 along x": (0.3, 1.0), "half along x and y": (0.5, 0.5)}
PPM, BLURS_UM, SEEDS = (0.05, 0.2, 1.0, 3.0), (0, 20, 30), (0, 1)
VOXEL_MM, RAYS, STRAY = (0.017, 0.017, 0.077), 1000, 4.0
PARTICLES = {"electrons": None, "electrons_per_pixel": 400.0, "electrons_spread": 0.25}


def found_um(lit: tuple[float, float], ppm: float, blur_um: int, seed: int) -> float:
    """The blur that is found beyond doubt."""
    shares, rng = (*lit, 1.0), np.random.default_rng(seed)
    lit_mm = tuple((share * lo, share * hi) for share, (lo, hi) in zip(shares, VOLUME_MM, strict=True))
    particles = seed_box(CAMERA, lit_mm, ppm, rng, **PARTICLES)
    image = particle_image(replace(CAMERA, blur_mm=1e-3 * blur_um), particles, rays=RAYS, seed=seed)
    where, grid = layout(CAMERA), VoxelGrid.covering(*VOLUME_MM, VOXEL_MM)
    field = decode(digitise(image + STRAY, CAMERA.sensor, NOISE, rng), where)
    found = lens_blur(field, PlenopticProjector(where, grid, "1-ray"))
    if found is None:
        raise RuntimeError(f"nothing can be told of {lit}, {ppm} particles per microlens")
    return round(1e3 * found.beyond_doubt(CAMERA.lattice.pitch_mm), 1)


def table(told: dict[str, dict[str, list[float]]]) -> list[str]:
    """Rows of what is lit and density; cells: what is found of each recording of a blur."""
    heads = " | ".join(f"{blur} um" for blur in BLURS_UM)
    lines = [f"| lit | particles per microlens | {heads} |", "|---|---:|" + "---|" * len(BLURS_UM)]
    for name, row in told.items():
        cells = " | ".join(", ".join(f"{value:.1f}" for value in row[str(blur)]) for blur in BLURS_UM)
        lines.append(f"| {name} | {cells} |")
    return lines


def main() -> None:
    warnings.simplefilter("ignore")
    told: dict[str, dict[str, list[float]]] = {}
    for name, lit in LIT.items():
        for ppm in PPM:
            row = {str(blur): [found_um(lit, ppm, blur, seed) for seed in SEEDS] for blur in BLURS_UM}
            told[f"{name} | {ppm:g}"] = row
            print(name, ppm, row, flush=True)
    RECORD.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    page_tables.put(PAGE, "narrow light", table(told))


if __name__ == "__main__":
    main()
