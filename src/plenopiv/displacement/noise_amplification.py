"""Noise amplification by iterated deformation, and the noise of means over several vectors.

The noise n of one correlation is white noise averaged over the window (transfer function W). With the predictor
p = F d of a pass (F the filter between passes) the next pass finds d = p + (n - C p), where C is the response of a
window to the spline through p. After N passes

    d = G n,   G = sum_{j < N} (F (1 - C))^j,   K = <|W|^2 G^2> / <|W|^2>,   c K = <|W|^2 G^2 Q^2> / <|W|^2>

with means <> over all waves that the vectors sample (Schrijer & Scarano 2008 treat the same loop) and Q the response of
``uncertainty.averaging_bias``. |W|^2 G^2 is the spectrum of the vectors' noise and its Fourier transform the covariance
cov_ij of neighbours; the mean of vectors with weights w has the variance sum_ij w_i w_j cov_ij.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.overlap import fade
from plenopiv.displacement.predictor import smooth_predictor
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import Weights
from plenopiv.displacement.windows import WindowGrid

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
    noise, seen, bias = [], [], []
    for size, step, stride in zip(windows.size, windows.step, strides(windows), strict=True):
        k = q[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
        weight, place = fade(size, settings.taper_voxels) ** 2, (np.arange(size) - (size - 1) / 2) / step
        average = (np.cos(k[..., None] * place) @ weight) / weight.sum()
        spline = np.sinc(k / (2 * np.pi)) ** 4
        noise.append((average**2).sum(1))
        seen.append((spline * average).sum(1) / spline.sum(1))
        bias.append((2 * np.cos(stride * q) - 2) * bias_factor(size, step, stride))
    impulse = np.zeros((1, *(_WAVES,) * 3))
    impulse[0, 0, 0, 0] = 1.0
    impulse = np.roll(impulse, (_WAVES // 2,) * 3, (1, 2, 3))
    if settings.filter_predictor:
        impulse = smooth_predictor(impulse, settings.passes[-1].overlap)
    passed = np.abs(np.fft.fftn(impulse[0]))
    z, y, x = np.ix_(*(np.arange(_WAVES),) * 3)
    power = noise[0][z] * noise[1][y] * noise[2][x]
    kept = passed * (1 - seen[0][z] * seen[1][y] * seen[2][x])
    spectrum = power * sum(kept**j for j in range(settings.fine_passes)) ** 2
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
