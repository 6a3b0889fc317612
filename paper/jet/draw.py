"""Draws the jet that is shipped: axial velocity, vorticity, and where the fluid turns. docs/images/paper/jet.png."""

from __future__ import annotations

import argparse
from io import BytesIO
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from PIL import Image

from plenopiv.simulation.netcdf_grid import read_netcdf

ROOT = Path(__file__).parents[2]
DOTS_PER_INCH, COLOURS = 100, 256
HALF_MM = 10.0  # of the pictures along y and z
SECTION_MM = 0.0  # x of the cross-section


def gradients(velocity, spacing_mm):
    """du_i/dx_j in 1/s, (3, 3, z, y, x), of a periodic field: central differences of sixth order."""
    weights = {1: 0.75, 2: -0.15, 3: 1.0 / 60.0}
    g = np.empty((3, 3, *velocity.shape[:3]))
    for j, h in enumerate(spacing_mm):
        for i in range(3):
            f = velocity[..., i]
            g[i, j] = sum(w * (np.roll(f, -n, 2 - j) - np.roll(f, n, 2 - j)) for n, w in weights.items()) / (h * 1e-3)
    return g


def main() -> None:
    """Draw the file that is shipped, or another."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--file", type=Path, default=ROOT / "src" / "plenopiv" / "simulation" / "jet.nc")
    arguments.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "paper" / "jet.png")
    wanted = arguments.parse_args()
    grid = read_netcdf(wanted.file)
    x, y, z = (a + h * np.arange(n)
               for a, h, n in zip(grid.first, grid.spacing, grid.velocity.shape[2::-1], strict=True))  # fmt: skip
    g = gradients(grid.velocity, grid.spacing)
    vorticity = np.sqrt((g[2, 1] - g[1, 2]) ** 2 + (g[0, 2] - g[2, 0]) ** 2 + (g[1, 0] - g[0, 1]) ** 2)
    turning = -0.5e-5 * (g * g.swapaxes(0, 1)).sum((0, 1))  # Q = (|rotation|^2 - |strain|^2) / 2
    at_x, at_z = int(np.abs(x - SECTION_MM).argmin()), int(np.abs(z).argmin())
    (left_mm, right_mm), (low_mm, high_mm), (far_mm, near_mm) = (
        (c[0] - h / 2, c[-1] + h / 2) for c, h in zip((x, y, z), grid.spacing, strict=True)
    )
    side = {"origin": "lower", "extent": (left_mm, right_mm, low_mm, high_mm), "interpolation": "bilinear"}
    across = {**side, "extent": (far_mm, near_mm, low_mm, high_mm)}
    speed = {"cmap": "viridis", "vmin": 0.0, "vmax": 0.45}
    spin = {"cmap": "magma", "vmin": 0.0, "vmax": round(float(np.quantile(vorticity[at_z], 0.999)), -2)}
    q = {"cmap": "YlGnBu_r", "vmin": 0.0, "vmax": float(f"{np.quantile(turning.max(0), 0.99):.1g}")}

    figure, panels = plt.subplots(3, 2, figsize=(9.6, 8.6), width_ratios=(1.8, 1.0), layout="constrained")
    rows = (
        ("u at z = 0", grid.velocity[at_z, :, :, 0], "u at x = 0", grid.velocity[:, :, at_x, 0].T, speed, "m/s"),
        ("vorticity at z = 0", vorticity[at_z], "vorticity at x = 0", vorticity[:, :, at_x].T, spin, "1/s"),
        (
            "largest Q along z, as seen from the camera",
            np.maximum(turning, 0.0).max(0),
            "largest Q along x",
            np.maximum(turning, 0.0).max(2).T,
            q,
            "10⁵/s²",
        ),
    )
    for (left, right), (title, plane, title_across, section, colours, unit) in zip(panels, rows, strict=True):
        shown = left.imshow(plane, **side, **colours)
        right.imshow(section, **across, **colours)
        figure.colorbar(shown, ax=right, label=unit, shrink=0.9)
        left.set(title=title, ylabel="y (mm)", xlim=(left_mm, right_mm), ylim=(-HALF_MM, HALF_MM))
        right.set(title=title_across, xlim=(-HALF_MM, HALF_MM), ylim=(-HALF_MM, HALF_MM))
    panels[2, 0].set_xlabel("x (mm)")
    panels[2, 1].set_xlabel("z (mm), toward the camera")
    drawn = BytesIO()
    figure.savefig(drawn, dpi=DOTS_PER_INCH)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(wanted.out, optimize=True)
    print(f"{wanted.out}: {wanted.out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
