"""The figure of a series: running mean and RMS at a few places, with their 95 % bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from plenopiv.report.figures import BLUE, GREEN, INK, ORANGE, STYLE
from plenopiv.statistics.variables import INTERVAL

if TYPE_CHECKING:
    import xarray

PURPLE = "#7d4fa3"
ROWS = {"running_mean": "mean", "running_rms": "RMS fluctuation"}


@rc_context(STYLE)
def convergence_figure(statistics: xarray.Dataset) -> Figure:
    """Mean and RMS fluctuation of u, v, w against the number of pairs at each place of ``SeriesStatistics``' result;
    bands are 95 % intervals."""
    figure = Figure(figsize=(12.5, 6.2), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    pairs = statistics["running_pairs"].values
    names = [
        ", ".join(f"{float(statistics[f'place_{axis}'][k]):.3g}" for axis in "xyz") + " mm"
        for k in range(statistics.sizes["place"])
    ]
    for row, (variable, text) in zip(panels, ROWS.items(), strict=True):
        for axes, component in zip(row, "uvw", strict=True):
            values = statistics[variable].sel(component=component).values  # (running, place)
            reach = INTERVAL * statistics[f"{variable}_std"].sel(component=component).values
            for k, (name, colour) in enumerate(zip(names, (BLUE, ORANGE, GREEN, INK, PURPLE), strict=False)):
                axes.plot(pairs, values[:, k], color=colour, linewidth=1.3, label=name)
                axes.fill_between(
                    pairs, values[:, k] - reach[:, k], values[:, k] + reach[:, k], color=colour, alpha=0.12, linewidth=0
                )
            axes.set(title=f"{text} of {component}", ylabel="m/s")
            settled = len(pairs) // 8  # the first bands are wide: the axis shows those after an eighth of the pairs
            shown = np.concatenate([(values - reach)[settled:], (values + reach)[settled:]])
            shown = shown[np.isfinite(shown)]
            if shown.size and np.ptp(shown) > 0:
                margin = 0.05 * np.ptp(shown)
                axes.set_ylim(shown.min() - margin, shown.max() + margin)
            axes.spines[["top", "right"]].set_visible(False)
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in panels[1]:
        axes.set_xlabel("number of pairs")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, title="x, y, z; bands: 95 %")
    return figure
