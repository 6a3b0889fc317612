"""The overlap of two windows pulls their correlation peak to zero; by how much, after whitening and smoothing.

Windows with weights w share C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2 of their light at a displacement d. A particle
image of width s that moved by D gives, along one axis, the plain correlation G(d - D) C(d) with G a Gaussian of
variance s^2, and division by C makes its maximum D again. Whitening and smoothing act on the product, not on G:

    R = F^-1[ S |S|^-whitening F ],   S = F[G(d - D) C],   F the filter,

so that division by C then corrects too little of a whitened peak, too much of a smoothed one. C^power is right, with a
power that depends on s alone (``powers``), and s is seen in the curvature of the peak, which grows as s falls.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_MOVED = 0.25  # D, voxels
_WIDTHS = np.geomspace(0.5, 64.0, 48)  # s^2, voxel^2
_LEAST_LEFT = 0.6  # of D in a peak, below which the power grows no more: noise grows with it
_KNOTS = 32
_TELLING, _USUAL = 1.2, 4.0  # ratio of 1/K over all widths below which K tells none; the s^2 that is taken then
PLAIN = 2  # where the powers begin in a row of ``powers``


def fade(
    n: int, taper: float, low: float | NDArray[np.float64] = 0.0, high: float | NDArray[np.float64] = 0.0
) -> NDArray[np.float64]:
    """One inside, sin^2 over the outermost ``taper`` voxels of ``n``, zero over the first ``low`` and last ``high``:
    (n,), or of several windows (batch, n) where these are (batch, 1)."""
    centre = np.arange(n) + 0.5
    edge = np.minimum(centre - low, n - high - centre)
    return np.sin(np.pi / 2 * np.clip(edge / taper, 0.0, 1.0)) ** 2 if taper > 0 else (edge > 0).astype(float)


def overlap(weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """C(d) for -n < d < n of a window's ``weight`` (n,): (2 n - 1,), 1 in the middle."""
    return np.correlate(weight, weight, "full") / (weight @ weight)


def overlaps(weights: NDArray[np.float32], shifts: NDArray[np.int64]) -> NDArray[np.float64]:
    """C(d) of the displacements ``shifts`` (m,) of many windows' ``weights`` (batch, n): (batch, m)."""
    values, n = weights.astype(np.float64), weights.shape[1]
    away = np.abs(shifts)
    shared = np.stack([(values[:, : n - d] * values[:, d:]).sum(1) for d in range(away.max() + 1)], -1)
    out: NDArray[np.float64] = shared[:, away] / shared[:, :1]
    return out


@lru_cache(maxsize=256)
def powers(n: int, around: int, taper: float, variance: float, whitening: float) -> NDArray[np.float64]:
    """Power of C by the curvature K of a peak along an axis: a row (2 + knots,), first 1/K of the first knot and the
    steps of 1/K between knots, one over another, then the power at each knot.

    ``n``: voxels of the window; ``around``: period of its transforms; ``variance``: of the Gaussian that smooths both
    windows (voxel^2). K is minus the second difference of log R about the highest voxel.
    """
    lag = np.arange(1 - n, n)
    shared = overlap(fade(n, taper))
    waves = 2 * np.pi * np.fft.fftfreq(around)
    inverse, power = [], []
    for width in _WIDTHS:
        product = np.exp(-((lag - _MOVED) ** 2) / (2 * width)) * shared
        folded = np.bincount(lag % around, product, around)
        spectrum = np.fft.fft(folded)
        strength = np.maximum(np.abs(spectrum), 1e-9 * np.abs(spectrum[0]))
        peak = np.fft.ifft(spectrum * strength**-whitening * np.exp(-variance * waves**2)).real
        left, middle, right = np.log(np.maximum(peak[[-1, 0, 1]], 1e-30))
        bend = 2 * middle - left - right
        kept = 0.5 * (right - left) / bend / _MOVED  # of the displacement
        if kept < _LEAST_LEFT:
            break
        inverse.append(1 / bend)
        power.append(bend * (1 - kept) / (-2 * np.log(shared[n])))
    if inverse[-1] < _TELLING * inverse[0]:  # phases alone: all peaks are alike
        return np.array([0.0, 1.0, *np.full(_KNOTS, np.interp(_USUAL, _WIDTHS[: len(power)], power))])
    knots = np.linspace(inverse[0], inverse[-1], _KNOTS)
    return np.array([knots[0], 1 / (knots[1] - knots[0]), *np.interp(knots, inverse, power)])
