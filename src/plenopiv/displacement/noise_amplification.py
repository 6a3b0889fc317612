"""Noise amplification by iterated deformation, and the noise of means over several vectors.

The noise n of one correlation is white noise averaged over the window (transfer function W). With the predictor
p = F d of a pass (F the filter between passes) the next pass finds d = H p + (n - r C p), where H is the spline through
p, C the response of a window to it, and r the part of a displacement that a peak shows: 1, but less in depth where
particles are long (``depth_response``). After N passes

    d = G n,   G_1 = 1,   G_j = 1 + F (H - r C) G_{j-1},   K = <|W|^2 G^2> / <|W|^2>,   c K = <|W|^2 G^2 Q^2> / <|W|^2>

with means <> over all waves that the vectors sample (Schrijer & Scarano 2008 treat the same loop). F, H and C are those
of the vectors of the pass before, which may stand farther apart (``CorrelationSettings.passes``). Through passes of
larger windows noise goes as displacements do, S' = F H S (1 - r W) + r W; what the finest leave of S, over r, comes to
W G. Where r is small that is most of it. Q is the response of
``uncertainty.averaging_bias``. |W|^2 G^2 is the spectrum of the vectors' noise and its Fourier transform the covariance
cov_ij of neighbours; the mean of vectors with weights w has the variance sum_ij w_i w_j cov_ij.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.overlap import LEAST_LEFT, mean_of_wave
from plenopiv.displacement.predictor import filter_response, spline_aliases
from plenopiv.displacement.settings import CorrelationSettings, Pass, Size
from plenopiv.displacement.sub_windows import Weights
from plenopiv.displacement.windows import WindowGrid, step_of

_WAVES = 32  # wave numbers along each axis
_FARTHEST = _WAVES // 2 - 1  # vectors between two whose covariance is known
_ALIASES = 4


@dataclass(frozen=True)
class NoiseAmplification:
    """``gain``: K, variance of a vector over that of one correlation. ``bias_share``: c, variance that noise gives the
    estimated averaging bias, over the variance of a vector. ``covariance`` (n, n, n): of two vectors over the variance
    of one; the index less that of the middle is their distance in vectors along z, y, x. ``of_all``: how far vectors
    move where all correlations of the last pass move by one, and the predictor with them."""

    gain: float
    bias_share: float
    covariance: NDArray[np.float64]
    of_all: float

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


def noise_amplification(
    windows: WindowGrid, settings: CorrelationSettings, response: float = 1.0
) -> NoiseAmplification:
    """Noise amplification in the vectors of ``windows`` after all passes; ``response``: r of the finest windows.

    W is that of the squared tapered window along each axis, aliases folded.
    """
    q = np.asarray(2 * np.pi * np.fft.fftfreq(_WAVES), np.float64)  # radians per vector
    under, passes = partial(mean_of_wave, taper=settings.taper_voxels), settings.passes
    noise, bias = [], []
    for size, step, stride in zip(windows.size, windows.step, strides(windows), strict=True):
        waves = q[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
        noise.append((under(size, wave=waves / step) ** 2).sum(1))
        bias.append((2 * np.cos(stride * q) - 2) * bias_factor(size, step, stride))
    power = _product(noise)

    def seen_by(size: Size) -> NDArray[np.float64]:
        return _product([under(n, wave=q / step) for n, step in zip(size[::-1], windows.step, strict=True)])

    own, amplified = seen_by(passes[-1].window), np.ones_like(power)
    coarse, predicted = np.zeros_like(power), np.zeros_like(power)
    for one in passes[: -settings.fine_passes]:
        part = _of_longer(response, one.window[2] / passes[-1].window[2])
        seen = part * seen_by(one.window)
        coarse = predicted * coarse * (1 - seen) + seen
        predicted = np.multiply(*_predicted(one, windows, settings, q)[:2])
    coarse *= predicted * (1 - response * own)
    for before in passes[-settings.fine_passes : -1]:
        f, h, c = _predicted(before, windows, settings, q)
        amplified, coarse = 1 + f * (h - response * c) * amplified, f * (h - response * c) * coarse
    whole = own * amplified + coarse / response
    spectrum = (power - own**2) * amplified**2 + whole**2
    of_bias = (bias[0][:, None, None] + bias[1][:, None] + bias[2]) ** 2
    of_one = spectrum.sum()
    covariance = np.fft.fftshift(np.fft.ifftn(spectrum).real) * (spectrum.size / of_one)
    gain, share = float(of_one / power.sum()), float((spectrum * of_bias).sum() / of_one)
    of_all = float(whole[0, 0, 0])  # of waves without end
    return NoiseAmplification(gain, share, covariance[1:, 1:, 1:], of_all)  # symmetric about the middle


def _predicted(
    before: Pass, windows: WindowGrid, settings: CorrelationSettings, q: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """F, H and C of the vectors of a pass before, for waves of ``q`` radians from one of ``windows`` to the next along
    each axis."""
    spline, seen, passed = [], [], []
    for size, own, step in zip(before.window[::-1], windows.size, windows.step, strict=True):
        apart = step_of(size, before.overlap)
        turn = np.asarray(q * (apart / step), np.float64)
        waves, amplitude = spline_aliases(turn, _ALIASES)
        if apart != step:  # its aliases are other waves of the next vectors
            waves, amplitude = waves[:, _ALIASES, None], amplitude[:, _ALIASES, None]
        spline.append(amplitude.sum(1))
        seen.append((amplitude * mean_of_wave(own, settings.taper_voxels, waves / apart)).sum(1))
        passed.append(filter_response(turn, before.overlap) if settings.filter_predictor else np.ones(_WAVES))
    return _product(passed), _product(spline), _product(seen)


def _of_longer(response: float, longer: float) -> float:
    """r of windows that are ``longer`` in depth than those of ``response``.

    What is left of a displacement in a peak before it is corrected is 1/(1 + x), x = (particle's length over the
    window's)^2 but for a factor; correction doubles it at most (``overlap``).
    """
    if response >= 1:
        return 1.0
    x = 1 / (LEAST_LEFT * response) - 1
    return min(1.0, 1 / (LEAST_LEFT * (1 + x / longer**2)))


def _product(along: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    z, y, x = along
    return np.asarray(z[:, None, None] * y[:, None] * x)


def strides(windows: WindowGrid) -> list[int]:
    """Number of vectors in about half a window along z, y, x; 0 where there are too few."""
    return [
        min(max(1, round(size / (2 * step))), (count - 1) // 2)
        for size, step, count in zip(windows.size, windows.step, windows.shape, strict=True)
    ]


def bias_factor(size: int, step: int, stride: int) -> float:
    """Factor from a second difference over ``stride`` vectors to n^2/24 d'' (``uncertainty.averaging_bias``)."""
    return (size / (step * stride)) ** 2 / 24 if stride else 0.0
