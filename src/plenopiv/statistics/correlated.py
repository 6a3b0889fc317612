"""How many of successive samples are independent, from their autocorrelation in time.

The variance of a mean of n successive samples of variance s^2 and autocorrelation rho(k) is

    s^2 T/n,   T = 1 + 2 sum_k n_k/n rho(k),

where n_k of the n samples have another one k later, n - k where none is missing, so that n/T samples count as
independent. T is twice the integral time scale in units of the time between samples
(Tennekes & Lumley 1972, A First Course in Turbulence, section 6.4; George, Beuther & Lumley 1978, Processing of random
signals). For products of fluctuations it is shorter: in a Gaussian process the product of two fluctuations that are
correlated alike has the autocorrelation rho^2, and the third Hermite polynomial, on which skewness depends, rho^3.

rho is computed at every place for the first lags, about the mean of all samples. Deviations from a sample mean are
less correlated than those from the true mean: the autocovariance is too small by the variance of the mean, which is
put back. The sum for the mean ends at the first lag at which rho is not positive: of flow that oscillates, whose means
are better than that, T is too large. That for a product of two goes on over all lags: its rho^2 is positive in the
negative lobes as well, and would be far too small without them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

POOL = 5  # vectors along each axis over which autocorrelations are averaged
_ROUNDS = 4  # for the variance of the mean, which depends on T
_LARGEST_SHARE = 0.5  # of the variance, that the variance of the mean may have
STRETCHES = 3  # as long as a lag, that samples must last for its rho to be used: of fewer little is known
ENDED = 0.1  # rho at the last lag, or twice the mean of rho^2 over the last ones, beyond which it has not ended
ONE_IN = 2  # of the lags are the last ones: where a flow oscillates rho is small at any single one


class TimeCorrelation:
    """Autocovariances of three components at ``shape`` (z, y, x) places for lags 0 to ``lags``, one sample at a time.

    Only the last ``lags`` samples are held. Of each lag pairs of samples count that are both there.
    """

    def __init__(self, shape: tuple[int, ...], lags: int) -> None:
        self.lags, self.added = lags, 0
        self._about = np.zeros((3, *shape))  # the first sample: sums of products about it are small numbers
        self._total = np.zeros((3, *shape))
        self._products = np.zeros((lags + 1, 3, *shape))
        self._sums = np.zeros((lags, 3, *shape))  # of both samples of each pair
        self._count = np.zeros((lags + 1, *shape), np.int32)
        self._last = np.zeros((lags, 3, *shape), np.float32)
        self._counted = np.zeros((lags, *shape), bool)

    def add(self, values: NDArray[np.float64], counted: NDArray[np.bool_]) -> None:
        """One sample (3, shape), and where it is ``counted`` (shape)."""
        self._about = np.where((self._count[0] == 0) & counted, values, self._about)
        # rounded once, so that sums and products are those of the same numbers
        now = np.where(counted, values - self._about, 0.0).astype(np.float32).astype(float)
        self._total += now
        self._products[0] += now * now
        self._count[0] += counted
        for lag in range(1, min(self.lags, self.added) + 1):
            slot = (self.added - lag) % self.lags
            both = counted & self._counted[slot]
            self._products[lag] += now * self._last[slot]
            self._sums[lag - 1] += np.where(both, now + self._last[slot], 0.0)
            self._count[lag] += both
        if self.lags:
            slot = self.added % self.lags
            self._last[slot], self._counted[slot] = now, counted
        self.added += 1

    def correlation(self) -> NDArray[np.float64]:
        """rho (lags, 3, z, y, x) about the sample mean at lags 1 to ``lags``, averaged over POOL vectors along each
        axis, weighted by the number of samples; zero where nothing is known."""
        out = np.zeros((self.lags, *self._total.shape))
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self._total / self._count[0]
            variance = self._products[0] / self._count[0] - mean**2
            for lag in range(1, min(self.lags, self.added - 1) + 1):
                pairs = self._count[lag]
                covariance = (self._products[lag] - mean * self._sums[lag - 1]) / pairs + mean**2
                out[lag - 1] = _pooled(covariance / variance, pairs)
        return out

    def spacing(self, count: NDArray[np.int64]) -> Spacing:
        """How far apart independent samples are, with ``count`` (z, y, x) samples at each place."""
        found = self.correlation()
        lag = np.arange(1, self.lags + 1).reshape(-1, 1, 1, 1, 1)
        found = np.where(STRETCHES * lag <= count, found, 0.0)
        n = np.maximum(count, 1)
        pairs = (self._count[1:] / n)[:, None]
        share = np.zeros(found.shape[1:])  # T/n, the variance of the mean over that of a sample
        for _ in range(_ROUNDS):
            rho = np.clip((1 - share) * found + share * (found != 0), -1.0, 1.0)
            share = np.minimum((1 + 2 * (pairs * _until_zero(rho)).sum(0)) / n, _LARGEST_SHARE)
        return Spacing(rho, pairs[:, 0], n)


class Spacing:
    """T of the mean of one component, or of the mean product of several: ``spacing(0)`` of u, ``spacing(0, 1)`` of
    u'v', ``spacing(2, 2, 2)`` of w'^3; each (z, y, x), in samples, 1 where they are independent."""

    def __init__(self, rho: NDArray[np.float64], pairs: NDArray[np.float64], count: NDArray[np.int64]) -> None:
        """``rho`` (lags, 3, z, y, x); ``pairs`` (lags, z, y, x): share of the ``count`` (z, y, x) samples that have
        another one so much later."""
        self.rho, self._pairs, self._count = rho, pairs, count
        self._until_zero = _until_zero(rho)

    def __call__(self, *components: int) -> NDArray[np.float64]:
        """T of the product of these components."""
        rho = self.rho if len(components) == 2 else self._until_zero
        product = np.prod([rho[:, c] for c in components], axis=0)
        return np.clip(1 + 2 * (self._pairs * product).sum(0), 1, self._count)

    def longer_than_lags(self) -> NDArray[np.bool_]:
        """Where the correlation of a component (z, y, x) has not ended at the last lag that was used: T is too short
        there, be it of the mean or, in flow that oscillates, of products alone. Of samples that are too few for two
        lags nothing is said."""
        if not len(self.rho):
            return np.zeros(self._count.shape, bool)
        used = np.clip(self._count // STRETCHES, 1, len(self.rho))
        at_last = np.take_along_axis(self._until_zero, used[None, None] - 1, 0)[0]
        lag = np.arange(1, len(self.rho) + 1).reshape(-1, 1, 1, 1, 1)
        of_last = (lag <= used) & (lag > used - np.maximum(used // ONE_IN, 1))
        by_chance = 1 / np.maximum(self._pairs[:, None] * self._count, 1)  # rho^2 of independent samples
        square = ((self.rho**2 - by_chance) * of_last).sum(0) / of_last.sum(0)
        beyond = (at_last > ENDED) | (2 * square > ENDED)
        return beyond.any(0) & (self._count >= 2 * STRETCHES)


def _until_zero(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    return rho * np.cumprod(rho > 0, axis=0)


def _pooled(values: NDArray[np.float64], count: NDArray[np.int32]) -> NDArray[np.float64]:
    """Means (3, z, y, x) over POOL vectors along each axis, fewer at the faces, weighted by ``count``."""
    known = np.isfinite(values)
    weight = np.where(known, count, 0.0)
    size = (1, *(min(POOL, n) for n in values.shape[1:]))
    top = uniform_filter(np.where(known, values, 0.0) * weight, size, mode="constant")
    below = uniform_filter(weight, size, mode="constant")
    # running sums leave rounding behind where no place counts
    return np.where(below > 1e-9 * max(float(count.max(initial=0)), 1.0), top / np.maximum(below, 1e-30), 0.0)
