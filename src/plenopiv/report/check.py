"""The figure of ``plenopiv check``: images with the lattice, counts, displacements, and the findings as text."""

from __future__ import annotations

from textwrap import wrap

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from plenopiv.checks import CheckResult
from plenopiv.errors import printable
from plenopiv.report.figures import BLUE, GREEN, INK, ORANGE, STYLE, TITLE, arrow_key, written
from plenopiv.report.views import RawCrop, raw_crops

RED = "#b3261e"
COLOURS = {"unusable": RED, "warning": ORANGE, "good": GREEN}  # the worst first
LETTERS = 60  # in a line of the findings


@rc_context(STYLE)
def check_figure(found: CheckResult) -> Figure:
    """White image and frame with the lattice, shifts between them, counts, displacements, and the findings."""
    figure = Figure(figsize=(13.0, 8.6), layout="constrained")
    (first, second, shifts), (counts, moves, words) = figure.subplots(2, 3)
    if found.white is not None:
        lattice = found.camera.lattice if found.lattice is None else found.lattice.lattice
        _raw(first, raw_crops(found.white, found.camera.with_lattice(lattice), "white image")[1])
    else:
        _nothing(first, "no white image")
    _raw(second, raw_crops(found.frame, found.camera, found.name)[1])
    _shifts(shifts, found)
    _counts(counts, found)
    _moves(moves, found)
    _words(words, found)
    return figure


def _raw(axes: Axes, crop: RawCrop) -> None:
    """Raw pixels with the circles that micro-images should fill."""
    rows, columns = crop.counts.shape
    column, row = crop.corner
    extent = (column - 0.5, column + columns - 0.5, row + rows - 0.5, row - 0.5)
    axes.imshow(crop.counts, cmap="gray", vmax=float(np.percentile(crop.counts, 99.8)), extent=extent)
    size = np.full(len(crop.centres_px), 2 * crop.radius_px)
    circles = EllipseCollection(size, size, 0 * size, units="x", offsets=crop.centres_px, linewidth=0.8)
    circles.set(offset_transform=axes.transData, facecolor="none", edgecolor=ORANGE)
    axes.add_collection(circles)
    axes.set_title(written(crop.name), parse_math=False)
    axes.set(xlabel="column (px)", ylabel="row (px)", xlim=extent[:2], ylim=extent[2:])


def _nothing(axes: Axes, why: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes, color=INK)


def _shifts(axes: Axes, found: CheckResult) -> None:
    """Where the frame's micro-images lie off the white image's, over the sensor."""
    if found.fit is None:
        return _nothing(axes, "frames were not compared\nwith the white image")
    rows, columns = found.frame.shape
    place, shift = found.fit.centres_px, found.fit.shifts_px
    length = np.hypot(*shift.T)
    shift, beyond = _shortened(shift, usual := max(_usual(length), 0.1))
    key = float(f"{usual:.1g}")
    span = 0.12 * max(rows, columns)
    axes.quiver(*place.T, *shift.T, angles="xy", scale_units="xy", scale=key / span, color=BLUE, width=0.006)
    arrow_key(axes, 0, span, f"{key:g} px{_said(beyond)}")
    axes.set(xlim=(0, columns), ylim=(rows, 0), xlabel="column (px)", ylabel="row (px)", aspect="equal")
    axes.set_title("frame off the white image", loc="left", pad=TITLE)
    return None


def _usual(length: NDArray) -> float:
    """The length that arrows are drawn to the scale of: the nineteenth of twenty, no more than five medians, so that a
    few outliers do not shrink all others to points."""
    return float(min(np.percentile(length, 95), 5 * np.median(length))) or float(length.max())


def _shortened(vectors: NDArray, usual: float) -> tuple[NDArray, int]:
    """Vectors (n, 2 or more), by their first two no longer than twice ``usual``, and how many were longer."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    longest = 2 * usual
    factor = np.minimum(1.0, longest / np.maximum(length, 1e-300))
    return vectors * factor[:, None], int((length > longest).sum())


def _said(beyond: int) -> str:
    return f"; {beyond} longer, drawn shortened" if beyond else ""


def _counts(axes: Axes, found: CheckResult) -> None:
    sensor = found.camera.sensor
    bins = np.linspace(0, sensor.full_scale + 1, 129)
    for image, label, colour in ((found.white, "white image", ORANGE), (found.frame, written(found.name), BLUE)):
        if image is not None:
            axes.hist(image.ravel(), bins.tolist(), histtype="step", color=colour, label=label, log=True)
    axes.axvline(sensor.black_level, color=INK, linewidth=0.8, linestyle=":", label="black level")
    axes.axvline(sensor.full_scale, color=RED, linewidth=0.8, linestyle=":", label="full scale")
    axes.set(xlabel="counts", ylabel="pixels", title="exposure")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylim(0.5, 300 * axes.get_ylim()[1])  # room for the legend
    for text in axes.legend(frameon=False, fontsize=8, loc="upper center", ncols=2).get_texts():
        text.set_parse_math(False)


def _moves(axes: Axes, found: CheckResult) -> None:
    """Displacements in mm over x and y, depth as colour."""
    if found.motion is None or not len(found.motion.displacement_mm):
        return _nothing(axes, "no displacement was found")
    place, move = found.motion.place_mm, found.motion.displacement_mm
    usual = _usual(np.hypot(*move[:, :2].T)) or 1.0
    flat, beyond = _shortened(move[:, :2], usual)
    reach = max(float(np.ptp(place[:, 0])), float(np.ptp(place[:, 1])), 0.5)
    span = 0.25 * reach
    arrows = axes.quiver(
        place[:, 0], place[:, 1], flat[:, 0], flat[:, 1], move[:, 2],
        angles="xy", scale_units="xy", scale=usual / span, cmap="coolwarm", width=0.008,
    )  # fmt: skip
    deepest = _usual(np.abs(move[:, 2])) or 1.0
    arrows.set_clim(-deepest, deepest)
    key = float(f"{usual:.1g}")
    axes.set_title("estimated displacement", loc="left", pad=TITLE)
    x, y = place[:, 0].mean(), place[:, 1].mean()
    axes.set(xlim=(x - 0.8 * reach, x + 0.8 * reach), ylim=(y - 0.8 * reach, y + 0.8 * reach))
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    arrow_key(axes, x - 0.8 * reach, key / usual * span, f"{key:g} mm{_said(beyond)}")
    axes.figure.colorbar(arrows, ax=axes, label="along z (mm)", shrink=0.8, extend="both")
    return None


def _words(axes: Axes, found: CheckResult) -> None:
    """What was found, the worst first."""
    axes.set_axis_off()
    at, order = 1.0, list(COLOURS)
    for finding in sorted(found.findings, key=lambda f: order.index(f.severity)):
        lines = wrap(printable(finding.words), LETTERS)
        text = axes.text(0.0, at, "\n".join(lines), va="top", fontsize=7, transform=axes.transAxes, parse_math=False)
        text.set(color=COLOURS[finding.severity], in_layout=False)  # its length must not squeeze the panels
        at -= 0.036 * len(lines) + 0.02
