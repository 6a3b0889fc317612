"""What density costs: the cases of particles.json from .1 to 4 ppm, drawn into docs/images/tracking-density.png."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "tracking-density.png"
DENSITIES = {"0.1 ppm": 0.1, "0.25 ppm": 0.25, "0.5 ppm": 0.5, "base": 1.0, "2 ppm": 2.0, "4 ppm": 4.0}
COLOURS = dict(zip("xyz", ("tab:blue", "tab:cyan", "tab:red"), strict=True))


def draw(record: Mapping[str, Any], path: Path = PICTURE) -> None:
    """Found and ghosts, RMS and median errors, error over bound and time a particle, against particles per microlens;
    beyond 1.5 half dead zones."""
    cases = {name: ppm for name, ppm in DENSITIES.items() if name in record}
    ppm, beyond = list(cases.values()), [record[name]["beyond"] for name in cases]
    figure = Figure((10.0, 6.4), layout="constrained")
    (found, error), (bound, cost) = figure.subplots(2, 2, sharex=True)
    found.plot(ppm, [100 * one["found"] for one in beyond], "o-", color="black", label="found")
    found.plot(ppm, [100 * one["ghosts"] for one in beyond], "s--", color="grey", label="ghosts")
    found.set(ylabel="%", ylim=(-3, 103))
    for axis, (name, colour) in enumerate(COLOURS.items()):
        error.plot(ppm, [one["rms"][axis] for one in beyond], "o-", color=colour, label=f"{name}, RMS")
        error.plot(ppm, [one["median"][axis] for one in beyond], "o:", color=colour, label=f"{name}, median")
        bound.plot(ppm, [one["median_over_bound"][axis] for one in beyond], "o-", color=colour, label=name)
    error.set(ylabel="error, voxel", yscale="log", ylim=(None, 0.3))
    bound.axhline(0.6745, color="black", linewidth=0.8, linestyle="--", label="normal error at the bound")
    bound.set(ylabel="median |error| / Cramér-Rao bound", ylim=(0, 1))
    cost.plot(ppm, [record[name]["ms_per_particle"] for name in cases], "o-", color="black", label="of one core")
    cost.set(ylabel="ms a particle", ylim=(0, None))
    for panel in (found, error, bound, cost):
        panel.set_xscale("log")
        panel.set_xticks(ppm, [f"{one:g}" for one in ppm], minor=False)
        panel.minorticks_off()
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8, loc="upper left" if panel is error else "best", ncols=2 if panel is error else 1)
    for panel in (bound, cost):
        panel.set_xlabel("particles per microlens")
    figure.savefig(path, dpi=100, facecolor="white")
