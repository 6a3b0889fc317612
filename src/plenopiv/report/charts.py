"""Line charts of a run: residuals by iteration, validation, stated uncertainty, errors by depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from plenopiv.accuracy.profile import DepthProfile
from plenopiv.report.figures import BLUE, COLOURS, GREEN, INK, ORANGE, STYLE, bar, faces, written
from plenopiv.velocity import replaced

if TYPE_CHECKING:
    import xarray

FRAMES = 6  # residuals of more are drawn without names
AXES = {"u": "x", "v": "y", "w": "z"}
DEPTH = "z (mm), toward the camera"
LABORATORY = "z (mm)"


@rc_context(STYLE)
def residual_figure(residuals: Mapping[str, Sequence[float]]) -> Figure:
    """RMS residual of the pixels at each iteration of MART, for each frame."""
    figure = Figure(figsize=(6.6, 3.3), layout="constrained")
    axes = figure.subplots()
    named = len(residuals) <= FRAMES
    for k, (name, values) in enumerate(residuals.items()):
        colour = (BLUE, ORANGE, GREEN, INK)[k % 4] if named else BLUE
        axes.plot(
            np.arange(1, len(values) + 1), values, "o-", markersize=3, color=colour, alpha=1.0 if named else 0.4,
            label=written(name) if named else None,
        )  # fmt: skip
    axes.set(title="residual by iteration", xlabel="iteration of MART", ylabel="RMS residual (counts)")
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if named and residuals:
        for text in axes.legend(frameon=False, fontsize=8).get_texts():
            text.set_parse_math(False)
    _open(axes)
    return figure


@rc_context(STYLE)
def series_figure(series: Mapping[str, Sequence[float]], numbered: bool = False) -> Figure:
    """Vectors replaced, ratio of peaks and largest velocity of each pair over its time (``run.written.series_of``), or
    its number, where times are ``numbered``: those of a double-frame camera's pairs are not known."""
    figure = Figure(figsize=(12.5, 3.2), layout="constrained")
    shown = (
        (100 * np.asarray(series["replaced_share"], float), "vectors replaced (%)"),
        (series["median_peak_ratio"], "median ratio of peaks"),
        (series["largest_velocity_m_s"], "largest velocity (m/s)"),
    )
    for axes, (values, words) in zip(figure.subplots(1, len(shown)), shown, strict=True):
        at = np.arange(1, len(series["time_s"]) + 1) if numbered else series["time_s"]
        axes.plot(at, values, ".-", color=BLUE, linewidth=0.8, markersize=4)
        axes.set(xlabel="pair" if numbered else "time (s)", ylabel=words)
        if numbered:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylim(bottom=0)
        _open(axes)
    return figure


@rc_context(STYLE)
def validation_figure(dataset: xarray.Dataset) -> Figure:
    """Where vectors were replaced, seen along z and along y, and by depth, of those outside a body; and how clear the
    peaks were by depth."""
    gone, known = (each.transpose("time", "z", "y", "x").values for each in (replaced(dataset), dataset["u"].notnull()))
    x, y, z = (dataset[axis].values for axis in "xyz")
    figure = Figure(figsize=(12.5, 3.8), layout=ConstrainedLayoutEngine(wspace=0.08))
    front, above, depth = figure.subplots(1, 3)

    def share(*axes: int) -> NDArray[np.float64]:
        """In %, summed along some of time, z, y, x; NaN where none is left."""
        with np.errstate(invalid="ignore"):
            return np.asarray(100.0 * gone.sum(axes) / known.sum(axes))

    images, by_depth = (share(0, 1), share(0, 2)), share(0, 2, 3)
    top = max(1.0, *(float(image.max(where=np.isfinite(image), initial=0.0)) for image in images))
    for axes, image, (h, v), labels, along in (
        (front, images[0], (x, y), ("x (mm)", "y (mm)"), "z"),
        (above, images[1], (x, z), ("x (mm)", "z (mm)"), "y"),
    ):
        extent = (*faces(h), *faces(v))
        picture = axes.imshow(
            image, cmap="magma_r", vmin=0, vmax=top, extent=extent, origin="lower", interpolation="nearest"
        )
        axes.set(title=f"replaced, mean along {along}", xlabel=labels[0], ylabel=labels[1])
        bar(picture, axes, "replaced (%)")
    depth.plot(z, by_depth, "o-", markersize=3, color=ORANGE)
    depth.set(title="by depth", xlabel=_depth_of(dataset))
    depth.set_ylabel("replaced (%)", color=ORANGE)
    depth.set_ylim(0, max(1.0, 1.1 * float(by_depth.max(where=np.isfinite(by_depth), initial=0.0))))
    if "peak_ratio" in dataset:
        ratio = depth.twinx()
        ratio.plot(z, _median_by_depth(dataset["peak_ratio"]), "s-", markersize=3, color=BLUE)
        ratio.set_ylabel("median peak ratio", color=BLUE)
        ratio.set_ylim(bottom=0)
        ratio.spines["top"].set_visible(False)
    depth.spines["top"].set_visible(False)
    return figure


@rc_context(STYLE)
def uncertainty_figure(dataset: xarray.Dataset) -> Figure:
    """Stated standard deviations of u, v, w: how they are spread, and by depth."""
    figure = Figure(figsize=(12.5, 3.3), layout="constrained")
    spread, depth = figure.subplots(1, 2)
    std = {name: dataset[f"{name}_std"] for name in COLOURS}
    finite = {name: values.values[np.isfinite(values.values)] for name, values in std.items()}
    top = max((float(np.percentile(values, 98)) for values in finite.values() if values.size), default=0.0) or 1.0
    for name, colour in COLOURS.items():
        if not finite[name].size:
            continue
        bins = np.linspace(0, top, 46).tolist()
        spread.hist(np.minimum(finite[name], top), bins, histtype="step", color=colour, label=name, linewidth=1.4)
        depth.plot(dataset["z"].values, _median_by_depth(std[name]), "o-", markersize=3, color=colour, label=name)
    spread.set(title="stated standard deviation", xlabel="m/s (the largest 2 % at the right end)", ylabel="vectors")
    depth.set(title="median by depth", xlabel=_depth_of(dataset), ylabel="standard deviation (m/s)")
    depth.set_ylim(bottom=0)
    for axes in (spread, depth):
        _open(axes)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False, ncols=3)
    return figure


@rc_context(STYLE)
def accuracy_figure(profile: DepthProfile, dataset: xarray.Dataset) -> Figure:
    """RMS error and bias of a field along x, y, z by depth."""
    figure = Figure(figsize=(12.5, 3.3), layout="constrained")
    rms, bias = figure.subplots(1, 2)
    for k, (name, colour) in enumerate(COLOURS.items()):
        label = f"along {AXES[name]}"
        rms.plot(profile.z_mm, profile.rms[k], "o-", markersize=3, color=colour, label=label)
        bias.plot(profile.z_mm, profile.bias[k], "o-", markersize=3, color=colour, label=label)
    rms.set(title="RMS error by depth", xlabel=_depth_of(dataset), ylabel="voxels per frame")
    rms.set_ylim(bottom=0)
    bias.axhline(0, color="#8794a1", linewidth=0.8, linestyle=":")
    bias.set(title="mean error by depth", xlabel=_depth_of(dataset), ylabel="voxels per frame")
    for axes in (rms, bias):
        _open(axes)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.2 * (high - low))  # room for the legend
        axes.legend(frameon=False, ncols=3, loc="upper center")
    return figure


def _depth_of(dataset: xarray.Dataset) -> str:
    """What a field's z is."""
    return LABORATORY if dataset.attrs.get("frame") == "laboratory" else DEPTH


def _median_by_depth(values: xarray.DataArray) -> NDArray[np.float64]:
    planes = values.transpose("z", ...).values.reshape(values.sizes["z"], -1)
    return np.array([float(np.median(p[np.isfinite(p)])) if np.isfinite(p).any() else np.nan for p in planes])


def _open(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
