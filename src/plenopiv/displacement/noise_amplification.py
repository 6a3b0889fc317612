"""Noise amplification by iterated deformation, and the noise of means over several vectors.

The noise n of one correlation is white noise averaged over the window (transfer function W). With the predictor
p = F d of a pass (F the filter between passes) the next pass finds d = H p + (n - C p), where H is the spline through p
and C the response of a window to it. After N passes

    d = G n,   G_1 = 1,   G_j = 1 + F (H - C) G_{j-1},   K = <|W|^2 G^2> / <|W|^2>,   c K = <|W|^2 G^2 Q^2> / <|W|^2>

with means <> over all waves that the vectors sample (Schrijer & Scarano 2008 treat the same loop). F, H and C are those
of the vectors of the pass before, which may stand farther apart (``CorrelationSettings.passes``). Q is the response of
``uncertainty.averaging_bias``. |W|^2 G^2 is the spectrum of the vectors' noise and its Fourier transform the covariance
cov_ij of neighbours; the mean of vectors with weights w has the variance sum_ij w_i w_j cov_ij.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.overlap import mean_of_wave
from plenopiv.displacement.predictor import filter_response, spline_aliases
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import Weights
from plenopiv.displacement.windows import WindowGrid, step_of

_WAVES = 32  # wave numbers along each axis
_FARTHEST = _WAVES // 2 - 1  # vectors between two whose covariance is known
_ALIASES = 4


@dataclass(frozen=True)
class NoiseAmplification:
    """``gain``: K, variance of a vector over that of one correlation. ``bias_share``: c, variance that noise gives the
    estimated averaging bias, over the variance of a vector. ``covariance`` (n, n, n): of two vectors over the variance
    of one; the index less that of the middle is their distance in vectors along z, y, x."""

    gain: float
    bias_share: float
    covariance: NDArray[np.float64]

    def variance_of_mean(self, weights: Weights) -> NDArray[np.float64]:
        """Variance (nz, ny, nx) of means with ``weights`` (means, vectors) along z, y, x, over that of one vector."""
        z, y, x = map(_pairs, weights)
        along_x = np.einsum("abc,xc->abx", self.covariance, x)  # axis by axis, without BLAS
        return np.einsum("za,ayx->zyx", z, np.einsum("yb,abx->ayx", y, along_x))


def _pairs(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums (means, 2 _FARTHEST + 1) of the products of two weights, by how far apart they are."""
    out = np.zeros((len(weights), 2 * _FARTHEST + 1))
    for apart in range(min(_FARTHEST, weights.shape[1] - 1) + 1):
        both = (weights[:, apart:] * weights[:, : weights.shape[1] - apart]).sum(1)
        out[:, _FARTHEST + apart] = out[:, _FARTHEST - apart] = both
    return out


def noise_amplification(windows: WindowGrid, settings: CorrelationSettings) -> NoiseAmplification:
    """Noise amplification in the vectors of ``windows`` after ``settings.fine_passes`` passes.

    W is that of the squared tapered window along each axis, aliases folded.
    """
    q = 2 * np.pi * np.fft.fftfreq(_WAVES)  # radians per vector
    z, y, x = np.ix_(*(np.arange(_WAVES),) * 3)
    under = partial(mean_of_wave, taper=settings.taper_voxels)
    noise, bias = [], []
    for size, step, stride in zip(windows.size, windows.step, strides(windows), strict=True):
        waves = q[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
        noise.append((under(size, wave=waves / step) ** 2).sum(1))
        bias.append((2 * np.cos(stride * q) - 2) * bias_factor(size, step, stride))
    power = noise[0][z] * noise[1][y] * noise[2][x]
    amplified = np.ones_like(power)
    for before in settings.passes[-settings.fine_passes : -1]:
        spline, seen, passed = [], [], []
        for size, step in zip(windows.size, windows.step, strict=True):
            apart = step_of(size, before.overlap)
            turn = np.asarray(q * (apart / step), np.float64)
            waves, amplitude = spline_aliases(turn, _ALIASES)
            if apart != step:  # its aliases are other waves of the next vectors
                waves, amplitude = waves[:, _ALIASES, None], amplitude[:, _ALIASES, None]
            spline.append(amplitude.sum(1))
            seen.append((amplitude * under(size, wave=waves / apart)).sum(1))
            passed.append(filter_response(turn, before.overlap) if settings.filter_predictor else np.ones(_WAVES))
        f, h, c = (v[0][z] * v[1][y] * v[2][x] for v in (passed, spline, seen))
        amplified = 1 + f * (h - c) * amplified
    spectrum = power * amplified**2
    response = (bias[0][z] + bias[1][y] + bias[2][x]) ** 2
    of_one = spectrum.sum()
    covariance = np.fft.fftshift(np.fft.ifftn(spectrum).real) * (spectrum.size / of_one)
    gain, share = float(of_one / power.sum()), float((spectrum * response).sum() / of_one)
    return NoiseAmplification(gain, share, covariance[1:, 1:, 1:])  # symmetric about the middle


def strides(windows: WindowGrid) -> list[int]:
    """Number of vectors in about half a window along z, y, x; 0 where there are too few."""
    return [
        min(max(1, round(size / (2 * step))), (count - 1) // 2)
        for size, step, count in zip(windows.size, windows.step, windows.shape, strict=True)
    ]


def bias_factor(size: int, step: int, stride: int) -> float:
    """Factor from a second difference over ``stride`` vectors to n^2/24 d'' (``uncertainty.averaging_bias``)."""
    return (size / (step * stride)) ** 2 / 24 if stride else 0.0
