"""What ghosts do to Tomo-PIV of the light field's particles:  ghosts.py [--reduced] [--out FOLDER]

Four cameras see 20 mm of depth at 36/2048 mm/px, 0.06 particles per pixel: more than is usual. The matched Tomo-PIV of
section 4 is measured about the middle of the jet, with a small illuminated volume and with all that lines of sight
cross in the full volume (20 degrees of 10 mm: 3.6 mm to each side); as it is, and without ghosts (light not near a
particle).

Writes results/ghosts.json.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomo_case
from comparison_scores import Judge
from comparison_settings import DEPTH_MM, LightFieldSetting, TomoSetting, matched
from lightfield_case import Reconstructed, seeded
from outputs import command_line, write_numbers

from plenopiv.accuracy.volumes import ghost_light, near_particles
from plenopiv.simulation.flows import flow
from plenopiv.volume import DenseVolume, Volume, VoxelGrid

BOX_MM = (6.0, 5.0, 6.0)  # looked at, about the origin
LIT_MM = ((6.0, 5.0), (14.0, 13.0))  # across; 20 mm deep
NEAR = 3.0  # voxels: light further than that from all particles is a ghost's
SEED = 0


def middle(volume: Volume, sizes_mm: tuple[float, float, float]) -> DenseVolume:
    """The voxels of a box about the middle, its faces those of voxels."""
    grid, counts = volume.grid, []
    for n, size, voxel in zip(grid.shape[::-1], sizes_mm, grid.voxel_mm, strict=True):
        counts.append(min(n, n - 2 * int((n - size / voxel) / 2)))
    (nx, ny, nz), first = counts, [(n - c) // 2 for n, c in zip(grid.shape[::-1], counts, strict=True)]
    kept = volume.slab(first[2], first[2] + nz)[:, first[1] : first[1] + ny, first[0] : first[0] + nx]
    begins = tuple(a + k * v for a, k, v in zip(grid.first_mm, first, grid.voxel_mm, strict=True))
    box = VoxelGrid(begins, grid.voxel_mm, (nz, ny, nx))  # type: ignore[arg-type]
    return DenseVolume(box, kept)


def measured(whole: Reconstructed, volumes: list[DenseVolume], own: TomoSetting, judge: Judge) -> dict[str, Any]:
    """Errors of what windows find in two volumes."""
    chain = replace(whole.chain, grid=volumes[0].grid)
    part = replace(whole, setting=own, chain=chain, volumes=volumes, clock=whole.clock.continued())
    found = part.correlated()
    told, _ = judge.score(replace(found, seen=np.ones(found.seen.shape, bool)))
    everywhere = told["errors"]["window_mean"]["all"]
    return {key: everywhere[key] for key in ("vectors", "gross", "rms_mm_s", "bias_mm_s")}


def case(light: LightFieldSetting, box_mm: tuple[float, float, float]) -> dict[str, Any]:
    """Tomo-PIV of a light field's particles, in a box about its middle, with ghosts and without."""
    setting, jet = matched(light), flow("jet")
    judge = Judge(jet)
    whole = tomo_case.reconstruct_tomo(setting, jet, seeded(light, jet, SEED), SEED)
    volumes = [middle(volume, box_mm) for volume in whole.volumes]
    places = [particles.position_mm for particles in whole.particles]
    own = replace(setting, volume_mm=volumes[0].grid.limits_mm(), inner_window=None)
    without = [v.with_values(v.values * near_particles(v.grid, p, NEAR)) for v, p in zip(volumes, places, strict=True)]
    told = {
        "lit_mm": [high - low for low, high in light.volume_mm],
        "voxels": setting.grid.size,
        "light_of_ghosts": ghost_light(volumes[0], places[0], NEAR),
        "as_it_is": measured(whole, volumes, own, judge),
        "without_ghosts": measured(whole, without, own, judge),
        "seconds": whole.clock.wall_s,
    }
    print(told, flush=True)
    return told


def main(out: Path, reduced: bool) -> None:
    """Measure, and write as told above."""
    lit, depth, box = LIT_MM, DEPTH_MM, BOX_MM
    if reduced:
        lit, depth, box = ((4.0, 4.0),), (-2.0, 2.0), (4.0, 4.0, 4.0)
    cases = []
    for width, height in lit:
        across = (-0.5 * width, 0.5 * width), (-0.5 * height, 0.5 * height)
        cases.append(case(LightFieldSetting((*across, depth)), box))
    write_numbers(out, "ghosts", {"box_mm": box, "near_voxels": NEAR, "cases": cases})


if __name__ == "__main__":
    command_line(main, __doc__)
