"""A few numbers of the statistics, as summary.json and the terminal have them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.statistics.variables import NAMES

if TYPE_CHECKING:
    import xarray as xr


def summary_of(statistics: xr.Dataset) -> dict[str, Any]:
    """What ``summary.json`` holds of a ``SeriesStatistics.result`` or ``PhaseStatistics.result``: numbers, lists by
    component u, v, w, and None where nothing is known.

    ``largest_rms_m_s``, and where (``at_mm``: x, y, z); medians over the places of: samples, independent samples of the
    mean, standard deviations of the mean and of the RMS fluctuation, the share of <std^2> in the normal stress;
    ``correlated_beyond_lags_share``: of the places where error bars are too short, because the correlation in time
    outlasts the pairs over which it is followed.
    """
    largest: list[float | None] = []
    where: list[list[float] | None] = []
    for name in NAMES:
        rms = statistics[f"{name}_rms"]
        top = _number(rms.max())
        largest.append(top)
        if top is None:
            where.append(None)
        else:
            at = dict(zip(rms.dims, np.unravel_index(int(np.nanargmax(rms.values)), rms.shape), strict=True))
            where.append([float(statistics[axis].values[at[axis]]) for axis in "xyz"])
    return {
        "pairs": int(statistics.attrs["pairs"]),
        "pairs_left_out": int(statistics.attrs["pairs_left_out"]),
        "vectors_counted": str(statistics.attrs["vectors_counted"]),
        "median_samples": _median(np.where(statistics["samples"].values > 0, statistics["samples"].values, np.nan)),
        "median_independent_samples": [_median(statistics[f"{n}_independent_samples"].values) for n in NAMES],
        "largest_rms_m_s": largest,
        "largest_rms_at_mm": where,
        "median_mean_std_m_s": [_median(statistics[f"{n}_mean_std"].values) for n in NAMES],
        "median_rms_std_m_s": [_median(statistics[f"{n}_rms_std"].values) for n in NAMES],
        "median_noise_share": [_median(_ratio(statistics, n)) for n in NAMES],
        "lags": int(statistics.attrs["lags"]),
        "correlated_beyond_lags_share": round(float(statistics.attrs["correlated_beyond_lags_share"]), 4),
    }


def _ratio(statistics: xr.Dataset, name: str) -> NDArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return (statistics[f"{name * 2}_noise"] / statistics[name * 2]).values


def _median(values: NDArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(float(value)) else None
