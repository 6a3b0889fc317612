"""How the light of one pixel is distributed over many frames: noise, and now and then a particle.

Static light shifts this distribution; how far is found by maximum likelihood. Frames in which no particle lights the
pixel show noise about the static light, a sharp peak; the others lie above it. A frame counts by the slope of the
distribution's logarithm where it falls (the score), so that frames far above the peak count nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STEP = 0.25  # counts, of the tabulated distribution
REACH = 6.0  # standard deviations of noise within which a frame counts
PER_STD = 20  # entries of a score table
RATIO = 1.15  # of successive noises that are tabulated
BRIGHT = 10.0  # standard deviations of noise: static light that tells by how much a pulse was brighter
FEWEST = 200  # pixels of it
SCALES = (0.5, 2.0)  # what pulses may differ by
TRIED = 76
STEPS = 5
SLOWEST = 1.0  # standard deviations that an estimate moves at a time, at most

Counts = NDArray[np.float32]


@dataclass(frozen=True)
class PixelLight:
    """What pixels without static light show, tabulated for several noises.

    ``noise``: standard deviation in counts without any light. ``stds`` (m,): noises of pixels with static light.
    ``score`` (m, n): slope of the logarithm of the density, times the noise, at ``REACH`` standard deviations below to
    ``REACH`` above, 0 at both ends. ``information`` (m,): mean square of it. ``particles``: mean counts of
    the particles.
    """

    noise: float
    stds: NDArray[np.float64]
    score: NDArray[np.float32]
    information: NDArray[np.float64]
    density: NDArray[np.float64]
    start: float
    particles: float

    def level(self, std: Counts) -> NDArray[np.int8]:
        """Row of the tables for pixels of noise ``std``."""
        row = np.rint(np.log(np.maximum(std, 1e-3) / self.stds[0]) / np.log(RATIO))
        return np.clip(row, 0, len(self.stds) - 1).astype(np.int8)

    def scores(self, residual: Counts, level: NDArray[np.int8]) -> Counts:
        """Of counts that lie ``residual`` above static light; in standard deviations of the noise."""
        std = self.stds[level].astype(np.float32)
        column = (residual / std + np.float32(REACH)) * np.float32(PER_STD) + np.float32(0.5)
        return self.score[level, np.clip(column, 0, self.score.shape[1] - 1).astype(np.intp)]

    def brightness(self, counts: Counts, static: Counts, level: NDArray[np.int8]) -> tuple[float, float]:
        """By how much a frame's pulse was brighter than the ``static`` light (n,) that was recorded of it, by maximum
        likelihood on ``counts`` (n,) above the dark level, and the standard error; (1, inf) where static light is not
        bright enough to tell."""
        bright = static > BRIGHT * self.noise
        if np.count_nonzero(bright) < FEWEST:
            return 1.0, np.inf
        counts, static, level = counts[bright], static[bright], level[bright]
        weight = static / self.stds[level]
        scales = np.linspace(*SCALES, TRIED)  # where most pixels agree; then the top of the likelihood near it
        agree = [np.count_nonzero(np.abs(counts - np.float32(s) * static) < self.stds[level]) for s in scales]
        scale, information = float(scales[np.argmax(agree)]), float(np.sum(weight**2 * self.information[level]))
        for _ in range(STEPS):
            score = float(np.sum(weight * self.scores(counts - np.float32(scale) * static, level)))
            scale = float(np.clip(scale + score / information, *SCALES))
        return scale, information**-0.5

    def lowest(self, frames: int) -> NDArray[np.float64]:
        """Mean of the lowest of so many frames above static light, counts, (m,): below 0 with noise, above it where
        particles light nearly every frame."""
        counts = self.start + STEP * np.arange(self.density.shape[1])
        above = np.clip(1.0 - np.cumsum(self.density, 1), 0.0, 1.0) ** frames
        return counts[0] + STEP * above.sum(1)


def pixel_light(counts: Counts, counts_per_electron: float, brightest: float) -> PixelLight:
    """From ``counts`` (n,) of pixels whose static light was taken off; ``brightest`` static light, counts, for which
    it will be asked."""
    noise = noise_below_peak(counts)
    stds = noise * RATIO ** np.arange(
        1 + max(0, np.ceil(np.log((1 + counts_per_electron * max(brightest, 0.0) / noise**2) ** 0.5) / np.log(RATIO)))
    )
    start = -2 * REACH * float(stds[-1])
    end = float(counts.max()) + 2 * REACH * float(stds[-1])
    edges = np.arange(start, end + STEP, STEP)
    found = np.histogram(counts, edges)[0].astype(float)
    found /= found.sum()
    width = max(round(1.0 / STEP), 1)  # whole counts
    found = np.convolve(found, np.full(width, 1.0 / width), "same")
    density = np.stack([_blurred(found, (std**2 - noise**2 + (0.25 * noise) ** 2) ** 0.5) for std in stds])
    places = start + STEP * (0.5 + np.arange(density.shape[1]))
    table = np.zeros((len(stds), round(2 * REACH * PER_STD) + 1))
    information = np.zeros(len(stds))
    at = np.arange(table.shape[1]) / PER_STD - REACH
    for row, (std, one) in enumerate(zip(stds, density, strict=True)):
        slope = -np.gradient(np.log(np.maximum(one, 1e-12)), STEP)
        table[row] = std * np.interp(at * std, places, slope)
        table[row, [0, -1]] = 0.0
        inside = np.abs(places) < REACH * std
        information[row] = float(np.sum(one[inside] * (std * slope[inside]) ** 2))
    return PixelLight(
        noise, stds, table.astype(np.float32), np.maximum(information, 1e-3), density, start, float(counts.mean())
    )


def peak(counts: Counts) -> float:
    """Where counts are densest, of pixels that often show noise alone: the middle of the shortest interval that holds
    a fifth of the lower three quarters, the very lowest left out."""
    low = np.sort(counts)[len(counts) // 200 : max(3 * len(counts) // 4, 2)].astype(np.float64)
    share = max(len(low) // 5, 1)
    smooth = low + (np.arange(len(low)) * 0.61803398875 % 1.0 - 0.5)  # whole counts spread over their width
    smooth.sort()
    k = int(np.argmin(smooth[share:] - smooth[:-share]))
    return float(np.median(smooth[k : k + share]))


def noise_below_peak(counts: Counts) -> float:
    """Standard deviation of the noise from the values below 0, where the peak is."""
    below = counts[counts < 0]
    return max(float(np.sqrt(np.mean(below.astype(np.float64) ** 2))) if len(below) else 0.0, 12**-0.5)


def _blurred(density: NDArray[np.float64], std: float) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(density, std / STEP, mode="constant")
