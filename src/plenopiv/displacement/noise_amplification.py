"""How noise grows in iterated deformation, and what a mean over several vectors leaves of it.

Noise n of one correlation is white under a window's average W. With the predictor p = F d of a pass (F the filter
between passes) the next one finds d = p + (n - C p), C what windows see of the spline through p; so after N passes

    d = G n,   G = sum_{j < N} (F (1 - C))^j,   K = <|W|^2 G^2> / <|W|^2>,   c K = <|W|^2 G^2 Q^2> / <|W|^2>

over all waves that the vectors sample (Schrijer & Scarano 2008 treat the same loop), Q the response of
``uncertainty.curvature``. |W|^2 G^2 is the spectrum of the vectors' noise; its transform is the covariance of
neighbours, and a mean of vectors with weights w leaves sum_ij w_i w_j cov_ij of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.correlation import fade
from plenopiv.displacement.predictor import smooth_predictor
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import Weights
from plenopiv.displacement.windows import WindowGrid

_WAVES = 32  # wave numbers along each axis
_FARTHEST = _WAVES // 2 - 1  # vectors between two whose covariance is known
_ALIASES = 4


@dataclass(frozen=True)
class Growth:
    """``gain``: K. ``bent``: c, the share of the noise that shows as curvature. ``covariance`` (n, n, n): of vectors as
    many steps apart along z, y, x as the index is from the middle, over the variance of one."""

    gain: float
    bent: float
    covariance: NDArray[np.float64]

    def left(self, weights: Weights) -> NDArray[np.float64]:
        """Share (nz, ny, nx) of the variance of one vector that is left in means with ``weights`` (means, vectors)
        along z, y, x."""
        return np.einsum("abc,za,yb,xc->zyx", self.covariance, *map(_pairs, weights), optimize=True)


def _pairs(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums (means, 2 _FARTHEST + 1) of the products of two weights, by how far apart they are."""
    out = np.zeros((len(weights), 2 * _FARTHEST + 1))
    for apart in range(min(_FARTHEST, weights.shape[1] - 1) + 1):
        both = (weights[:, apart:] * weights[:, : weights.shape[1] - apart]).sum(1)
        out[:, _FARTHEST + apart] = out[:, _FARTHEST - apart] = both
    return out


def growth(windows: WindowGrid, settings: CorrelationSettings) -> Growth:
    """Of the vectors of ``windows``, found in ``settings.fine_passes``. W: of the square of the tapered window along
    each axis, aliases folded."""
    q = 2 * np.pi * np.fft.fftfreq(_WAVES)  # radians per vector
    noise, seen, bend = [], [], []
    for size, step, stride in zip(windows.size, windows.step, strides(windows), strict=True):
        k = q[:, None] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
        weight, place = fade(size, settings.taper_voxels) ** 2, (np.arange(size) - (size - 1) / 2) / step
        average = (np.cos(k[..., None] * place) @ weight) / weight.sum()
        spline = np.sinc(k / (2 * np.pi)) ** 4
        noise.append((average**2).sum(1))
        seen.append((spline * average).sum(1) / spline.sum(1))
        bend.append((2 * np.cos(stride * q) - 2) * bend_of(size, step, stride))
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
    response = (bend[0][z] + bend[1][y] + bend[2][x]) ** 2
    of_one = spectrum.sum()
    covariance = np.fft.fftshift(np.fft.ifftn(spectrum).real) * (spectrum.size / of_one)
    gain, bent = float(of_one / power.sum()), float((spectrum * response).sum() / of_one)
    return Growth(gain, bent, covariance[1:, 1:, 1:])  # as far to one side as to the other


def strides(windows: WindowGrid) -> list[int]:
    """Vectors to about half a window along z, y, x; 0 where there are too few."""
    return [
        min(max(1, round(size / (2 * step))), (count - 1) // 2)
        for size, step, count in zip(windows.size, windows.step, windows.shape, strict=True)
    ]


def bend_of(size: int, step: int, stride: int) -> float:
    """n^2/24 d'' from a second difference over ``stride`` vectors."""
    return (size / (step * stride)) ** 2 / 24 if stride else 0.0
