"""The figures of docs/reconstruction.md: errors by iteration, one panel for each question."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt

Row = dict[str, Any]
DEFAULT = "view-sequential, mu 0.3"
DIVERGES = "simultaneous as powers (SMART), mu 3"  # and is not drawn
INK = "#1f2933"
COLOURS = ("#1f6fb2", "#d9822b", "#2a9d5c", "#a23b72", "#7a5195", "#8a6d3b", "#5b6875")
MEASURES: dict[str, tuple[str, Callable[[Row], float]]] = {
    "depth": ("RMS along z, voxels", lambda row: row["error"][2]),
    "off focus": ("RMS along z off focus, voxels", lambda row: row["off_focus"][2]),
    "in-plane": ("RMS along x and y, voxels", lambda row: ((row["error"][0] ** 2 + row["error"][1] ** 2) / 2) ** 0.5),
    "residual": ("residual, counts", lambda row: row["residual"]),
    "Q": ("Q", lambda row: row["q"]),
}
SHORT = {
    "view-sequential, mu 0.3": "the default: sums, mu 0.3, random order",
    "view-sequential as powers, mu 0.3": "views, as powers",
    "pixel-sequential, views in order, mu 0.3": "pixels, view by view",
    "pixel-sequential, pixels shuffled, mu 0.3": "pixels, shuffled",
    "simultaneous as powers (SMART), mu 1": "SMART, mu 1",
    "simultaneous as sums (ML-EM), mu 1": "ML-EM",
}


def panel(axes, rows: list[Row], groups: tuple[str, ...], condition: str, measure: str) -> None:
    """One measure over work for the variants of ``groups``, the default in black."""
    label, value = MEASURES[measure]
    names = dict.fromkeys(row["name"] for row in rows if row["group"] in groups and row["condition"] == condition)
    others = [name for name in names if name != DEFAULT]
    for name, colour in [(DEFAULT, INK), *zip(others, COLOURS, strict=False)]:
        if name == DIVERGES:
            continue
        line = [r for r in rows if r["name"] == name and r["condition"] == condition and "error" in r and r["round"]]
        if line:
            axes.plot(
                [row["work"] for row in line],
                [value(row) for row in line],
                "o-",
                color=colour,
                ms=3.5,
                lw=2.0 if name == DEFAULT else 1.2,
                zorder=3 if name == DEFAULT else 2,
                label=SHORT.get(name, name),
            )
    axes.set(xscale="log", xlabel="iterations over all views", ylabel=label)
    axes.set_xticks([0.5, 1, 2, 3, 5, 10, 20], ["0.5", "1", "2", "3", "5", "10", "20"])
    axes.minorticks_off()
    if measure in ("depth", "off focus", "in-plane"):
        axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=7, frameon=False)


def draw(rows: list[Row], noise: dict[str, float], folder: Path) -> None:
    """convergence.png (algorithms, by four measures) and convergence-choices.png (one panel a choice)."""
    plt.rcParams.update({"font.size": 8.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(2, 2, figsize=(9.5, 6.4), layout="constrained")
    for at, measure in zip(axes.flat, ("residual", "Q", "in-plane", "depth"), strict=True):
        panel(at, rows, ("algorithm",), "pair", measure)
    axes[0, 0].axhline(noise["pair"], color=INK, lw=0.8, ls=":")
    axes[0, 0].text(1, noise["pair"] + 1.0, "noise of the pixels", fontsize=7)
    axes[0, 0].set_ylim(bottom=0.0)
    figure.savefig(folder / "convergence.png", dpi=100, facecolor="white")

    figure, axes = plt.subplots(2, 3, figsize=(12.5, 6.4), layout="constrained")
    panels = (
        ("relaxation, bright", ("relaxation",), "pair", "off focus"),
        ("relaxation, dim", ("relaxation",), "dim", "off focus"),
        ("algorithm, dim", ("algorithm",), "dim", "off focus"),
        ("order of the views", ("order",), "pair", "off focus"),
        ("start", ("start",), "pair", "off focus"),
        ("weights and pixels", ("weights", "pixels"), "pair", "off focus"),
    )
    for at, (title, *what) in zip(axes.flat, panels, strict=True):
        panel(at, rows, *what)
        at.set_title(title, loc="left", fontweight="bold")
    figure.savefig(folder / "convergence-choices.png", dpi=90, facecolor="white")
