"""The figure of a camera's design: resolution, field and expected errors by depth, and what would change."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plenopiv.design.sheet import Design, Optics
from plenopiv.design.twin import Twin
from plenopiv.report.figures import BLUE, GREEN, INK, ORANGE, STYLE

UM = 1e3


@rc_context(STYLE)
def design_figure(found: Design) -> Figure:
    """Four panels: distance until another pixel is lit, field, errors by depth, and errors against density."""
    figure = Figure(figsize=(11.0, 7.4), layout="constrained")
    (distance, field), (errors, seeding) = figure.subplots(2, 2)
    _distances(distance, found.optics)
    _field(field, found.optics)
    if found.best is None:
        for axes in (errors, seeding):
            axes.set_axis_off()
            axes.text(0.5, 0.5, "no twin was simulated", ha="center", transform=axes.transAxes, color=INK)
    else:
        _errors(errors, found.best)
        _densities(seeding, found.twins, found.best)
    for axes in (distance, field, errors, seeding):
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _shade(axes: Axes, optics: Optics) -> None:
    axes.axvspan(*optics.dead_zone_mm, color="#dde2e7", zorder=0, label="dead zone")
    axes.set_xlabel("z (mm), toward the camera")


def _distances(axes: Axes, optics: Optics) -> None:
    z = [d.z_mm for d in optics.depths]
    _shade(axes, optics)
    for label, colour, mean, largest in (
        ("across", BLUE, [d.across_mm for d in optics.depths], [d.across_largest_mm for d in optics.depths]),
        ("in depth", ORANGE, [d.in_depth_mm for d in optics.depths], [d.in_depth_largest_mm for d in optics.depths]),
    ):
        axes.plot(z, UM * np.array(mean), color=colour, label=f"{label}, mean")
        axes.plot(z, UM * np.array(largest), color=colour, linestyle=":", label=f"{label}, at most")
    axes.set(yscale="log", ylabel="um", title="distance that a point moves until another pixel is lit")
    low, high = axes.get_ylim()
    axes.set_ylim(low, 8 * high)  # room for the legend
    axes.legend(frameon=False, ncols=3, fontsize=8, loc="upper center")


def _field(axes: Axes, optics: Optics) -> None:
    z = [d.z_mm for d in optics.depths]
    _shade(axes, optics)
    for label, colour, dashes, side in (("x", BLUE, "-", 0), ("y", ORANGE, "--", 1)):
        size = [max(d.field_mm[side], 0) for d in optics.depths]
        axes.plot(z, size, color=colour, linestyle=dashes, label=f"along {label}")
    axes.set(ylabel="mm", title="field that every view sees")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)


def _errors(axes: Axes, twin: Twin) -> None:
    z = [p.z_mm for p in twin.planes]
    axes.axvspan(*twin.camera.dead_zone_mm(), color="#dde2e7", zorder=0, label="dead zone")
    for axis, (label, colour) in enumerate((("x", BLUE), ("y", ORANGE), ("z", GREEN))):
        axes.plot(z, [p.rms[axis] for p in twin.planes], "o-", markersize=3, color=colour, label=f"along {label}")
    axes.set(
        xlabel="z (mm), toward the camera",
        ylabel="RMS error (voxel)",
        title=f"expected error of displacements at {twin.particles_per_microlens:g} ppm",
    )
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)


def _densities(axes: Axes, twins: tuple[Twin, ...], best: Twin) -> None:
    twins = tuple(sorted(twins, key=lambda t: t.particles_per_microlens))
    density = [t.particles_per_microlens for t in twins]
    for axis, (label, colour) in enumerate((("x", BLUE), ("y", ORANGE), ("z", GREEN))):
        axes.plot(density, [t.errors.rms[axis] for t in twins], "o-", color=colour, label=f"along {label}")
    axes.axvline(best.particles_per_microlens, color=INK, linestyle=":", linewidth=0.8, label="least error")
    axes.set(
        xlabel="particles per microlens (ppm)", ylabel="RMS error (voxel)", title="error and seeding", xscale="log"
    )
    axes.set_xticks(density, [f"{d:g}" for d in density])
    axes.minorticks_off()
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)
