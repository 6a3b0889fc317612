"""Why Q has local minima over depth (the paper's section 3): which voxels the product keeps:  candidates_over_depth.py

The paper's product of pixel values keeps every voxel whose pixels all are lit. A voxel next to the particle's goes as
soon as one ray of its own meets another microlens. Between two such depths the set of lit pixels stays as it is, and so
do the voxels that are kept. On the axis and at places spread over a microlens, with the paper's nine rays a pixel and
with exact areas. Writes candidates-over-depth.png and results/candidates_over_depth.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from outputs import command_line, write_numbers, write_picture
from single_particle_figures import zone
from single_particles import DEPTHS, LIT, RAYS, places
from small_camera import CAMERA, LAYOUT, VOXEL_MM, grid, noise_free

from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import dark_to_light
from plenopiv.report.figures import BLUE, GREEN, STYLE

ACROSS = 65  # voxels along x and y: four microlenses
PLACES = 4
WEIGHTS = {"9-rays": "nine rays a pixel", "exact": "exact areas"}
Row = dict[str, Any]


def kept(lightfield: LightField, projector: PlenopticProjector) -> tuple[int, int]:
    """Voxels that the product keeps of a single particle, and the planes from the first to the last of them."""
    volume = projector.candidates(dark_to_light(lightfield, LIT), 1.0)
    planes = np.flatnonzero(np.diff(volume.row_start[:: volume.grid.shape[1]]))
    return volume.column.size, int(np.ptp(planes)) + 1 if planes.size else 0


def measure(depths: tuple[int, ...], count: int, rays: int) -> list[Row]:
    """Voxels and planes kept at every depth, on the axis and at ``count`` places over a microlens."""
    projectors = {weights: PlenopticProjector(LAYOUT, grid(ACROSS), weights) for weights in WEIGHTS}
    rows = []
    for place, (x, y) in enumerate([(0.0, 0.0), *places(count)]):
        for depth in depths:
            at = (float(x), float(y), depth * VOXEL_MM[2])
            lightfield = noise_free(at, rays)
            for weights, projector in projectors.items():
                voxels, planes = kept(lightfield, projector)
                rows.append({"place": place, "at_mm": at, "weights": weights, "voxels": voxels, "planes": planes})
    return rows


@rc_context(STYLE)
def figure_of(results: Row) -> Figure:
    """Voxels and planes over depth: on the axis bold, elsewhere thin; 0.7 stands for none."""
    figure = Figure(figsize=(10.5, 6.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    rows = results["rows"]
    for across, (weights, name) in enumerate(WEIGHTS.items()):
        for down, key in enumerate(("voxels", "planes")):
            axes = panels[down, across]
            for place in sorted({r["place"] for r in rows}, reverse=True):
                line = [r for r in rows if r["place"] == place and r["weights"] == weights]
                look = {"lw": 1.6, "ms": 5, "color": GREEN if weights == "9-rays" else BLUE, "label": "on the axis"}
                if place:
                    label = "over a microlens" if place == 1 else None
                    look = {"lw": 0.6, "ms": 2, "color": "#8794a1", "label": label}
                axes.plot([r["at_mm"][2] for r in line], [max(r[key], 0.7) for r in line], ".-", **look)
            zone(axes, results)
            axes.axvline(-1.078, color="#1f2933", lw=0.7, ls=":")
            axes.set_yscale("log" if key == "voxels" else "linear")
        panels[0, across].set_title(f"the product keeps, {name}")
        panels[0, across].set_xlabel("")
    panels[0, 0].set_ylabel("voxels")
    panels[1, 0].set_ylabel("planes, 0.077 mm each")
    panels[0, 0].legend(frameon=False)
    return figure


def main(out: Path, reduced: bool = False) -> None:
    """Count, print, write JSON and figure into ``out``; ``reduced``: a few depths, one place beside the axis."""
    rows = measure((-14, -13, 0, 13), 1, 20_000) if reduced else measure(DEPTHS, PLACES, RAYS)
    for r in rows:
        if r["place"] == 0:
            print(f"z = {r['at_mm'][2]:+.3f} mm, {r['weights']}: {r['voxels']} voxels in {r['planes']} planes")
    results = {"dead_zone_mm": CAMERA.dead_zone_mm(), "rows": rows}
    write_numbers(out, "candidates_over_depth", results, indent=0)
    write_picture(out, "candidates-over-depth", figure_of(results), dpi=85)


if __name__ == "__main__":
    command_line(main, __doc__)
