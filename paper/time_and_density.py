"""The paper's Fig. 9c: how much longer MART takes than DRT-MART, by seeding density:  time_and_density.py

1 to 4 particles per microlens in the small camera's volume, an image with noise, thresholds that the image decides, as
in a run. Both methods share all but the voxels that they start from, with faint voxels kept between iterations and left
out (as runs do). One measurement each, nothing compiled in the time that counts. Writes time-and-density.png and
results/time_and_density.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from outputs import command_line, write_numbers, write_picture
from small_camera import ACROSS, CAMERA, ELECTRONS, LAYOUT, LIGHT, Found, grid, reconstructed

from plenopiv.accuracy import exact_volume, reconstruction_quality
from plenopiv.lightfield import LightField, decode
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import faintest_share, lit_threshold, typical_particle
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.reconstruct import THIN
from plenopiv.report.figures import BLUE, GREEN, ORANGE, STYLE
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

DENSITIES = (1.0, 2.0, 3.0, 4.0)  # particles per microlens
NOISE, STRAY = SensorNoise(0.5, 3.0), 4.0  # counts per electron and read noise in electrons; electrons in every pixel
SPREAD = 0.25  # of the particles' light, relative
RAYS = 4000  # of each particle
SEED = 3
METHODS = ("mart", "bound", "product")
Row = dict[str, Any]


def scene(voxels: VoxelGrid, ppm: float) -> tuple[Particles, LightField]:
    """Particles strewn over a volume, and one noisy frame of them."""
    rng = np.random.default_rng(SEED)
    particles = seed_box(CAMERA, voxels.limits_mm(), ppm, rng, electrons=LIGHT, electrons_spread=SPREAD)  # type: ignore[arg-type]
    mean = particle_image(CAMERA, particles, rays=RAYS, seed=SEED) + STRAY
    return particles, decode(digitise(mean, CAMERA.sensor, NOISE, rng), LAYOUT)


def found_by(lightfield: LightField, projector: PlenopticProjector, method: str, thin: float) -> Found:
    """One reconstruction with the thresholds that a run would take from the image."""
    noise = Noise(dark_noise(lightfield), NOISE.gain)
    lit = lit_threshold(lightfield, noise)
    typical = typical_particle(lightfield, projector, noise)
    share = faintest_share(lightfield, typical * projector.light_in_focus)
    faintest = max(share * typical, lit / projector.light_in_focus)
    return reconstructed(lightfield, projector, method, faintest=faintest, lit=lit, noise=noise, thin=thin)  # type: ignore[arg-type]


def measure(across: int, densities: tuple[float, ...]) -> list[Row]:
    """Seconds, Q and voxels started from, of every method at every density, with and without thinning."""
    projector, small = (PlenopticProjector(LAYOUT, grid(n)) for n in (across, 41))
    rows: list[Row] = []
    for method in METHODS:
        found_by(scene(small.grid, densities[0])[1], small, method, THIN)  # compiles
    for ppm in densities:
        particles, lightfield = scene(projector.grid, ppm)
        exact = exact_volume(particles.position_mm, particles.electrons, projector.grid)
        for thin in (0.0, THIN):
            for method in METHODS:
                found = found_by(lightfield, projector, method, thin)
                kept = found.started / projector.grid.size
                quality = reconstruction_quality(found.volume, exact)
                rows.append({"ppm": ppm, "thin": thin, "method": method, "seconds": found.seconds, "kept": kept})
                rows[-1] |= {"q": quality, "particles": len(particles.electrons)}
                print(
                    f"{ppm:g} ppm, thin {thin:g}, {method}: {found.seconds:.2f} s, {kept:.2%}, Q {quality:.3f}",
                    flush=True,
                )
    return rows


def value(rows: list[Row], method: str, thin: float, key: str) -> np.ndarray:
    """One measure of one method over the densities."""
    return np.array([r[key] for r in rows if r["method"] == method and r["thin"] == thin])


@rc_context(STYLE)
def figure_of(rows: list[Row]) -> Figure:
    """Ratio of times, voxels kept, Q."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    ratio, kept, quality = figure.subplots(1, 3)
    densities = value(rows, "mart", 0.0, "ppm")
    looks = {"mart": ("MART", ORANGE), "bound": ("DRT-MART", BLUE), "product": ("DRT-MART, paper's product", GREEN)}
    for method, (name, colour) in looks.items():
        for thin, style in ((0.0, "o-"), (THIN, "s--")):
            label = f"{name}{', thinned' if thin else ''}"
            draw = {"color": colour, "ms": 4, "lw": 1.2, "label": label}
            if method != "mart":
                slower = value(rows, "mart", thin, "seconds") / value(rows, method, thin, "seconds")
                ratio.plot(densities, slower, style, **draw)
            quality.plot(densities, value(rows, method, thin, "q"), style, **draw)
        if method != "mart":
            kept.plot(densities, 100 * value(rows, method, 0.0, "kept"), "o-", color=colour, ms=4, lw=1.2, label=name)
    ratio.set(ylabel="time of MART / time of DRT-MART", ylim=(0, 1.5 * ratio.get_ylim()[1]))  # legend above the curves
    kept.set(ylabel="candidate voxels (%)", ylim=(0, None))
    quality.set(ylabel="Q (exact: Gaussian of 3 voxels)", ylim=(0, None))
    for axes in (ratio, kept, quality):
        axes.set_xlabel("particles per microlens")
        axes.set_xticks(densities)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=7)
    return figure


def main(out: Path, reduced: bool = False) -> None:
    """Measure, print, write JSON and figure into ``out``; ``reduced``: a small volume and two densities."""
    rows = measure(49, (1.0, 2.0)) if reduced else measure(ACROSS, DENSITIES)
    about = {"threads": numba.get_num_threads(), "electrons_per_pixel": ELECTRONS, "rows": rows}
    write_numbers(out, "time_and_density", about)
    write_picture(out, "time-and-density", figure_of(rows), dpi=90)


if __name__ == "__main__":
    command_line(main, __doc__)
