"""Statistics of a series of velocity fields, one field after the other; memory does not depend on their number.

Sampling uncertainty of a mean product of fluctuations: the standard deviation of n independent samples of the product
about its mean, over sqrt(n) (Benedict & Gould 1996, Towards better uncertainty estimates for turbulence statistics,
Exp. Fluids 22, 129-136), with the number of independent samples n/T in place of n (``correlated``). In a Gaussian
process that is T u^2/n for a mean, 2 T u^4/n for a variance, T (1 + r^2) u^2 v^2/n for a covariance and 6 T/n for
skewness; here the moments of the samples themselves are used, up to the sixth.

Measurement uncertainty: random errors of vectors are part of their scatter, and so of every sampling uncertainty. The
share of the mean's that is theirs is sqrt(<std^2>/n); they raise normal stresses by <std^2>, which is stated beside
them and taken off in ``*_corrected`` (Sciacchitano & Wieneke 2016, PIV uncertainty propagation, Meas. Sci. Technol. 27
084006). Not of fields of tracks: their std is flow that is not resolved, for the most part, which is missing from
stresses rather than added to them. Errors of different components are taken as independent: shear stresses are not
corrected.

Standard deviations are one sigma: a 95 % interval is +- 1.96 of them, where n/T is some tens or more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.statistics.convergence import Convergence
from plenopiv.statistics.correlated import Spacing, TimeCorrelation
from plenopiv.statistics.moments import FEWEST, PAIRS, Moments
from plenopiv.statistics.variables import DIMS, NAMES, dataset
from plenopiv.velocity import of_tracks

if TYPE_CHECKING:
    import xarray as xr

LAGS = 16  # pairs over which the correlation in time is followed
ERROR_BARS = 0.2  # relative error of the vectors' standard deviations (docs/uncertainty.md), for what is taken off


class SeriesStatistics:
    """Mean, RMS, Reynolds stresses and skewness of fields on one grid, each with its uncertainty.

        statistics = SeriesStatistics(first)
        for field in fields:  # the first one too
            statistics.add(field)
        found = statistics.result()

    ``like``: a field of the series, as ``velocity.velocity_dataset`` makes it, of one time or none. ``lags``: number of
    following fields over which the correlation in time is followed; a vector takes 1.2 kB at 16 of them, 3.2 kB in
    ``result``. ``replaced``: whether replaced vectors count too. Without, a vector counts where ``valid`` is 1; NaN
    never does.
    ``error_bars``: relative standard error of the vectors' stated standard deviations.

    The same fields in the same order give the same bits.
    """

    def __init__(
        self, like: xr.Dataset, *, lags: int = LAGS, replaced: bool = False, error_bars: float = ERROR_BARS
    ) -> None:
        if lags < 0:
            raise PlenoPIVError(f"statistics: lags = {lags} is no number of fields; use 0 or more")
        one = _of_one_time(like)
        self.coordinates = {axis: one[axis] for axis in DIMS}
        self.replaced, self.error_bars = replaced, error_bars
        self.fields = self.left_out = 0
        shape = tuple(one.sizes[axis] for axis in DIMS)
        self.moments, self.time = Moments(shape), TimeCorrelation(shape, lags)
        self.convergence = Convergence(self.coordinates)
        self.noise_known = not of_tracks(like)
        self._noise, self._told = np.zeros((3, *shape)), np.zeros((3, *shape), np.int32)

    def add(self, field: xr.Dataset) -> None:
        """The next field in time. One without a vector that counts (a pair set aside) is left out, but is a step in
        time.

        Raises:
            PlenoPIVError: it lies on another grid than the first.
        """
        one = _of_one_time(field)
        for axis in DIMS:
            if not np.array_equal(one[axis].values, self.coordinates[axis].values):
                raise PlenoPIVError(f"statistics: a field has other coordinates {axis} than the first of its series")
        values = np.stack([one[name].values for name in NAMES]).astype(float)
        counted = np.isfinite(values).all(0)
        if not self.replaced:
            counted &= one["valid"].values == 1
        elif "inside_body" in one:
            counted &= one["inside_body"].values != 1
        self.fields += 1
        self.left_out += not counted.any()
        std = np.stack([one[f"{name}_std"].values for name in NAMES]).astype(float)
        told = counted & np.isfinite(std)
        self._noise += np.where(told, std, 0.0) ** 2
        self._told += told
        self.moments.add(values, counted)
        self.time.add(values, counted)
        if counted.any():
            self.convergence.add(self.fields - self.left_out, self.moments)

    def result(self) -> xr.Dataset:
        """Statistics of the fields so far, on (z, y, x).

        Velocities in m/s, stresses in m^2/s^2: u_mean, u_rms, uu, uv, ..., u_skewness and the rest, each with ``_std``,
        the standard deviation of its error; all variables with their meaning in ``long_name``. NaN where fewer than
        two vectors count; of RMS, stresses and skewness ``_std`` takes three.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            return self._result()

    def _result(self) -> xr.Dataset:
        moments, n = self.moments, self.moments.count
        few = n < 2
        spacing = self.time.spacing(n)
        found: dict[str, NDArray] = {"samples": n.astype(np.int32)}
        for c, name in enumerate(NAMES):
            variance, noise = moments.covariance(c, c), self._noise[c] / self._told[c]
            if not self.noise_known:
                noise = np.full_like(noise, np.nan)
            of_variance = _std_of_mean_product(moments, spacing, c, c)
            found[f"{name}_mean"] = np.where(n > 0, moments.mean[c], np.nan)
            left = np.maximum(n - spacing(c), 0.25 * n)  # (n - 1)/(n - T): deviations from the mean are too small
            found[f"{name}_mean_std"] = np.sqrt(variance * (n - 1) / left * spacing(c) / n)
            found[f"{name}_mean_std_measurement"] = np.sqrt(noise / n)
            found[f"{name}_rms"] = np.sqrt(variance)
            found[f"{name}_rms_std"] = _std_of_root(variance, of_variance)
            found[name * 2], found[f"{name * 2}_std"] = variance, of_variance
            found[f"{name * 2}_noise"] = np.where(few, np.nan, noise)
            corrected = variance - noise
            of_corrected = np.hypot(of_variance, 2 * self.error_bars * noise)
            found[f"{name * 2}_corrected"], found[f"{name * 2}_corrected_std"] = corrected, of_corrected
            found[f"{name}_rms_corrected"] = np.sqrt(corrected.clip(0))
            found[f"{name}_rms_corrected_std"] = _std_of_root(corrected, of_corrected)
            found[f"{name}_skewness"], found[f"{name}_skewness_std"] = _skewness(moments, spacing, c)
            found[f"{name}_independent_samples"] = n / spacing(c)
        for a, b in PAIRS:
            name = NAMES[a] + NAMES[b]
            found[name] = moments.covariance(a, b)
            found[f"{name}_std"] = _std_of_mean_product(moments, spacing, a, b)
        still = spacing.longer_than_lags() & ~few
        return dataset(
            found,
            self.coordinates,
            self.convergence.variables(spacing),
            {
                "pairs": self.fields,
                "pairs_left_out": self.left_out,
                "lags": self.time.lags,
                "correlated_beyond_lags_share": float(still.sum() / max((~few).sum(), 1)),
                "vectors_counted": "valid and replaced" if self.replaced else "valid",
            },
        )


def _std_of_mean_product(moments: Moments, spacing: Spacing, a: int, b: int) -> NDArray[np.float64]:
    """Of u_a' u_b', whose variance is <u_a'^2 u_b'^2> - <u_a' u_b'>^2.

    From n samples and about their mean that is too small, for Gaussian ones by the factor 1 - (T_a + T_b + T_ab)/n to
    first order, 1 - 3/n where they are independent. Of two samples both products are equal, whatever they are: the
    scatter is 0 and tells nothing, hence NaN for fewer than three.
    """
    spread = moments.central((a, 2), (b, 2)) - moments.central((a, 1), (b, 1)) ** 2
    n, together = moments.count, spacing(a, b)
    left = np.maximum(n - spacing(a) - spacing(b) - together, 0.25 * n)
    return np.where(n >= FEWEST, np.sqrt(spread.clip(0) * together / left), np.nan)


def _std_of_root(square: NDArray[np.float64], std: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the square root of ``square`` to first order; where that is less than its own standard deviation ``std``, as
    if it were that much."""
    return std / (2 * np.sqrt(np.maximum(square, std)))


def _skewness(moments: Moments, spacing: Spacing, c: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Skewness g and its standard deviation to first order (standard errors of functions of moments:
    Kendall & Stuart, The Advanced Theory of Statistics, vol. 1, chapter 10).

    g changes with a sample z (about the mean, in RMS) as z^3 - 3 z - 3/2 g z^2 + g/2, the mean square of which, from
    moments up to the sixth, over the number of independent samples is its variance; 6 for a Gaussian.
    """
    variance = moments.central((c, 2))
    g, a4, a5, a6 = (moments.central((c, p)) / variance ** (p / 2) for p in range(3, 7))
    spread = a6 - 6 * a4 + 9 - 3 * g * a5 + 2.25 * g**2 * a4 + 8.75 * g**2
    enough = moments.count >= FEWEST
    std = np.sqrt(spread.clip(0) * spacing(c, c, c) / moments.count)
    return np.where(enough, g, np.nan), np.where(enough, std, np.nan)


def _of_one_time(field: xr.Dataset) -> xr.Dataset:
    """The field on (z, y, x)."""
    missing = [name for name in (*NAMES, *(f"{n}_std" for n in NAMES), "valid") if name not in field]
    if missing:
        raise PlenoPIVError(f"statistics: a field without {', '.join(missing)} is no velocity field of plenopiv")
    if "time" in field.dims:
        if field.sizes["time"] != 1:
            raise PlenoPIVError(
                f"statistics: {field.sizes['time']} times at once; add them one by one, field.isel(time=[k])"
            )
        field = field.isel(time=0)
    if set(field["u"].dims) != set(DIMS):
        raise PlenoPIVError(f"statistics: u has dimensions {field['u'].dims}, wanted {DIMS}")
    return field.transpose(*DIMS, ...)
