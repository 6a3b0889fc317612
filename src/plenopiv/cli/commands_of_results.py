"""Commands on what runs have left: more of ``cli.app``, which they join when ``plenopiv.cli`` is imported."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from plenopiv.cli.app import Overwrite, _finish, app
from plenopiv.cli.options import Bins, Device, Period


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A results folder, or its velocity.nc.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The page to write; default: compare.html beside A.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Two results side by side: how far their vectors differ, and in which settings.

    Differences B - A are in m/s, in voxels of A, and in standard deviations as both results state them, by component
    and thirds of the depth. Pairs are matched by their time; where the vectors lie elsewhere, B is interpolated
    linearly at A's. A page with slices and histograms is written.

    \b
    Example:
        plenopiv compare run7/results run7/results-wide
        plenopiv compare monday/velocity.nc tuesday/velocity.nc --out days.html
    """
    from plenopiv.cli.compare import compare

    _finish("compare", compare(a, b, out, overwrite))


@app.command()
def correlate(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A run's results folder, with volumes.")],
    windows: Annotated[
        str | None, typer.Option(metavar="SIZES", help="Voxels along x, y, z, coarse to fine: 64x64x16,48x48x12.")
    ] = None,
    overlap: Annotated[float | None, typer.Option(metavar="SHARE", help="Of neighbouring windows: 0 to 0.9.")] = None,
    inner_window: Annotated[
        str | None, typer.Option(metavar="SIZE", help="Sub-windows; the last window's size for none.")
    ] = None,
    coarse_passes: Annotated[int | None, typer.Option(metavar="N", help="Passes with each coarse window.")] = None,
    fine_passes: Annotated[int | None, typer.Option(metavar="N", help="Passes with the finest window.")] = None,
    ensemble: Annotated[
        bool, typer.Option("--ensemble", help="Sum the correlations of all pairs: one field of a steady flow.")
    ] = False,
    phase: Annotated[
        Path | None, typer.Option(metavar="CSV", help="With --ensemble a field a phase: lines of pair,phase.")
    ] = None,
    bins: Bins = None,
    period: Period = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Results folder; default: beside RESULTS, named by the windows.")
    ] = None,
    overwrite: Overwrite = False,
    device: Device = None,
) -> None:
    """Measure again with other windows, from the volumes that a run kept: nothing is reconstructed.

    The run must have had output.volumes = true in its experiment file. The vectors are those of a whole run with these
    windows, bit for bit; the results are a folder of its own, and RESULTS is not touched. Options that are left out
    are as in the run, and sub-windows follow the last window. Finished pairs are kept, whatever ends it.

    With --ensemble correlations are summed over pairs before their peaks are looked for, for thin seeding in a steady
    or phase-locked flow: velocity.nc then has one time, or one for each phase, and in pairs how many they were.

    \b
    Example:
        plenopiv correlate run7/results --windows 96x96x32,48x48x16
        plenopiv compare run7/results run7/results-96x96x32-48x48x16
        plenopiv correlate run7/results --windows 64x64x16 --overlap 0.75 --out run7/finer
        plenopiv correlate run7/results --ensemble --phase run7/encoder.csv --bins 12
    """
    from plenopiv.cli.correlate import Together, correlate

    together = Together(ensemble, phase, bins, period)
    numbers = {"overlap": overlap, "coarse_passes": coarse_passes, "fine_passes": fine_passes}
    _finish("correlate", correlate(results, windows, inner_window, out, overwrite, together, device, **numbers))


@app.command()
def statistics(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A run's results folder, or its velocity.nc.")],
    phase: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Phase averages: lines of pair,phase; pairs from 0.")
    ] = None,
    bins: Bins = None,
    period: Period = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Default: beside velocity.nc.")] = None,
    lags: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Pairs over which correlation in time is followed; 16, phases 4."),
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


@app.command()
def export(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Results folder or velocity.nc, tracks.nc, or a kept volume (.h5).")
    ],
    target: Annotated[
        Path, typer.Argument(metavar="TARGET", help="What to write: .vtkhdf, .vti, .csv, .mat, .txt or .nc.")
    ],
    z: Annotated[float | None, typer.Option(metavar="MM", help="The plane of vectors, for .txt and .nc.")] = None,
    time: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Which of several times, from 0, for .txt and .vti.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a velocity field as other programs read it; the ending of TARGET names the format.

    \b
        .vtkhdf  ParaView, PyVista: all vectors and times, tracks, or every voxel of a volume
        .vti     the same and older ParaView: all vectors of one time (--time)
        .csv     pandas, R, spreadsheets: one vector a line, units in the names of columns
        .mat     MATLAB, Octave: arrays (y, x, z, time), as meshgrid has them
        .txt     OpenPIV: the plane nearest to --z of one time, with flags for replaced vectors
        .nc      pivpy: the plane nearest to --z at all times, chc 1 where measured

    Coordinates are in mm, velocities in m/s; y and v point upward, in a .txt file too (OpenPIV's physical frame).
    velocity.nc itself is plain netCDF, for xarray and napari as it is.

    \b
    Example:
        plenopiv export run7/results/velocity.nc run7/velocity.vtkhdf
        plenopiv export run7/results/velocity.nc run7/vectors.csv
        plenopiv export run7/results/velocity.nc run7/plane.txt --z 1.5
        plenopiv export run7/results/volume-a.h5 run7/volume-a.vtkhdf
    """
    from plenopiv.cli.export import export

    _finish("export", export(source, target, z, time, overwrite))
