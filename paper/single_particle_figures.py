"""The figures of single_particles.py: centres, Q, and what Q depends on, all over depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plenopiv.report.figures import BLUE, GREEN, INK, ORANGE, STYLE

Row = dict[str, Any]
LOOKS = {
    "mart": ("MART", ORANGE, "o"),
    "bound": ("DRT-MART", BLUE, "s"),
    "product": ("DRT-MART, paper's product", GREEN, "^"),
}
ERROR_UM = 25.0  # shown; a third of a voxel. The dead zone has more
EXACT_NAMES = {"gauss": "Gaussian, 3 voxels", "point": "a point", "wide": "Gaussian, 51 um wide"}


def over_depth(rows: list[Row], series: str, method: str, value) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depths, and mean and standard deviation over a series' places of what ``value`` takes from a row."""
    of_series = [r for r in rows if r["series"] == series and r["method"] == method]
    depths = np.array(sorted({r["at_mm"][2] for r in of_series}))
    each = [np.array([value(r) for r in of_series if r["at_mm"][2] == z]) for z in depths]
    return depths, np.array([e.mean() for e in each]), np.array([e.std() for e in each])


def lines(axes: Axes, results: Row, series: str, value, methods=tuple(LOOKS)) -> None:
    """One line a method, a band of one standard deviation where there are several places, the dead zone in grey."""
    for method in methods:
        name, colour, marker = LOOKS[method]
        depths, mean, scatter = over_depth(results["rows"], series, method, value)
        size, fill = (6, "none") if method == "mart" else (3, "full")  # the others lie on it
        axes.plot(depths, mean, marker + "-", color=colour, ms=size, fillstyle=fill, lw=1, label=name)
        if scatter.any():
            axes.fill_between(depths, mean - scatter, mean + scatter, color=colour, alpha=0.15, lw=0)
    zone(axes, results)


def zone(axes: Axes, results: Row) -> None:
    """The dead zone in grey, and the depths along the bottom."""
    axes.axvspan(*results["dead_zone_mm"], color="#8794a1", alpha=0.18, lw=0)
    axes.set_xlabel("particle's depth z (mm)")
    axes.spines[["top", "right"]].set_visible(False)


@rc_context(STYLE)
def centres_and_quality(results: Row) -> Figure:
    """Fig. 9a and b, on the axis, and the same over a microlens; between them the centre's error."""
    figure = Figure(figsize=(10.5, 9.2), layout="constrained")
    panels = figure.subplots(3, 2)
    for across, (series, name) in enumerate((("axis", "on the axis"), ("spread", "over a microlens: mean, scatter"))):
        centre, error, quality = panels[:, across]
        depths = over_depth(results["rows"], series, "mart", lambda r: 0.0)[0]
        centre.plot(depths, depths, color=INK, lw=0.8, label="true")
        lines(centre, results, series, lambda r: r["at_mm"][2] + r["off_mm"]["whole"][2])
        centre.set(title=f"centre, {name}", ylabel="reconstructed centre z (mm)")
        error.axhline(0.0, color=INK, lw=0.8)
        lines(error, results, series, lambda r: 1e3 * r["off_mm"]["whole"][2])
        error.set(title=f"its error, {name}", ylabel="error of the centre along z (um)", ylim=(-ERROR_UM, ERROR_UM))
        lines(quality, results, series, lambda r: r["q"]["gauss"])
        quality.set(title=f"quality, {name}", ylabel="Q (exact: Gaussian of 3 voxels)", ylim=(0, 1))
    panels[0, 0].legend(frameon=False)
    return figure


@rc_context(STYLE)
def what_quality_depends_on(results: Row) -> Figure:
    """Q by the exact volume, with noise, and by the weights; candidates."""
    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    (exact, noisy), (weights, left) = figure.subplots(2, 2)
    for (name, label), style in zip(EXACT_NAMES.items(), ("-", "--", ":"), strict=True):
        for method in ("mart", "bound"):
            depths, mean, _ = over_depth(results["rows"], "spread", method, lambda r, n=name: r["q"][n])
            who, colour, _ = LOOKS[method]
            exact.plot(depths, mean, style, color=colour, lw=1.2, label=f"{who}; {label}")
    zone(exact, results)
    exact.set(title="by the exact volume, over a microlens", ylabel="Q")
    exact.legend(frameon=False, fontsize=7, ncols=2, loc="upper center")
    lines(noisy, results, "noisy", lambda r: r["q"]["gauss"])
    noisy.set(title="images with noise, over a microlens", ylabel="Q (exact: Gaussian of 3 voxels)", ylim=(0, 1))
    noisy.legend(frameon=False, fontsize=7)
    for series, method, label, colour in (
        ("axis", "bound", "plane maps (default)", BLUE),
        ("areas", "bound", "areas voxel by voxel", INK),
        ("nine rays", "product", "nine rays a pixel, paper's product", GREEN),
    ):
        depths, mean, _ = over_depth(results["rows"], series, method, lambda r: r["q"]["gauss"])
        weights.plot(depths, mean, ".-", lw=1, ms=4, color=colour, label=label)
        depths, mean, _ = over_depth(results["rows"], series, method, lambda r: r["started"])
        left.semilogy(depths, mean, ".-", lw=1, ms=4, color=colour, label=label)
    for axes in (weights, left):
        zone(axes, results)
        axes.axvline(-1.078, color=INK, lw=0.7, ls=":")
    weights.set(title="DRT-MART by its weights, on the axis", ylabel="Q (exact: Gaussian of 3 voxels)")
    weights.legend(frameon=False, fontsize=7, loc="upper center")
    for axes in (exact, weights):
        axes.set(ylim=(0, 1.35), yticks=np.linspace(0, 1, 6))  # legends above the curves
    left.set(title="candidate voxels, on the axis", ylabel="voxels")
    return figure


def draw(results: Row, folder: Path) -> None:
    """single-particles.png and single-particles-quality.png."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in (
        ("single-particles", centres_and_quality(results)),
        ("single-particles-quality", what_quality_depends_on(results)),
    ):
        figure.savefig(folder / f"{name}.png", dpi=85, facecolor="white")
