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
def series_figure(series: Mapping[str, Sequence[float]]) -> Figure:
    """Vectors replaced, ratio of peaks and largest velocity of each pair over its time (``run.written.series_of``)."""
    figure = Figure(figsize=(12.5, 3.2), layout="constrained")
    shown = (
        (100 * np.asarray(series["replaced_share"], float), "vectors replaced (%)"),
        (series["median_peak_ratio"], "median ratio of peaks"),
        (series["largest_velocity_m_s"], "largest velocity (m/s)"),
    )
    for axes, (values, words) in zip(figure.subplots(1, len(shown)), shown, strict=True):
        axes.plot(series["time_s"], values, ".-", color=BLUE, linewidth=0.8, markersize=4)
        axes.set(xlabel="time (s)", ylabel=words)
        axes.set_ylim(bottom=0)
        _open(axes)
    return figure


@rc_context(STYLE)
def validation_figure(dataset: xarray.Dataset) -> Figure:
    """Where vectors were replaced, seen along z and along y, and by depth; and how clear the peaks were by depth."""
    gone = replaced(dataset).transpose("time", "z", "y", "x").values
    x, y, z = (dataset[axis].values for axis in "xyz")
    figure = Figure(figsize=(12.5, 3.8), layout=ConstrainedLayoutEngine(wspace=0.08))
    front, above, depth = figure.subplots(1, 3)
    share = 100 * gone.mean(0)
    top = max(float(max(share.mean(0).max(), share.mean(1).max())), 1.0)
    for axes, image, (h, v), labels, along in (
        (front, share.mean(0), (x, y), ("x (mm)", "y (mm)"), "z"),
        (above, share.mean(1), (x, z), ("x (mm)", "z (mm)"), "y"),
    ):
        extent = (*faces(h), *faces(v))
        picture = axes.imshow(
            image, cmap="magma_r", vmin=0, vmax=top, extent=extent, origin="lower", interpolation="nearest"
        )
        axes.set(title=f"replaced, mean along {along}", xlabel=labels[0], ylabel=labels[1])
        bar(picture, axes, "replaced (%)")
    depth.plot(z, share.mean((1, 2)), "o-", markersize=3, color=ORANGE)
    depth.set(title="by depth", xlabel=_depth_of(dataset))
    depth.set_ylabel("replaced (%)", color=ORANGE)
    depth.set_ylim(0, max(1.0, 1.1 * float(share.mean((1, 2)).max())))
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
def accuracy_figure(profile: DepthProfile) -> Figure:
    """RMS error and bias along x, y, z by depth."""
    figure = Figure(figsize=(12.5, 3.3), layout="constrained")
    rms, bias = figure.subplots(1, 2)
    for k, (name, colour) in enumerate(COLOURS.items()):
        label = f"along {AXES[name]}"
        rms.plot(profile.z_mm, profile.rms[k], "o-", markersize=3, color=colour, label=label)
        bias.plot(profile.z_mm, profile.bias[k], "o-", markersize=3, color=colour, label=label)
    rms.set(title="RMS error by depth", xlabel=DEPTH, ylabel="voxels per frame")
    rms.set_ylim(bottom=0)
    bias.axhline(0, color="#8794a1", linewidth=0.8, linestyle=":")
    bias.set(title="mean error by depth", xlabel=DEPTH, ylabel="voxels per frame")
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
