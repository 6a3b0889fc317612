"""Figures of the light field: sub-aperture views, and the frame refocused at several depths."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from plenopiv.report.figures import STYLE, written
from plenopiv.report.stacks import joined

BRIGHTEST = 99.7  # percentile that is drawn white
UNSEEN = "#2c4a63"  # where no microlens has a pixel of a view
CAPTION = 170  # letters in a line
LARGEST = 900  # pixels along a side of one picture

Picture = NDArray[np.float32]
Axis = NDArray[np.float64]


@rc_context(STYLE)
def contact_sheet(
    pictures: Sequence[Sequence[Picture | None]], u_mm: Axis, v_mm: Axis, x: Axis, y: Axis, name: str
) -> Figure:
    """Views side by side as they lie on the main lens: ``pictures[row][column]`` (y, x), the uppermost row first, None
    where the aperture has no view; ``u_mm``, ``v_mm`` of columns and rows."""
    rows, columns = len(pictures), len(pictures[0])
    width = 11.0
    figure = Figure(figsize=(width, 1.3 + width / columns * (y.size / x.size) * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    lit = np.concatenate([p[np.isfinite(p)] for row in pictures for p in row if p is not None])
    top = float(np.percentile(lit, BRIGHTEST))
    for row, v, line in zip(grid, v_mm, pictures, strict=True):
        for axes, u, picture in zip(row, u_mm, line, strict=True):
            axes.set(xticks=[], yticks=[])
            if picture is None:
                axes.set_axis_off()
                continue
            _draw(axes, picture, x, y, top)
            axes.set_title(f"({u:+.1f}, {v:+.1f})", fontsize=7, pad=2)
    figure.suptitle(f"{written(name)}: sub-aperture views", fontsize=10, parse_math=False)
    caption = (
        "Each picture is the scene through one place (u, v) of the main lens, in mm, right and up as the object has "
        f"x and y; it shows {_length(x):.3g} x {_length(y):.3g} mm of the focal plane. Particles in the focal plane "
        "stand at one place in all of them, others move from view to view, the more the farther they are from it. "
        f"Black is 0, white {top:.4g} counts and more; blue: no microlens has a pixel of the view."
    )
    figure.supxlabel("\n".join(wrap(caption, CAPTION)), fontsize=8, ha="left", x=0.01)
    return figure


@rc_context(STYLE)
def depth_strip(pictures: Sequence[Picture], z_mm: Sequence[float], x: Axis, y: Axis, name: str) -> Figure:
    """Refocused pictures (y, x) of several depths."""
    columns = min(len(pictures), 3)
    rows = -(-len(pictures) // columns)
    figure = Figure(figsize=(1.0 + 4.0 * columns, 0.7 + (0.5 + 3.7 * y.size / x.size) * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    top = float(np.nanpercentile(np.array(pictures), BRIGHTEST))
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, picture, z in zip(grid.flat, pictures, z_mm, strict=False):
        axes.set_axis_on()
        drawn = _draw(axes, picture, x, y, top)
        axes.set_title(f"{written(name)}, focus at z = {z:+.2f} mm", parse_math=False)
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
    figure.colorbar(drawn, ax=grid, label="mean of the views (counts)", fraction=0.03, pad=0.01)
    return figure


def _draw(axes: Axes, picture: Picture, x: Axis, y: Axis, top: float) -> AxesImage:
    """A picture whose rows fall with y, on axes in mm."""
    dx, dy = (abs(a[1] - a[0]) / 2 if a.size > 1 else 0.5 for a in (x, y))
    extent = (x[0] - dx, x[-1] + dx, y[-1] - dy, y[0] + dy)
    axes.set_facecolor(UNSEEN)
    return axes.imshow(joined(picture, LARGEST), cmap="gray", vmin=0.0, vmax=max(top, 1e-6), extent=extent)


def _length(axis: Axis) -> float:
    return float(abs(axis[-1] - axis[0]) + (abs(axis[1] - axis[0]) if axis.size > 1 else 0.0))
