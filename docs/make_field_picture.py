"""Draw the README's 3D picture: the vectors of the gallery's vortex ring, as measured.

python docs/make_field_picture.py   after docs/site/make_gallery.py
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

from plenopiv.io import read_velocity
from plenopiv.velocity import q_criterion, velocity_gradient

ROOT = Path(__file__).parents[1]
FIELD = ROOT / "build" / "gallery" / "vortex-ring" / "velocity.nc"
PICTURE = ROOT / "docs" / "images" / "field.png"


def main() -> int:
    """All vectors, coloured by the velocity toward the camera; those in the vortex core (Q) are heavy."""
    field = read_velocity(FIELD).isel(time=0)
    q = q_criterion(velocity_gradient(field)).reshape(-1)
    z, y, x = (a.reshape(-1) for a in np.meshgrid(field.z, field.y, field.x, indexing="ij"))
    u, v, w = (field[name].values.reshape(-1) for name in "uvw")
    fastest = float(np.hypot(np.hypot(u, v), w).max())
    length = 0.9 / fastest  # mm for a m/s
    plt.rcParams.update({"font.size": 9.0})
    figure = plt.figure(figsize=(8.0, 4.6))
    axes = figure.add_axes((-0.02, 0.03, 0.94, 1.05), projection="3d")
    shades = plt.get_cmap("turbo")
    limit = 0.6 * float(np.abs(w).max())
    shade = shades(np.clip(0.5 + 0.5 * w / limit, 0.0, 1.0))
    for core in (False, True):
        some = (q > 0.2 * q.max()) == core
        axes.quiver(
            x[some], z[some], y[some], length * u[some], length * w[some], length * v[some], pivot="middle",
            color=shade[some], linewidth=2.2 if core else 1.1, alpha=1.0 if core else 0.6,
            arrow_length_ratio=0.4,
        )  # fmt: skip
    axes.set(xlabel="x (mm)", ylabel="z (mm), toward the camera", zlabel="y (mm)")
    axes.set_box_aspect([float(np.ptp(a)) for a in (x, z, y)], zoom=0.9)
    axes.view_init(elev=20, azim=-62)
    scale = plt.cm.ScalarMappable(plt.Normalize(-limit, limit), shades)
    figure.colorbar(scale, ax=axes, extend="both", shrink=0.5, pad=0.02).ax.set_title("w (m/s)", fontsize=9)
    figure.savefig(PICTURE, dpi=110, facecolor="white", bbox_inches="tight")
    plt.close(figure)
    print(PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
