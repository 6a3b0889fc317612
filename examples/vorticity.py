"""Vorticity and Q-criterion of a measured field, with error bars.

    python examples/vorticity.py [FOLDER]

Reads FOLDER/results/velocity.nc, where FOLDER, "ring" by default, is one that examples/vortex_ring.py made, or yours.
Prints the strongest vorticity along each axis with its standard deviation and where Q is largest, and draws the
vorticity about y into FOLDER/vorticity.png.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from plenopiv.io import read_velocity
from plenopiv.velocity import q_criterion, velocity_gradient, vorticity

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "ring")
field = read_velocity(folder / "results" / "velocity.nc").isel(time=0)
gradient = velocity_gradient(field)  # (component u v w, derivative along x y z, z, y, x) in 1/s
omega, q = vorticity(gradient), q_criterion(gradient)  # (x y z, z, y, x) in 1/s; (z, y, x) in 1/s^2


def variance(component: str, axis: str) -> np.ndarray:
    """Of a central difference, 1/s^2: of vectors whose windows, at 50 % overlap, touch but hardly share particles."""
    std, spacing_m = field[f"{component}_std"], 1e-3 * float(field[axis][1] - field[axis][0])
    return ((std.shift({axis: 1}) ** 2 + std.shift({axis: -1}) ** 2) / (2 * spacing_m) ** 2).values


pairs = {"x": ("w", "y", "v", "z"), "y": ("u", "z", "w", "x"), "z": ("v", "x", "u", "y")}  # omega_x = dw/dy - dv/dz
std = np.stack([np.sqrt(variance(a, b) + variance(c, d)) for a, b, c, d in pairs.values()])  # NaN at the faces

for axis, values, error in zip("xyz", omega, std, strict=True):
    inside = np.where(np.isfinite(error), np.abs(values), -1.0)
    at = np.unravel_index(np.argmax(inside), inside.shape)
    place = ", ".join(f"{c} = {float(field[c][k]):.2f}" for c, k in zip("zyx", at, strict=True))
    print(f"vorticity along {axis}: at most {values[at]:+.0f} +- {error[at]:.0f} 1/s, at {place} mm")
at = np.unravel_index(np.nanargmax(q), q.shape)
print(f"Q: at most {q[at]:.3g} 1/s^2; {100 * np.mean(q > 0):.0f} % of the vectors turn more than they deform")

j, i = (int(np.abs(field[axis].values).argmin()) for axis in "yx")
figure = Figure(figsize=(9.5, 4.0), layout="constrained")
left, right = figure.subplots(1, 2)
limit = float(np.abs(omega[1, 1:-1, j, 1:-1]).max(initial=0.0)) or 1.0  # at the faces derivatives are one-sided
colour = left.pcolormesh(field.x, field.z, omega[1, :, j], cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest")
left.contour(field.x, field.z, q[:, j], levels=[0.0], colors="black")
left.set(title=f"vorticity along y at y = {float(field.y[j]):.2f} mm; line: Q = 0", xlabel="x (mm)", ylabel="z (mm)")
figure.colorbar(colour, label="1/s")
right.errorbar(field.z, omega[1, :, j, i], 2 * std[1, :, j, i], fmt="o", capsize=3)
right.set(title=f"at x = {float(field.x[i]):.2f} mm, +- 2 standard deviations", xlabel="z (mm)", ylabel="1/s")
figure.savefig(folder / "vorticity.png", dpi=120)
print("drawn:", folder / "vorticity.png")
