"""The Cramer-Rao bound beside what was measured:  bound.py [SCORES.jsonl] [--particles N] [--into FILE]

Writes the table of docs/bound.md between its two marks and draws docs/images/bound.png. SCORES is what
run_conditions.py wrote; without it (or for conditions that it does not hold) the measured columns stay empty. The last
run of a condition with its own file's settings counts.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from conditions import CONDITIONS, Condition
from matplotlib import pyplot as plt

from plenopiv.accuracy import FieldBounds, field_bounds, position_bound, standard_deviation, window_bound
from plenopiv.simulation.particles import pixels_lit_in_focus
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding

DOCS = Path(__file__).parents[2] / "docs"
BEGIN, END = "<!-- bound: begin -->", "<!-- bound: end -->"
NAMES = ("base", "dim", "ppm0.25", "ppm0.5", "ppm2", "depth20", "pmr8", "pmr28")
HEADER = (
    "| condition | \\|z\\|, mm | isolated x / y / z | overlapping x / y / z | no depth % | sharing pixels "
    "| particles per window | window x / y / z | measured x / y / z | measured over bound, x / y / z |"
)
INK, BLUE, ORANGE = "#1f2933", "#1f6fb2", "#d9822b"
FEW = 0.6  # of the particles asked for, where one has a thousand neighbours
NO_DEPTH = 10.0  # times the median: depth is either known to a hundredth of a voxel or to one


@dataclass(frozen=True)
class Run:
    """A condition, the bounds of some of its particles, and the measured errors by depth, if any."""

    condition: Condition
    bounds: FieldBounds
    measured: list[dict[str, Any]]

    def voxels(self, std_mm) -> np.ndarray:
        return np.asarray(std_mm) / self.condition.voxel_mm()

    def depth_half_mm(self) -> float:
        """Half a window's depth."""
        return 0.5 * self.condition.windows[-1][2] * self.condition.voxel_mm()[2]

    def particles_per_window(self) -> float:
        """Particles in a window of the last size: the density times the window's share of the volume's depth."""
        c = self.condition
        size = np.array(c.windows[-1]) * c.voxel_mm()
        lens_mm2 = c.camera().lattice.cell_area_mm2 / c.magnification**2
        return c.particles_per_microlens * size[0] * size[1] / lens_mm2 * size[2] / (c.z_mm[1] - c.z_mm[0])

    def bands(self) -> list[tuple[float, float]]:
        """Thirds of depth of the measured vectors; else of the depths at which whole windows fit."""
        if self.measured:
            return [(band["from_mm"], band["to_mm"]) for band in self.measured]
        return list(pairwise(np.linspace(0.0, self.condition.z_mm[1] - self.depth_half_mm(), 4)))

    def window_std_mm(self, centre_mm: float) -> np.ndarray:
        """Bound of the displacement of a window at a depth, from the particles at the depths that it spans."""
        z = self.bounds.position_mm[:, 2]
        inside = np.abs(np.abs(z) - abs(centre_mm)) <= self.depth_half_mm()
        return window_bound(self.bounds.overlapping[inside], self.particles_per_window())


def electrons(c: Condition) -> float:
    """Mean light of a particle, in electrons."""
    return c.electrons_per_pixel * pixels_lit_in_focus(c.camera())


def bounds(name: str, particles: int) -> FieldBounds:
    c = CONDITIONS[name]
    return field_bounds(
        c.camera(),
        c.particles_per_microlens,
        c.z_mm,
        electrons(c),
        SensorNoise(c.gain, c.read_noise_electrons),
        np.random.default_rng(c.seed),
        particles=particles if name != "depth20" else round(FEW * particles),
        background_electrons=Seeding().background_electrons,
    )


def rows(name: str, run: Run) -> list[str]:
    """A row of the table for each band of depth: medians over particles, RMS over windows."""
    out = []
    z = np.abs(run.bounds.position_mm[:, 2])
    isolated, overlapping = (run.voxels(standard_deviation(j)) for j in (run.bounds.isolated, run.bounds.overlapping))
    no_depth = isolated[:, 2] > NO_DEPTH * np.median(isolated[:, 2])
    for k, (lo, hi) in enumerate(run.bands()):
        # a band holds the windows centred in it, and their particles
        own = np.flatnonzero((z >= lo - run.depth_half_mm()) & (z <= hi + run.depth_half_mm()))
        window = run.voxels([run.window_std_mm(c) for c in np.linspace(lo, hi, 5)])
        window = np.sqrt((window**2).mean(0))
        measured = np.array(run.measured[k]["rms"]) if run.measured else None
        cells = [
            f"`{name}`",
            f"{lo:.1f} to {hi:.1f}",
            three(np.median(isolated[own], 0)),
            three(np.median(overlapping[own], 0)),
            f"{100 * no_depth[own].mean():.0f}",
            f"{run.bounds.neighbours[own].mean():.0f}",
            f"{run.particles_per_window():.0f}",
            three(window, 4),
            three(measured) if measured is not None else "",
            three(measured / window, 0) if measured is not None else "",
        ]
        out.append(f"| {' | '.join(cells)} |")
    return out


def three(values: np.ndarray, digits: int = 3) -> str:
    return " / ".join(f"{v:.{digits}f}" for v in values)


def isolated_curve(name: str, rng: np.random.Generator, places: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Depths, and the 10, 50 and 90 % quantiles (3, depths, axis) over random places of the isolated bound, voxels."""
    c = CONDITIONS[name]
    camera, noise = c.camera(), SensorNoise(c.gain, c.read_noise_electrons)
    depths = np.concatenate([np.linspace(0.05, 0.45, 9), np.linspace(0.6, 4.0, 18)])
    background = Seeding().background_electrons

    def one(z: float) -> np.ndarray:
        place = (*rng.uniform(-0.2, 0.2, 2), z)
        return position_bound(camera, place, electrons(c), noise, background_electrons=background).std_mm

    std = np.array([[one(z) for _ in range(places)] for z in depths]) / c.voxel_mm()
    return depths, np.quantile(std, [0.1, 0.5, 0.9], axis=1)


def draw(runs: dict[str, Run], picture: Path) -> None:
    """Bounds along x and z against |z|, bright and dim, isolated, overlapping and of windows; measured errors."""
    plt.rcParams.update({"font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.8), layout="constrained", sharey=True)
    for name, colour, said in (("base", BLUE, "400 electrons"), ("dim", ORANGE, "80 electrons, read noise 5")):
        run = runs[name]
        depths, (low, median, high) = isolated_curve(name, np.random.default_rng(1))
        at = np.abs(run.bounds.position_mm[:, 2])
        overlapping = run.voxels(standard_deviation(run.bounds.overlapping))
        centres = np.linspace(run.depth_half_mm() / 2, run.condition.z_mm[1] - run.depth_half_mm(), 25)
        window = run.voxels([run.window_std_mm(c) for c in centres])
        for k, ax in zip((0, 2), axes, strict=True):
            ax.fill_between(depths, low[:, k], high[:, k], color=colour, alpha=0.18, lw=0)
            ax.plot(depths, median[:, k], color=colour, lw=1.4, label=f"isolated particle, {said}")
            ax.plot(at, overlapping[:, k], ".", color=colour, ms=3.5, alpha=0.7, label="overlapping, 1 ppm")
            ax.plot(centres, window[:, k], color=colour, lw=1.4, ls="--", label="window, two frames")
            for band in run.measured:
                ax.plot([band["from_mm"], band["to_mm"]], [band["rms"][k]] * 2, color=colour, lw=3, alpha=0.9)
            if run.measured:
                ax.plot([], [], color=colour, lw=3, label="measured, windows (RMS)")
    for ax, title in zip(axes, ("along x", "along z (depth)"), strict=True):
        ax.axvline(CONDITIONS["base"].camera().dead_zone_mm()[1], color=INK, lw=0.8, ls=":")
        ax.set(yscale="log", xlim=(0, 4), ylim=(5e-4, 10), xlabel="|z| (mm)", title=title)
    axes[0].set_ylabel("standard deviation (voxel)")
    figure.legend(*axes[0].get_legend_handles_labels(), frameon=False, fontsize=8, ncols=2, loc="outside lower center")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110, facecolor="white")
    plt.close(figure)


def measured_by_depth(scores: Path | None) -> dict[str, list[dict[str, Any]]]:
    """The final errors by thirds of depth of each condition that was run with its own file's settings."""
    lines = [] if scores is None else [json.loads(text) for text in scores.read_text().splitlines()]
    return {
        line["name"]: line["score"]["final"]["by_depth"] for line in lines if "score" in line and not line["settings"]
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", type=Path, nargs="?")
    parser.add_argument("--particles", type=int, default=100, help="of which bounds are computed for each condition")
    parser.add_argument("--into", type=Path, default=DOCS / "bound.md", metavar="FILE")
    parser.add_argument("--picture", type=Path, default=DOCS / "images" / "bound.png", metavar="FILE")
    arguments = parser.parse_args()
    page = arguments.into.read_text()
    before, mark, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        parser.error(f"{arguments.into} has no {BEGIN} ... {END}")

    measured = measured_by_depth(arguments.scores)
    runs, lines = {}, [HEADER, "|---|---|" + "---:|" * (HEADER.replace("\\|", "").count("|") - 3)]
    for name in NAMES:
        runs[name] = Run(CONDITIONS[name], bounds(name, arguments.particles), measured.get(name, []))
        lines += rows(name, runs[name])
        print("\n".join(rows(name, runs[name])), flush=True)
    table = "\n".join(lines)
    arguments.into.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}")
    draw(runs, arguments.picture)


if __name__ == "__main__":
    main()
