"""Draw the README's picture: the demo's velocity field beside its truth.

python docs/make_figures.py               run the demo into demo/ and draw it
python docs/make_figures.py VELOCITY.nc   draw a velocity field that the demo has already made
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
import xarray as xr
from matplotlib import pyplot as plt

from plenopiv.cli.demo import TABLES, demo
from plenopiv.experiment import Experiment
from plenopiv.io import read_velocity
from plenopiv.simulation.flows import Velocity, flow

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "images" / "demo.png"
INK, BLUE, ORANGE = "#1f2933", "#1f6fb2", "#d9822b"


def draw(field: xr.Dataset, truth: Velocity, picture: Path) -> None:
    """The x-z slice through the middle, and u over z and w over x for all measured vectors."""
    plt.rcParams.update({"font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False})
    figure, (slice_axes, u_axes, w_axes) = plt.subplots(
        1, 3, figsize=(10.5, 3.6), layout="constrained", width_ratios=[1.25, 1, 1]
    )
    middle = field.isel(time=0, y=field.sizes["y"] // 2)
    x, z = middle["x"].values, middle["z"].values
    colour = slice_axes.pcolormesh(x, z, middle["u"].values, cmap="RdBu_r", shading="nearest", alpha=0.55)
    largest = float(np.abs(middle["u"].values).max())
    colour.set_clim(-largest, largest)
    slice_axes.quiver(x, z, middle["u"].values, middle["w"].values, color=INK, angles="xy", width=0.005)
    slice_axes.set(
        title=f"measured (u, w) at y = {float(middle['y']):.2f} mm", xlabel="x (mm)", ylabel="z (mm), toward the camera"
    )
    figure.colorbar(colour, ax=slice_axes).ax.set_title("u (m/s)", fontsize=9)
    at_z, at_y, at_x = np.meshgrid(*(field[axis].values for axis in "zyx"), indexing="ij")
    true = truth(np.stack([at_x, at_y, at_z], -1).reshape(-1, 3))
    valid = field["valid"].values.reshape(-1) == 1
    for axes, along, name, colour_of, component in (
        (u_axes, at_z, "u", BLUE, 0),
        (w_axes, at_x, "w", ORANGE, 2),
    ):
        where = along.reshape(-1)
        order = np.argsort(where)
        axes.plot(where[valid], field[name].values.reshape(-1)[valid], ".", ms=2.5, alpha=0.5, color=colour_of)
        axes.plot(where[order], true[order, component], color=INK, lw=1.0)
        axes.set(title=f"{name}: measured (dots), true (line)", xlabel=f"{'z' if name == 'u' else 'x'} (mm)")
        axes.set_ylabel(f"{name} (m/s)")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110, facecolor="white")
    plt.close(figure)


def main(arguments: list[str]) -> None:
    """Draw ``arguments[0]``, or the demo."""
    if arguments:
        file = Path(arguments[0])
    else:
        print(demo(ROOT / "demo", overwrite=True))
        file = ROOT / "demo" / "results" / "velocity.nc"
    wanted = Experiment.from_dict(TABLES).simulation
    assert wanted is not None
    draw(read_velocity(file), flow(wanted.flow, **wanted.parameters), PICTURE)
    print(PICTURE)


if __name__ == "__main__":
    main(sys.argv[1:])
