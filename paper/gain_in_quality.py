"""What would give DRT-MART the gain in Q over MART that the paper finds:  gain_in_quality.py

Single particles on the axis outside the dead zone, without noise, as in single_particles.py. MART on all voxels and on
those that the paper's product leaves, for several iterations, relaxations, and with and without the equations of dark
pixels: without them a voxel is corrected by the lit pixels alone that it reaches, and one that reaches none is left
out. Writes results/gain_in_quality.json.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from outputs import command_line, write_numbers
from single_particles import EXACT, LIT, NARROW
from small_camera import LAYOUT, SETTINGS, VOXEL_MM, grid, noise_free

from plenopiv.accuracy import exact_volume, reconstruction_quality
from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import dark_to_light
from plenopiv.reconstruction.mart import mart
from plenopiv.reconstruction.reconstruct import SMALLEST_FLOOR
from plenopiv.volume import SparseVolume

DEPTHS = (-24, -19, -14, -9, -5, 5, 9, 14, 19, 24)  # planes of voxels, 0.077 mm apart
RAYS = 400_000


@dataclass(frozen=True)
class Way:
    """How MART is done."""

    iterations: int = SETTINGS.iterations
    relaxation: float = SETTINGS.relaxation
    dark: bool = True  # dark pixels are equations

    def __str__(self) -> str:
        without = "" if self.dark else ", no dark pixels"
        return f"{self.iterations} iterations, relaxation {self.relaxation:g}{without}"


WAYS = (
    *(Way(iterations=n) for n in (1, 2, 5, 10, 20)),
    *(Way(relaxation=r) for r in (0.1, 1.0)),
    *(Way(iterations=n, dark=False) for n in (1, 5, 20)),
    Way(relaxation=1.0, dark=False),
)


def quality(found: SparseVolume, at_mm: np.ndarray) -> float:
    """Q against a Gaussian of 3 voxels."""
    volume = found.dense()
    return float(reconstruction_quality(volume, exact_volume([at_mm], 1.0, volume.grid, EXACT["gauss"])))


def reconstructed(lightfield: LightField, projector: PlenopticProjector, start: SparseVolume, way: Way) -> SparseVolume:
    """MART from all voxels of ``start`` alike; voxels that no equation has reached are emptied."""
    values, first = lightfield.values, np.float32(lightfield.values.sum(dtype=np.float64) / start.column.size)
    if not way.dark:
        lit = values > LIT
        of_lit = replace(LAYOUT, seen=LAYOUT.seen & lit, lost=LAYOUT.seen & ~lit)
        projector = PlenopticProjector(of_lit, projector.grid)
    volume = replace(start, values=np.full(start.column.size, first))
    settings = {"iterations": way.iterations, "relaxation": way.relaxation, "seed": SETTINGS.seed}
    found, _ = mart(np.where(projector.seen, values, 0.0), projector, volume, floor=SMALLEST_FLOOR, **settings)
    found.values[found.values == first] = 0.0
    return found


def measure(depths: tuple[int, ...], across: int, rays: int) -> list[dict[str, object]]:
    """Q of both by way, a line each: mean over the depths, the least and the largest gain of DRT-MART."""
    projector = PlenopticProjector(LAYOUT, grid(across))
    found: dict[Way, list[tuple[float, float]]] = {way: [] for way in WAYS}
    for depth in depths:
        at = np.array([0.0, 0.0, depth * VOXEL_MM[2]])
        lightfield = noise_free(at, rays)
        starts = projector.visible_voxels(), projector.candidates(dark_to_light(lightfield, LIT), 1.0)
        for way in WAYS:
            mart_q, drt_q = (quality(reconstructed(lightfield, projector, start, way), at) for start in starts)
            found[way].append((mart_q, drt_q))
        print(f"z = {at[2]:+.3f} mm", {str(way): np.round(q[-1], 3).tolist() for way, q in found.items()}, flush=True)
    lines = []
    for way, pairs in found.items():
        q = np.array(pairs)
        gain = q[:, 1] - q[:, 0]
        line = {"way": str(way), "mart": q[:, 0].mean(), "drt": q[:, 1].mean(), "gain": (gain.min(), gain.max())}
        lines.append({key: np.round(each, 4).tolist() if key != "way" else each for key, each in line.items()})
    return lines


def main(out: Path, reduced: bool) -> None:
    """Measure and write."""
    depths, rest = (DEPTHS[::4], (65, 20_000)) if reduced else (DEPTHS, (NARROW, RAYS))
    found = measure(depths, *rest)
    write_numbers(out, "gain_in_quality", {"depths_mm": [d * VOXEL_MM[2] for d in depths], "ways": found})


if __name__ == "__main__":
    command_line(main, __doc__)
