"""The pixels of one frame that particles are fitted to, and their noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.noise import QUANTUM

Array = NDArray[np.float64]
LEAST_UNLIT = 500  # pixels without light that the dark noise is measured on
LEAST_LIT = 2000  # pixels with light that the shot noise is measured on
BRIGHT = 3.0  # dark standard deviations above which a pixel is lit; shot noise is measured on the brighter half of them
MEDIAN = 0.4549  # of chi^2 with one degree of freedom
SAMPLE = 200_000  # pixels, evenly spaced, that are looked at
UNLIT = 1e-7  # counts of a pixel that no particle lights
STEPS = 4  # in which dark noise and shot noise are measured, each with the other known


@dataclass(frozen=True)
class Pixels:
    """One frame's pixels, all (rows * columns,), as upright images run.

    ``counts`` above the black level, static light taken off; ``usable``: finite, not masked, hot or saturated;
    ``noise``: the variance of a dark pixel in counts^2; ``counts_per_electron``: of shot noise. ``background``: even
    stray light in counts; ``static``: counts of static light that were taken off, whose shot noise is left.
    ``cameras``: how many pixels each of several cameras has, one after the other (``of_cameras``); their noise and
    stray light are arrays.
    """

    counts: Array
    usable: NDArray[np.bool_]
    noise: Array | float
    counts_per_electron: Array | float
    background: Array | float = 0.0
    static: Array | float = 0.0
    cameras: tuple[int, ...] = ()

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
        """The pixels of an upright image (rows, columns) in counts; those that are not finite are not used. ``dark``:
        standard deviation of a dark pixel, counts; ``unusable`` (rows, columns); ``static``: counts of static light
        that were taken off.

        Raises:
            PlenoPIVError: an image of another shape; ``counts_per_electron`` that is negative.
        """
        if np.ndim(image) != 2:
            raise PlenoPIVError(f"tracking: an image of shape {np.shape(image)}, give (rows, columns)")
        if not 0.0 <= counts_per_electron < np.inf:  # 0 where a white image tells of no shot noise
            raise PlenoPIVError(f"tracking: counts_per_electron = {counts_per_electron}, give 0 or more")
        known = np.asarray(image, np.float64).ravel()
        usable = np.isfinite(known) & (known < full_scale)
        if unusable is not None:
            usable &= ~unusable.ravel()
        behind: Array | float = 0.0
        if static is not None:
            behind = np.maximum(static, 0.0).ravel().astype(np.float64)
        counts = np.where(np.isfinite(known), known, black_level) - black_level
        return cls(counts, usable, float(dark) ** 2, counts_per_electron, 0.0, behind)

    @classmethod
    def of_cameras(cls, each: Sequence[Pixels]) -> Pixels:
        """The pixels of one frame of several cameras, one camera after the other."""
        sizes = tuple(len(one.counts) for one in each)

        def joined(values: Iterable[Array | float]) -> Array:
            return np.concatenate([np.broadcast_to(v, n) for v, n in zip(values, sizes, strict=True)])

        return cls(
            joined(one.counts for one in each),
            np.concatenate([one.usable for one in each]),
            joined(one.noise for one in each),
            joined(one.counts_per_electron for one in each),
            joined(one.background for one in each),
            joined(one.static for one in each),
            sizes,
        )

    def of_each(self) -> list[Pixels]:
        """The pixels of each of several cameras, whose noise is even."""
        ends = np.cumsum(self.cameras)
        out = []
        for lo, hi in zip(ends - self.cameras, ends, strict=True):
            noise, gain, behind = (
                float(np.broadcast_to(v, ends[-1])[lo]) for v in (self.noise, self.counts_per_electron, self.background)
            )
            static = np.broadcast_to(self.static, ends[-1])[lo:hi]
            out.append(Pixels(self.counts[lo:hi], self.usable[lo:hi], noise, gain, behind, static))
        return out

    def among(self, which: NDArray[np.int64], others: Array) -> Pixels:
        """The pixels ``which`` (k,), of one or of several cameras, with stray light of ``others`` (k,), counts."""

        def some(values: Array | float) -> Array | float:
            return values[which] if isinstance(values, np.ndarray) else values

        noise, gain = some(self.noise), some(self.counts_per_electron)
        behind = some(self.background) + others, some(self.static)
        return Pixels(self.counts[which], self.usable[which], noise, gain, *behind)

    def variance(self, light: Array) -> Array:
        """Variance in counts^2 of pixels that expect ``light`` counts of particles."""
        return self.counts_per_electron * (np.maximum(light + self.background, 0.0) + self.static) + self.noise

    def with_measured_noise(self, unlit: NDArray[np.bool_], expected: Array, sample: int = SAMPLE) -> Pixels:
        """The same with noise measured on this frame. ``unlit``: pixels that no particle lights, which tell stray light
        and dark noise; ``expected``: counts of particles in each pixel. What pixels with light differ from that by
        tells the shot noise: it is taken where it is less than what was known, as a white image whose microlenses
        differ only bounds it. Median deviations are compared, so that particles not yet found count little. The same
        where there are too few pixels. ``sample``: pixels, evenly spaced, that are looked at."""
        if self.cameras:
            begin = np.cumsum(self.cameras)[:-1]
            parts = zip(self.of_each(), np.split(unlit, begin), np.split(expected, begin), strict=True)
            return Pixels.of_cameras([one.with_measured_noise(dark, light, sample) for one, dark, light in parts])
        some = slice(None, None, max(len(expected) // sample, 1))
        counts, usable, expected = self.counts[some], self.usable[some], expected[some]
        behind = np.broadcast_to(self.static, self.counts.shape)[some]
        dark = unlit[some] & usable
        dark[dark] = behind[dark] <= np.median(behind[dark]) if dark.any() else True
        values = counts[dark]
        if len(values) < LEAST_UNLIT:
            return self
        background = float(np.mean(values[np.abs(values - np.median(values)) < 6.0 * _spread(values)]))
        total = np.maximum(expected + background, 0.0) + behind
        square = (counts - background - expected) ** 2
        spread = _spread(values - background) ** 2
        mean = float(np.mean(total[dark]))
        noise, known = float(self.noise), float(self.counts_per_electron)
        gain = known
        for _ in range(STEPS):
            noise = max(spread - gain * mean, 1.0 / 12.0)
            lit = usable & (expected > BRIGHT * noise**0.5)
            if np.count_nonzero(lit) < LEAST_LIT:
                continue
            lit &= expected > np.median(expected[lit])
            ratio = float(np.median(square[lit] / (gain * total[lit] + noise))) / MEDIAN
            level = float(np.median(total[lit]))
            gain = min(max((ratio * (gain * level + noise) - noise) / level, 0.0), known)
        return replace(self, background=background, noise=noise, counts_per_electron=gain)


def with_noise(pixels: Pixels, image: Array, sample: int = SAMPLE) -> Pixels:
    """The pixels with noise as particles of so many counts in the ``image`` leave it, measured on a ``sample``."""
    return pixels.with_measured_noise(~lit_by(image), image, sample)


def lit_by(image: Array) -> NDArray[np.bool_]:
    """Which pixels any particle lights: sums leave rounding where light was taken away again."""
    return image > UNLIT


def _spread(values: Array) -> float:
    """Standard deviation by the 16th and 84th percentile; rounding to whole counts does not quantise it."""
    width = np.sort(values)[[round(0.1587 * (len(values) - 1)), round(0.8413 * (len(values) - 1))]]
    steps = 0.5 * float(width[1] - width[0])
    near = values[np.abs(values - np.median(values)) < 4.0 * max(steps, 0.5)]
    return max(float(np.std(near)), QUANTUM)
