"""Commands about a series of pairs, and their help; as in ``app``, bodies are imported when they are called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plenopiv.cli.app import Overwrite, _finish, app


@app.command()
def statistics(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A run's results folder, or its velocity.nc.")],
    phase: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Phase averages: lines of pair,phase; pairs from 0.")
    ] = None,
    bins: Annotated[int, typer.Option(metavar="N", min=1, help="Parts of the period, with --phase.")] = 8,
    period: Annotated[float, typer.Option(metavar="P", help="Period in the unit of the phases.")] = 360.0,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Default: beside velocity.nc.")] = None,
    lags: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Pairs over which correlation in time is followed.")
    ] = None,
    replaced: Annotated[bool, typer.Option("--replaced", help="Count replaced vectors too.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Mean, RMS, Reynolds stresses and skewness over all pairs, each with its uncertainty; by phase with --phase.

    Writes statistics.nc and the figure of convergence, statistics.png and .pdf, beside velocity.nc; phase averages into
    phase-statistics.nc. Bin k is centred on k/N of the period. A variable NAME_std is a standard deviation: a 95 %
    interval is 1.96 of them to either side.

    \b
    Example:
        plenopiv statistics run7/results
        plenopiv statistics run7/results --phase run7/encoder.csv --bins 12
    """
    from plenopiv.cli.statistics import statistics

    _finish("statistics", statistics(results, phase, bins, period, out, lags, replaced, overwrite))
