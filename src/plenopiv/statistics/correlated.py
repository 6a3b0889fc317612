"""How many of successive samples are independent, from their autocorrelation in time.

The variance of a mean of n successive samples of variance s^2 and autocorrelation rho(k) is

    s^2 T/n,   T = 1 + 2 sum_k (1 - k/n) rho(k),

so that n/T samples count as independent. T is twice the integral time scale in units of the time between samples
(Tennekes & Lumley 1972, A First Course in Turbulence, section 6.4; George, Beuther & Lumley 1978, Processing of random
signals). For products of fluctuations it is shorter: in a Gaussian process the product of two fluctuations that are
correlated alike has the autocorrelation rho^2, and the third Hermite polynomial, on which skewness depends, rho^3.

rho is computed at every place for the first lags, about the mean of all samples. Deviations from a sample mean are
less correlated than those from the true mean: the autocovariance is too small by the variance of the mean, which is
put back. The sum ends at the first lag at which rho is not positive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

POOL = 5  # vectors along each axis over which autocorrelations are averaged
_ROUNDS = 4  # for the variance of the mean, which depends on T
_LARGEST_SHARE = 0.5  # of the variance, that the variance of the mean may have


class TimeCorrelation:
    """Autocovariances of three components at ``shape`` (z, y, x) places for lags 0 to ``lags``, one sample at a time.

    Only the last and the first ``lags`` samples are held. A missing sample takes the mean of those before it, so that
    it adds nothing, and is not counted.
    """

    def __init__(self, shape: tuple[int, ...], lags: int) -> None:
        self.lags, self.added = lags, 0
        self._about = np.zeros((3, *shape))  # the first sample: sums of products about it are small numbers
        self._since = np.zeros(shape, np.int32)  # samples from the first counted one on
        self._total = np.zeros((3, *shape))
        self._products = np.zeros((lags + 1, 3, *shape))
        self._count = np.zeros((lags + 1, *shape), np.int32)
        self._last = np.zeros((lags, 3, *shape), np.float32)
        self._first = np.zeros((lags, 3, *shape), np.float32)
        self._counted = np.zeros((lags, *shape), bool)

    def add(self, values: NDArray[np.float64], counted: NDArray[np.bool_], mean: NDArray[np.float64]) -> None:
        """One sample (3, shape), where it is ``counted`` (shape), and the ``mean`` of all samples up to it."""
        self._about = np.where((self._since == 0) & counted, values, self._about)
        # rounded once, so that sums and products are those of the same numbers
        now = np.where(counted, values, mean) - self._about
        started = counted | (self._since > 0)
        now = np.where(started, now, 0.0).astype(np.float32).astype(float)
        self._total += now
        self._products[0] += now * now
        self._count[0] += counted
        for lag in range(1, min(self.lags, self.added) + 1):
            slot = (self.added - lag) % self.lags
            self._products[lag] += now * self._last[slot]
            self._count[lag] += counted & self._counted[slot]
        if self.lags:
            slot = self.added % self.lags
            self._last[slot], self._counted[slot] = now, counted
            young = started & (self._since < self.lags)
            z, y, x = np.nonzero(young)
            self._first[self._since[young], :, z, y, x] = now[:, young].T
        self._since += started
        self.added += 1

    def correlation(self) -> NDArray[np.float64]:
        """rho (lags, 3, z, y, x) about the sample mean at lags 1 to ``lags``, averaged over POOL vectors along each
        axis, weighted by the number of samples; zero where nothing is known."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self._total / self._since
            variance = (self._products[0] - mean * self._total) / self._count[0]
            head, tail = np.zeros_like(mean), np.zeros_like(mean)
            out = np.zeros((self.lags, *mean.shape))
            for lag in range(1, min(self.lags, self.added - 1) + 1):
                head += self._first[lag - 1]
                tail += self._last[(self.added - lag) % self.lags]
                ends = mean * (2 * self._total - head - tail)
                found = (self._products[lag] - ends + (self._since - lag) * mean**2) / self._count[lag] / variance
                out[lag - 1] = _pooled(found, self._count[lag])
        return out

    def spacing(self, count: NDArray[np.int64]) -> Spacing:
        """How far apart independent samples are, with ``count`` (z, y, x) samples at each place."""
        found = self.correlation()
        lag = np.arange(1, self.lags + 1).reshape(-1, 1, 1, 1, 1)
        found = np.where(3 * lag <= count, found, 0.0)  # of fewer than three such stretches little is known
        n = np.maximum(count, 1)
        share = np.zeros(found.shape[1:])  # T/n, the variance of the mean over that of a sample
        for _ in range(_ROUNDS):
            rho = np.minimum(_until_zero((1 - share) * found + share * (found != 0)), 1.0)
            share = np.minimum((1 + 2 * ((1 - lag / n).clip(0) * rho).sum(0)) / n, _LARGEST_SHARE)
        return Spacing(rho, n)


class Spacing:
    """T of the mean of one component, or of the mean product of several: ``spacing(0)`` of u, ``spacing(0, 1)`` of
    u'v', ``spacing(2, 2, 2)`` of w'^3; each (z, y, x), in samples, 1 where they are independent."""

    def __init__(self, rho: NDArray[np.float64], count: NDArray[np.int64]) -> None:
        self.rho, self._count = rho, count

    def __call__(self, *components: int) -> NDArray[np.float64]:
        """T of the product of these components."""
        lag = np.arange(1, len(self.rho) + 1).reshape(-1, 1, 1, 1)
        product = np.prod([self.rho[:, c] for c in components], axis=0)
        total = 1 + 2 * ((1 - lag / self._count).clip(0) * product).sum(0)
        return np.minimum(total, self._count)

    def longer_than_lags(self) -> NDArray[np.bool_]:
        """Where the correlation of a component (z, y, x) has not ended at the last lag: T is too short there."""
        return (self.rho[-1] > 0.1).any(0) if len(self.rho) else np.zeros(self._count.shape, bool)


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
