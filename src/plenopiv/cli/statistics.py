"""``plenopiv statistics``: mean, RMS, Reynolds stresses of a series, by phase too, with their uncertainty."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.cli.phases import phases_of
from plenopiv.cli.progress import Progress
from plenopiv.cli.replacing import refuse_to_replace
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.io.aside import written_aside
from plenopiv.io.series_statistics import BY_PHASE, STATISTICS, statistics_of, velocity_file, write_statistics
from plenopiv.statistics import summary_of
from plenopiv.statistics.correlated import STRETCHES
from plenopiv.statistics.moments import FEWEST
from plenopiv.statistics.variables import INTERVAL, NAMES

if TYPE_CHECKING:
    import xarray

MUCH = 0.01  # of the places, with correlation beyond the lags
CERTAIN = 30  # pairs, of which that is no chance: of 8, half of the places look so where fluctuations are smooth


def statistics(
    results: Path,
    phase: Path | None,
    bins: int | None,
    period: float | None,
    out: Path | None,
    lags: int | None,
    replaced: bool,
    overwrite: bool,
) -> Outcome:
    """Write the statistics of a series and, but for phase averages, the figure of their convergence.

    Raises:
        PlenoPIVError: fields or phases cannot be read; the file is there already, or is what is read.
    """
    target = out or velocity_file(results).with_name(BY_PHASE if phase else STATISTICS)
    if target.suffix.lower() != ".nc":
        raise PlenoPIVError(f"{target}: statistics are netCDF files; use a name that ends in .nc")
    figures = [] if phase else [target.with_suffix(kind) for kind in (".png", ".pdf")]
    sources = (velocity_file(results), *([phase] if phase else []))
    for path in (target, *figures):
        refuse_to_replace(path, sources, overwrite, "another name with --out")
    phases, parts = phases_of(phase, bins, period)
    options: dict[str, Any] = {"replaced": replaced} | ({} if lags is None else {"lags": lags})
    with Progress() as progress:
        found = statistics_of(results, phases, parts, progress, **options)
    found.attrs["source"] = str(velocity_file(results).name)
    write_statistics(target, found)
    if figures:
        _draw(found, figures)
    told = summary_of(found)
    if told["correlated_beyond_lags_share"] > MUCH:
        samples = told["median_samples"] or 0.0
        enough = samples >= STRETCHES * told["lags"]
        certain = samples >= CERTAIN
        outlasts, are = ("outlasts", "are") if certain else ("seems, perhaps by chance, to outlast", "may be")
        followed = told["lags"] if enough else "a third of the"
        more = "use a larger --lags" if enough else "more pairs are needed"
        warnings.warn(
            f"{target}: at {100 * told['correlated_beyond_lags_share']:.0f} % of the places the correlation in time "
            f"{outlasts} {followed} pairs, and error bars {are} too short there; {more}",
            PlenoPIVWarning,
            stacklevel=2,
        )
    if (few := _too_few(found)) is not None:
        words = f"{target}: {few}: fluctuations and their error bars take {FEWEST} or more, and are NaN or mean nothing"
        warnings.warn(words, PlenoPIVWarning, stacklevel=2)
    files = [str(path) for path in (target, *figures)]
    return Outcome("\n".join(_lines(told, found, files)), {"files": files, "statistics": told})


def _too_few(found: xarray.Dataset) -> str | None:
    """How many pairs count where they are too few, None where they are enough; of phases, in how many bins."""
    if "phase" not in found.dims:
        counted = int(found.attrs["pairs"] - found.attrs["pairs_left_out"])
        return None if counted >= FEWEST else f"{counted} pair{'s' * (counted != 1)}"
    counts = (found["pairs"] - found["pairs_left_out"]).values
    few = int((counts < FEWEST).sum())
    return f"{few} of {len(counts)} phases have fewer than {FEWEST} pairs" if few else None


def _draw(found: xarray.Dataset, figures: list[Path]) -> None:
    from plenopiv.report.convergence import convergence_figure
    from plenopiv.report.figures import Drawn

    figure = Drawn.of(convergence_figure(found), pdf=True)
    drawn = {".png": figure.png, ".pdf": figure.pdf}
    for path in figures:
        with written_aside(path) as aside:
            aside.write_bytes(drawn[path.suffix])


def _lines(told: dict[str, Any], found: xarray.Dataset, files: list[str]) -> list[str]:
    left = told["pairs_left_out"]
    lines = [
        f"pairs     {told['pairs']}" + (f", {left} of them left out: no vector counts" if left else ""),
        f"samples   {_text(told['median_samples'])} at a place (median), of {told['vectors_counted']} vectors",
    ]
    for k, name in enumerate(NAMES):
        place = told["largest_rms_at_mm"][k]
        if place is None:
            continue
        at = ", ".join(f"{value:.2f}" for value in place)
        noise = told["median_noise_share"][k]
        lines.append(
            f"{name}         RMS at most {told['largest_rms_m_s'][k]:.4g} m/s, at x, y, z = {at} mm; "
            f"{'random errors of vectors are not known apart' if noise is None else _of_noise(noise)}"
        )
        error, of_rms = told["median_mean_std_m_s"][k], told["median_rms_std_m_s"][k]
        if error is not None:
            independent = told["median_independent_samples"][k]
            rms = "" if of_rms is None else f", RMS +-{INTERVAL * of_rms:.2g}"
            lines.append(
                f"          95 %: mean +-{INTERVAL * error:.2g}{rms} m/s, from "
                f"{_text(independent)} independent samples (medians)"
            )
    if "phase" in found.dims:
        counts = ", ".join(f"{p:g}: {n}" for p, n in zip(found["phase"].values, found["pairs"].values, strict=True))
        lines.insert(1, f"phases    pairs at {counts}")
    return [*lines, *(f"written   {path}" for path in files)]


def _of_noise(share: float) -> str:
    """What part of the normal stress is random error of vectors; above 1 error bars are longer than the scatter."""
    if share > 1.0:
        return "the normal stress is no larger than random errors of vectors (median)"
    return f"{100 * share:.2g} % of the normal stress are random errors of vectors (median)"


def _text(value: float | None) -> str:
    return "no" if value is None else f"{value:.0f}"
