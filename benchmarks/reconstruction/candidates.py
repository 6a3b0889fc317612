"""The two error rates of dense ray tracing by depth:  candidates.py [NAMES] [--recordings DIR] [--into FILE]

NAMES are conditions of ../accuracy/conditions.py; their recordings are made in DIR where they are missing. A particle
is *lost* when none of the eight voxels around it stays; *kept* is the share of all voxels. Both for the program's own
noise and typical particle, at several shares of it, and for the paper's product of exact weights.
"""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise, product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "accuracy"))
from conditions import CONDITIONS

from plenopiv.experiment import Experiment
from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import (
    dark_to_light,
    lit_threshold,
    most_light,
)
from plenopiv.reconstruction.noise import Noise, counts_per_electron, dark_noise
from plenopiv.reconstruction.typical_particle import typical_particle
from plenopiv.run.calibrated import calibrated_camera
from plenopiv.volume import SparseVolume

BEGIN, END = "<!-- candidates: begin -->", "<!-- candidates: end -->"
NAMES = ("base", "ppm2", "dim", "depth20")
SHARES = (0.2, 0.3, 0.4, 0.5, 0.6)
EDGES = (0.0, 0.3, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0)


def rates(volume: SparseVolume, particles_mm: np.ndarray) -> list[tuple[float, float]]:
    """(lost, kept), each a share, for every band of |z| that the grid holds."""
    grid = volume.grid
    place = (particles_mm - np.array(grid.first_mm)) / np.array(grid.voxel_mm)
    first = np.floor(place).astype(int)
    inside = ((first >= 0) & (first < np.array(grid.shape[::-1]) - 1)).all(1)
    first, depth = first[inside], np.abs(particles_mm[inside, 2])
    alive = volume.dense().values > 0
    found = np.zeros(len(first), bool)
    for dx, dy, dz in product((0, 1), repeat=3):
        found |= alive[first[:, 2] + dz, first[:, 1] + dy, first[:, 0] + dx]
    planes = np.abs(grid.axes()[2])
    out = []
    for lo, hi in pairwise(EDGES):
        band, of_band = (depth >= lo) & (depth < hi), (planes >= lo) & (planes < hi)
        if band.any() and of_band.any():
            out.append((float(1 - found[band].mean()), float(alive[of_band].mean())))
    return out


def table(name: str, folder: Path) -> str:
    """One condition's rates as Markdown."""
    if not (folder / "experiment.toml").exists():
        CONDITIONS[name].simulate(folder)
    experiment = Experiment.load(folder / "experiment.toml")
    recording = experiment.recording()
    camera, _ = calibrated_camera(experiment, recording)
    where = layout(camera)
    projector = PlenopticProjector(where, experiment.grid(), "exact")
    frame, white = decode(recording.frame(0), where), decode(recording.white(), where)
    noise = Noise(dark_noise(frame), counts_per_electron(white))
    typical = typical_particle(frame, projector, noise)
    particles = np.load(folder / "truth_particles.npz")["a"]
    rules = {
        f"bound, {share:g} of the typical": projector.candidates(most_light(frame, noise), share * typical)
        for share in SHARES
    }
    rules["product"] = projector.candidates(dark_to_light(frame, lit_threshold(frame, noise)), 1.0)
    measured = {rule: rates(volume, particles) for rule, volume in rules.items()}
    bands = [f"{lo:g}-{hi:g}" for lo, hi in pairwise(EDGES)][: len(next(iter(measured.values())))]
    lines = [
        f"`{name}`: {CONDITIONS[name].varies}. Measured: dark noise {noise.dark:.2f} counts, "
        f"{noise.counts_per_electron:.3f} counts an electron, typical particle "
        f"{typical * projector.light_in_focus:.0f} counts in a pixel in focus.",
        "",
        "| lost / kept, %, by abs(z) in mm | " + " | ".join(bands) + " | all |",
        "|---|" + "---:|" * (len(bands) + 1),
    ]
    for rule, volume in rules.items():
        cells = [f"{100 * lost:.1f} / {100 * kept:.1f}" for lost, kept in measured[rule]]
        lines.append(f"| {rule} | " + " | ".join(cells) + f" | {100 * volume.occupancy:.1f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAMES", default=list(NAMES))
    parser.add_argument("--recordings", type=Path, default=Path("build/accuracy"), metavar="DIR")
    parser.add_argument("--into", type=Path, metavar="FILE", help="replace what stands between the marks")
    arguments = parser.parse_args()
    text = "\n\n".join(table(name, arguments.recordings / name) for name in arguments.names)
    print(text)
    if arguments.into:
        page = arguments.into.read_text()
        before, after = page[: page.index(BEGIN) + len(BEGIN)], page[page.index(END) :]
        arguments.into.write_text(f"{before}\n{text}\n{after}")


if __name__ == "__main__":
    main()
