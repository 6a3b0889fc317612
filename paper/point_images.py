"""The paper's Fig. 7: the image of a point in focus, and of one 0.385 mm off the focal plane:  point_images.py

The paper does not say to which side of the focal plane its point is moved: both are here. Writes point-images.png and
results/point_images.json.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from outputs import command_line, write_numbers, write_picture
from small_camera import CAMERA, ELECTRONS, LAYOUT, LIGHT

from plenopiv.lightfield import decode
from plenopiv.report.figures import INK, ORANGE, STYLE
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles

DEPTHS_MM = (0.0, 0.385, -0.385)
RAYS = 2_000_000
LIT = 0.01  # of a pixel that the point in focus lights: fainter ones are not counted
LENSES = 5  # shown along a side


def point_image(z_mm: float, rays: int) -> NDArray[np.float64]:
    """Electrons in the pixels, upright (rows, columns), of a point on the axis at ``z_mm``."""
    return particle_image(CAMERA, Particles(np.array([[0.0, 0.0, z_mm]]), np.array([LIGHT])), rays=rays)


def lit(image: NDArray[np.float64]) -> dict[str, Any]:
    """Microlenses and pixels lit, and the brightest pixel in electrons."""
    by_lens = decode(image + CAMERA.sensor.black_level, LAYOUT).values > LIT * ELECTRONS
    return {
        "microlenses": int(by_lens.any(0).sum()),
        "pixels": int((image > LIT * ELECTRONS).sum()),
        "brightest_electrons": float(image.max()),
    }


@rc_context(STYLE)
def figure_of(images: dict[float, NDArray[np.float64]], counts: dict[float, dict[str, Any]]) -> Figure:
    """One panel a depth, the microlenses' borders over the pixels, all on one grey scale."""
    figure = Figure(figsize=(3.5 * len(images), 4.1), layout="constrained")
    column0, row0 = CAMERA.sensor.axis
    half = 0.5 * LENSES * CAMERA.image_pitch_px
    brightest = max(float(image.max()) for image in images.values())
    all_axes = figure.subplots(1, len(images), sharey=True)
    for axes, (z, image) in zip(all_axes, images.items(), strict=True):
        picture = axes.imshow(image, cmap="gray", vmin=0.0, vmax=brightest)
        for k in np.arange(LENSES + 1) - 0.5 * LENSES:
            axes.axvline(column0 + k * CAMERA.image_pitch_px, color=ORANGE, lw=0.6)
            axes.axhline(row0 + k * CAMERA.image_pitch_px, color=ORANGE, lw=0.6)
        axes.set(xlim=(column0 - half - 2, column0 + half + 2), ylim=(row0 + half + 2, row0 - half - 2))
        where = "in focus" if z == 0 else f"{abs(z)} mm {'toward' if z > 0 else 'away from'} the camera"
        lenses, pixels = counts[z]["microlenses"], counts[z]["pixels"]
        axes.set_title(f"{where}\n{lenses} microlens{'es' * (lenses > 1)}, {pixels} pixels", color=INK)
        axes.set_xlabel("column (px)")
    all_axes[0].set_ylabel("row (px)")
    figure.colorbar(picture, ax=all_axes, shrink=0.75, label="electrons")
    return figure


def main(out: Path, reduced: bool = False) -> None:
    """Trace, count, print, draw into ``out``; ``reduced``: with a hundredth of the rays."""
    images = {z: point_image(z, RAYS // 100 if reduced else RAYS) for z in DEPTHS_MM}
    counts = {z: lit(image) for z, image in images.items()}
    for z, found in counts.items():
        print(f"z = {z:+.3f} mm: {found}")
    write_numbers(out, "point_images", {f"{z:+.3f}": found for z, found in counts.items()})
    write_picture(out, "point-images", figure_of(images, counts), dpi=110)


if __name__ == "__main__":
    command_line(main, __doc__)
