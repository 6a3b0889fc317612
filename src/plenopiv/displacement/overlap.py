"""The overlap of two windows pulls their correlation peak to zero; by how much, after whitening and smoothing.

Windows with weights w share C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2 of their light at a displacement d. Particle
images that moved by D give, along one axis, the plain correlation G(d - D) C(d), G a Gaussian of variance s^2 (twice
that of an image), and division by C makes its maximum D again. Whitening and smoothing act on the product, not on G:

    R = F^-1[ S |S|^-whitening F ],   S = F[G(d - D) C],   F the filter,

so that division by C then corrects too little of a whitened peak, too much of a smoothed one. C^power is right, with a
power that depends on s alone (``powers``), and s is seen in the curvature of the peak, which grows as s falls. It is
right for the fraction of a voxel that deformation leaves; a voxel or more is taken too large, by 5 % with default
settings.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_MOVED = 0.25  # D, voxels
_WIDTHS = np.geomspace(0.5, 64.0, 48)  # s^2, voxel^2
LEAST_LEFT = 0.5  # of D in a peak that is corrected in full; of others this part is left out: noise grows with it
_NARROWEST = 0.4  # 1/K, voxel^2, of a peak that three voxels still tell
_KNOTS, _LONGER = 48, 3.0  # the widest peak of the table has this many times the 1/K of one corrected in full
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


def mean_of_wave(n: int, taper: float, wave: NDArray[np.float64]) -> NDArray[np.float64]:
    """W: means of waves (any shape), in radians a voxel and even about the middle, under a squared tapered window."""
    weight, place = fade(n, taper) ** 2, np.arange(n) - (n - 1) / 2
    out: NDArray[np.float64] = np.cos(wave[..., None] * place) @ weight / weight.sum()
    return out


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
    windows (voxel^2). K is minus the second difference of log R about the highest voxel. Powers are 0 or more; 1
    where three voxels do not tell a peak.
    """
    lag = np.arange(1 - n, n)
    shared = overlap(fade(n, taper))
    bent = -2 * np.log(shared[n])  # curvature of C at no displacement
    waves = 2 * np.pi * np.fft.fftfreq(around)
    known: list[tuple[float, float, float]] = []  # s^2, 1/K, power
    for width in _WIDTHS:
        product = np.exp(-((lag - _MOVED) ** 2) / (2 * width)) * shared
        spectrum = np.fft.fft(np.bincount(lag % around, product, around))
        strength = np.maximum(np.abs(spectrum), 1e-9 * np.abs(spectrum[0]))
        peak = np.fft.ifft(spectrum * strength**-whitening * np.exp(-variance * waves**2)).real[[-1, 0, 1]]
        if peak.min() <= 0.0:
            continue
        left, middle, right = np.log(peak)
        bend = 2 * middle - left - right
        kept = 0.5 * (right - left) / bend / _MOVED  # of the displacement
        if LEAST_LEFT <= kept <= 1.0 and 1 / bend >= _NARROWEST:
            known.append((width, 1 / bend, bend * (1 - kept) / bent))
    if not known:  # peaks too narrow for three voxels
        return np.array([0.0, 1.0, *np.ones(_KNOTS)])
    widths, inverse, power = np.array(known).T
    if inverse.max() < _TELLING * inverse.min():  # nearly phases alone: all peaks are alike
        return np.array([0.0, 1.0, *np.full(_KNOTS, np.interp(_USUAL, widths, power))])
    falls = np.flatnonzero(np.diff(inverse) <= 0)  # of narrow peaks, between voxels
    inverse, power = (v[falls.max(initial=-1) + 1 :] for v in (inverse, power))
    knots = np.linspace(inverse[0], _LONGER * inverse[-1], _KNOTS)
    most = (1 - LEAST_LEFT) / (knots * bent)  # C^power takes no more of a peak's curvature
    return np.array([knots[0], 1 / (knots[1] - knots[0]), *np.minimum(np.interp(knots, inverse, power), most)])
