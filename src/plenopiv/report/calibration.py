"""The figure of ``plenopiv calibrate``: how far a target's dots lie off, by depth, over the field, and in each view."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plenopiv.calibration.target.calibrated import BLOCKS, TargetCalibration
from plenopiv.report.figures import COLOURS, INK, STYLE, bar

AXES = dict(zip("xyz", COLOURS.values(), strict=True))


@rc_context(STYLE)
def calibration_figure(calibration: TargetCalibration) -> Figure:
    """RMS and mean residual by depth, of planes that were left out of the fit; mean shift in each view over the
    aperture; RMS residual of the fit over the field."""
    figure = Figure(figsize=(12.5, 7.4), layout="constrained")
    (rms, mean, views), field = figure.subplots(2, 3)
    z = np.array([plane.z_mm for plane in calibration.planes])
    order = np.argsort(z)
    for axes, values, title in (
        (rms, [plane.rms_um for plane in calibration.planes], "left-out residual, RMS"),
        (mean, [plane.mean_um for plane in calibration.planes], "left-out residual, mean"),
    ):
        _by_depth(axes, z[order], np.array(values, float)[order], title)
    _views(views, calibration)
    blocks = np.array(calibration.field_um, float)
    for k, (axes, name) in enumerate(zip(field, AXES, strict=True)):
        _field(axes, blocks[..., k], name)
    return figure


def _by_depth(axes: Axes, z_mm: np.ndarray, values: np.ndarray, title: str) -> None:
    """x and y against the left axis, z, which is known ten times worse, against the right one."""
    depth = axes.twinx()
    for k, (name, colour) in enumerate(AXES.items()):
        on = depth if name == "z" else axes
        on.plot(z_mm, values[:, k], "so"[k < 2] + "-", markersize=3.5, color=colour, label=name)
    axes.set(title=title, xlabel="z of the plane (mm)", ylabel="x, y (um)")
    depth.set_ylabel("z (um)", color=AXES["z"])
    for on, shown in ((axes, values[:, :2]), (depth, values[:, 2:])):
        top = 1.25 * float(np.nanmax(np.abs(shown), initial=0.0)) or 1.0  # room for the legend
        on.set_ylim(0 if title.endswith("RMS") else -top, top)
        on.spines["top"].set_visible(False)
    if not title.endswith("RMS"):
        axes.axhline(0, color=INK, linewidth=0.6, linestyle=":")
    lines = [*axes.get_lines()[:2], *depth.get_lines()]
    axes.legend(lines, list(AXES), frameon=False, ncols=3, loc="upper center")


def _views(axes: Axes, calibration: TargetCalibration) -> None:
    """An arrow for each view, where its pixel lies under the microlenses, +v up."""
    m, n, s, t = np.array(calibration.views_um, float).reshape(-1, 4).T
    axes.set(title="mean shift of all dots in each view", aspect="equal")
    axes.set(xlabel="pixel of the view, to the right", ylabel="upward")
    if not len(m):
        return
    size = np.hypot(s, t)
    largest = float(size.max()) or 1.0
    arrows = axes.quiver(
        m, -n, s, t, size, angles="xy", scale_units="xy", scale=largest / 1.2, cmap="viridis", width=0.006
    )
    reach = float(np.hypot(m, n).max()) + 1.5
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    bar(arrows, axes, "on the microlens plane (um)")


def _field(axes: Axes, blocks: np.ndarray, name: str) -> None:
    """Numbers of the blocks, +y up."""
    top = float(np.nanmax(blocks, initial=0.0)) or 1.0
    picture = axes.imshow(blocks, cmap="Blues", vmin=0, vmax=1.6 * top)  # light enough for the numbers
    for (row, column), value in np.ndenumerate(blocks):
        axes.text(column, row, f"{value:.2f}", ha="center", va="center", color=INK)
    axes.set(title=f"residual of {name} over the field, RMS", xlabel="x, by thirds", ylabel="y, by thirds")
    axes.set_xticks(range(BLOCKS), ["-x", "", "+x"])
    axes.set_yticks(range(BLOCKS), ["+y", "", "-y"])
    bar(picture, axes, "um")
