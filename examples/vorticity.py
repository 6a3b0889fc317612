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

import plenopiv
from plenopiv.io import read_velocity
from plenopiv.statistics import velocity_gradients

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "ring")
field = read_velocity(folder / "results" / "velocity.nc").isel(time=0)
settings = plenopiv.load(str(folder / "results" / "experiment.toml")).correlation.settings()  # errors depend on windows
found = velocity_gradients(field, settings)  # xarray on (z, y, x): du_dx, ..., vorticity_x, ..., q; each with its _std
omega, std = (np.stack([found[f"vorticity_{axis}{end}"] for axis in "xyz"]) for end in ("", "_std"))  # 1/s
q = found.q.values  # 1/s^2

for axis, values, error in zip("xyz", omega, std, strict=True):
    inside = np.where(np.isfinite(error), np.abs(values), -1.0)
    at = np.unravel_index(np.argmax(inside), inside.shape)
    place = ", ".join(f"{c} = {float(field[c][k]):.2f}" for c, k in zip("zyx", at, strict=True))
    print(f"vorticity along {axis}: at most {values[at]:+.0f} +- {error[at]:.0f} 1/s, at {place} mm")
turn = 100 * np.mean(q[np.isfinite(q)] > 0)
print(f"Q: at most {np.nanmax(q):.3g} 1/s^2; {turn:.0f} % of the vectors turn more than they deform")

j, i = (int(np.abs(field[axis].values).argmin()) for axis in "yx")
figure = Figure(figsize=(9.5, 4.0), layout="constrained")
left, right = figure.subplots(1, 2)
inside = np.abs(omega[1, 1:-1, j, 1:-1])  # at the faces derivatives are one-sided
limit = float(np.nan_to_num(inside).max(initial=0.0)) or 1.0
colour = left.pcolormesh(field.x, field.z, omega[1, :, j], cmap="RdBu_r", vmin=-limit, vmax=limit, shading="nearest")
left.contour(field.x, field.z, q[:, j], levels=[0.0], colors="black")
left.set(title=f"vorticity along y at y = {float(field.y[j]):.2f} mm; line: Q = 0", xlabel="x (mm)", ylabel="z (mm)")
figure.colorbar(colour, label="1/s")
right.errorbar(field.z, omega[1, :, j, i], 2 * std[1, :, j, i], fmt="o", capsize=3)
right.set(title=f"at x = {float(field.x[i]):.2f} mm, +- 2 standard deviations", xlabel="z (mm)", ylabel="1/s")
figure.savefig(folder / "vorticity.png", dpi=120)
print("drawn:", folder / "vorticity.png")
