"""The pixels of one frame that particles are fitted to, and their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.reconstruction.noise import QUANTUM

Array = NDArray[np.float64]
LEAST_UNLIT = 500  # pixels without light that the dark noise is measured on


@dataclass(frozen=True)
class Pixels:
    """One frame's pixels, all (rows * columns,), as upright images run.

    ``counts`` above the black level, static light taken off; ``usable``: not masked, hot or saturated; ``noise``: the
    variance in counts^2 without the particles' light (a number, or of each pixel); ``counts_per_electron``: of shot
    noise. ``background``: even stray light in counts.
    """

    counts: Array
    usable: NDArray[np.bool_]
    noise: Array | float
    counts_per_electron: float
    background: float = 0.0

    @classmethod
    def of_image(
        cls,
        image: NDArray,
        black_level: float,
        full_scale: float,
        dark: float,
        counts_per_electron: float,
        unusable: NDArray[np.bool_] | None = None,
        static: NDArray | None = None,
    ) -> Pixels:
        """The pixels of an upright image (rows, columns) in counts. ``dark``: standard deviation of a dark pixel,
        counts; ``unusable`` (rows, columns); ``static``: counts of static light that were taken off."""
        usable = np.asarray(image < full_scale).ravel()
        if unusable is not None:
            usable &= ~unusable.ravel()
        noise: Array | float = dark**2
        if static is not None:
            noise = noise + counts_per_electron * np.maximum(static, 0.0).ravel().astype(np.float64)
        counts = np.asarray(image, np.float64).ravel() - black_level
        return cls(counts, usable, noise, counts_per_electron)

    def variance(self, light: Array) -> Array:
        """Variance in counts^2 of pixels that expect ``light`` counts of particles."""
        return self.counts_per_electron * np.maximum(light + self.background, 0.0) + self.noise

    def with_background_where(self, unlit: NDArray[np.bool_]) -> Pixels:
        """The same with stray light and dark noise measured on pixels that no particle lights; the same where there are
        too few."""
        values = self.counts[unlit & self.usable]
        if len(values) < LEAST_UNLIT:
            return self
        background = float(np.mean(values[np.abs(values - np.median(values)) < 6.0 * _spread(values)]))
        if not isinstance(self.noise, float):
            return replace(self, background=background)
        noise = max(_spread(values) ** 2 - self.counts_per_electron * max(background, 0.0), 1.0 / 12.0)
        return replace(self, background=background, noise=noise)


def _spread(values: Array) -> float:
    """Standard deviation by the 16th and 84th percentile; rounding to whole counts does not quantise it."""
    width = np.sort(values)[[round(0.1587 * (len(values) - 1)), round(0.8413 * (len(values) - 1))]]
    steps = 0.5 * float(width[1] - width[0])
    near = values[np.abs(values - np.median(values)) < 4.0 * max(steps, 0.5)]
    return max(float(np.std(near)), QUANTUM)
