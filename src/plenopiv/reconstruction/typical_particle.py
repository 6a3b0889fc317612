"""The light of a typical particle, from the pixels of one frame: neither density nor positions need be known.

Particles strewn at random with density n give a pixel of weights w the mean, the variance and the characteristic
function

    mean = n <E> sum(w),    variance = n <E^2> sum(w^2),    log <exp(itI)> = n sum(<exp(itEw)> - 1),

sums over the volume (Campbell's theorem). Variance over mean is <E^2>/<E>, the typical brightness of those that carry
the light, whatever n is. Where particles differ widely that is far more than what most of them have. How widely they
differ is in the characteristic function: where one particle's light turns exp(itEw) by a radian or two, bright ones
count no more than faint ones. It is taken of differences between microlenses, and compared with that of log-normal
light.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.noise import Noise, with_neighbours
from plenopiv.sensor import at_full_scale

STEP = 8  # microlenses: a particle's light in one view spreads less far
WIDE = 0.8  # relative spread from which on the mean light is typical; of 0.5, up to 0.6 is found
FAR_BRIGHTER = 4.0  # times the typical particle in focus: pixels that only others, or a crowd, make so bright
LEFT = 0.4  # of the microlenses, at least, without such pixels
FAINTER = 0.6  # of the typical particle, at most, that is left without them: less differs by degrees
SAMPLE = 500_000  # differences, evenly spaced, of which the characteristic function is taken
FEWEST = 3000  # differences that tell a spread
BLOCKS = 6  # along each side of the field: light and density may differ a little between them ...
DARKEST, BRIGHTEST, DARKER = 0.1, 0.9, 0.4  # ... these quantiles of their light at most by this factor
LOWEST, BELOW_MEAN = 2.0, 2.05  # per cent of the pixels, the darkest, and how far below its mean a normal one begins
MOSTLY_STRAY = 0.5  # of all light: more, and what particles differ by is lost in its noise
LEVEL = 0.7  # of the characteristic function of differences, where it is compared
FARTHEST = 3.0  # radians, at most, by which a typical particle in focus turns it there
SPREADS = np.linspace(0.0, 2.5, 51)  # relative standard deviations of log-normal light that are compared
NORMAL = np.polynomial.hermite_e.hermegauss(41)  # nodes and weights of a normal distribution

Array = NDArray[np.float64]


class Moments(NamedTuple):
    """Of the pixels of some microlenses: the ``mean`` without noise, ``light``, <E^2>/<E> of the particles in counts,
    all pixels of one together, 0 where there are none; ``noise``: variance of a pixel's noise that is not the
    particles' own shot noise."""

    mean: float
    light: float
    noise: float

    def without(self, stray: float, counts_per_electron: float) -> Moments:
        """The same without ``stray`` counts in each pixel that are not of particles: their shot noise is noise."""
        mean = self.mean - stray
        noise = self.noise + counts_per_electron * stray
        return self._replace(mean=mean, light=self.light * self.mean / mean, noise=noise)


class Differences(NamedTuple):
    """Between pixels of microlenses STEP apart: ``counts`` (n,), those of the second, ``first`` (n,), and ``block``
    (n,), in which part of the field."""

    counts: Array
    first: Array
    block: NDArray[np.int64]

    @property
    def even(self) -> bool:
        """Whether there are FEWEST at least, of blocks that are about as bright as each other."""
        count = np.bincount(self.block, minlength=BLOCKS**2)
        means = np.bincount(self.block, self.first, BLOCKS**2)[count > 0] / count[count > 0]
        dark, bright = np.quantile(means, (DARKEST, BRIGHTEST)) if len(means) else (0.0, 0.0)
        return len(self.counts) >= FEWEST and bool(dark > DARKER * bright)


def typical_particle(lightfield: LightField, projector: PlenopticProjector, noise: Noise) -> float:
    """Light of a typical particle, in counts, all its pixels together; 0 where no pixel sees the volume alone.

    That is <E^2>/<E>, or, where particles differ WIDEly, <E>. A few far brighter ones, aggregates say, make any spread
    look wide: microlenses with pixels FAR_BRIGHTER than the typical particle in focus, and those about them, are left
    out where enough others are, in which it is FAINTER. The variance is taken between microlenses STEP apart along a
    row, which removes a slowly varying illumination, and over pixels that see the volume alone and are not saturated.
    """
    where = lightfield.layout
    found = moments(lightfield, projector, noise)
    if found.light == 0:
        return 0.0
    mean = wide_mean(lightfield, projector, noise, found)
    if mean is None:
        return found.light
    bright = (lightfield.values > FAR_BRIGHTER * found.light * projector.light_in_focus).any(0)
    others = ~with_neighbours(bright.reshape(where.nj, where.ni))
    if others.mean() >= LEFT and not others.all():
        without = moments(lightfield, projector, noise, others)
        if 0 < without.light < FAINTER * found.light:
            return wide_mean(lightfield, projector, noise, without, others) or without.light
    return mean


def wide_mean(
    lightfield: LightField,
    projector: PlenopticProjector,
    noise: Noise,
    found: Moments,
    which: NDArray[np.bool_] | None = None,
) -> float | None:
    """The mean light of particles in counts where they differ WIDEly, None where they do not. ``found``: of the same
    microlenses ``which`` (nj, ni), None for all. Where the field is lit unevenly that is not asked: parts with and
    without light look like bright particles and faint ones. Nor does light count that even the darkest pixels have: it
    may be stray light. Where most of all light is, nothing is asked, either."""
    between = differences(lightfield, projector, which)
    if not between.even:
        return None
    stray = of_all_pixels(float(np.percentile(between.first, LOWEST)), noise)
    if stray > MOSTLY_STRAY * found.mean:
        return None
    particles = found.without(stray, noise.counts_per_electron)
    spread = relative_spread(between, projector, noise, particles)
    return particles.light / (1.0 + spread**2) if spread >= WIDE else None


def of_all_pixels(lowest: float, noise: Noise) -> float:
    """Counts that even the darkest pixels have, of which the least are the ``lowest``: these are as far below as noise
    makes one in fifty, shot noise of the counts themselves among it."""
    shot = 0.5 * BELOW_MEAN * noise.counts_per_electron
    std = shot + np.sqrt(max(shot**2 + noise.dark**2 + noise.counts_per_electron * lowest, 0.0))
    return max(lowest + BELOW_MEAN * max(float(std), noise.dark), 0.0)


def moments(
    lightfield: LightField, projector: PlenopticProjector, noise: Noise, which: NDArray[np.bool_] | None = None
) -> Moments:
    """Of the microlenses ``which`` (nj, ni), None for all."""
    where = lightfield.layout
    total, squares, _ = projector.weight_sums().T
    light = projector.light_of_planes().astype(np.float64)
    step_sums, mean_sums, static_sums, count = 0.0, 0.0, 0.0, 0
    for view in projector.whole_views:
        values, both = _pairs(lightfield, projector, int(view), which)
        a, b = values[:, STEP:][both].astype(np.float64), values[:, :-STEP][both]
        step_sums += float(np.sum((a - b) ** 2))
        mean_sums += float(np.sum(a + b))
        count += a.size
        if noise.background is not None:
            behind = noise.background[view].reshape(where.nj, where.ni)
            static_sums += float(np.sum(np.maximum(behind[:, STEP:][both], 0.0), dtype=np.float64))
    if not count or mean_sums <= 0:
        return Moments(0.0, 0.0, 0.0)
    mean = 0.5 * mean_sums / count
    variance = 0.5 * step_sums / count - noise.dark**2 - noise.counts_per_electron * (mean + static_sums / count)
    typical = variance / mean * (light @ total) / (light**2 @ squares)
    of_others = noise.dark**2 + noise.counts_per_electron * static_sums / count
    return Moments(mean, max(float(typical), 0.0), of_others)


def relative_spread(between: Differences, projector: PlenopticProjector, noise: Noise, found: Moments) -> float:
    """Standard deviation of the light of particles over its mean, were it log-normal, at most the last of SPREADS.
    ``found``: of the same microlenses as the differences ``between`` them."""
    total, squares, _ = projector.weight_sums().T
    light = projector.light_of_planes().astype(np.float64)
    lit, weight = total**2 / squares, light * squares / total  # as if all that a plane's particle lights were even
    turn = _turn(between.counts, FARTHEST / (found.light * weight.max()))
    measured = exponent(between, turn) - 0.5 * turn**2 * found.noise
    density = found.mean * (1.0 + SPREADS**2) / found.light / (light @ total)
    expected = density * [
        lit @ _turned(turn, found.light / (1.0 + s**2), s, weight, noise.counts_per_electron) for s in SPREADS
    ]
    return float(np.interp(-measured, -expected, SPREADS))  # the wider, the less


def _turned(turn: float, mean: float, spread: float, weight: Array, counts_per_electron: float) -> Array:
    """1 - Re <exp(itEw)> of planes of the ``weight`` (nz,), light E log-normal with shot noise; t: ``turn``."""
    sigma = np.sqrt(np.log(1.0 + spread**2))
    light = mean * np.exp(sigma * NORMAL[0] - 0.5 * sigma**2)[:, None] * weight
    shot = np.exp(-0.5 * turn**2 * counts_per_electron * light)
    return np.asarray(NORMAL[1] / NORMAL[1].sum() @ (1.0 - np.cos(turn * light) * shot), np.float64)


def differences(
    lightfield: LightField, projector: PlenopticProjector, which: NDArray[np.bool_] | None = None
) -> Differences:
    """About SAMPLE of them, or all, of the microlenses ``which`` (nj, ni), None for all."""
    where = lightfield.layout
    block = np.add.outer(np.arange(where.nj) * BLOCKS // where.nj * BLOCKS, np.arange(where.ni) * BLOCKS // where.ni)
    pairs = [_pairs(lightfield, projector, int(view), which) for view in projector.whole_views]
    step = max(sum(np.count_nonzero(both) for _, both in pairs) // SAMPLE, 1)
    counts, first, blocks = [], [], []
    for number, (values, both) in enumerate(pairs):
        some = slice(number % step, None, step)
        first.append(values[:, :-STEP][both][some].astype(np.float64))
        counts.append(values[:, STEP:][both][some] - first[-1])
        blocks.append(block[:, STEP:][both][some])
    if not pairs:
        return Differences(np.empty(0), np.empty(0), np.empty(0, np.int64))
    return Differences(np.concatenate(counts), np.concatenate(first), np.concatenate(blocks))


def exponent(between: Differences, turn: float) -> float:
    """-log |<exp(itI)>| of a pixel's counts I at t = ``turn``, the mean over the blocks."""
    of_block = np.bincount(between.block, minlength=BLOCKS**2)
    sums = np.bincount(between.block, np.cos(turn * between.counts), BLOCKS**2)
    some = of_block > 0
    least = 1.0 / of_block[some]  # a mean may by chance be none, or less
    return float(-0.5 * np.average(np.log(np.maximum(sums[some] / of_block[some], least)), weights=of_block[some]))


def _turn(counts: Array, most: float) -> float:
    """Where the characteristic function of ``counts`` falls to LEVEL; ``most`` at most."""
    low, high = 0.0, most
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.mean(np.cos(middle * counts)) > LEVEL else (low, middle)
    return high


def _pairs(
    lightfield: LightField, projector: PlenopticProjector, view: int, which: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The values (nj, ni) of one view, and which of them (nj, ni - STEP), and those STEP before, count."""
    where = lightfield.layout
    values = lightfield.values[view].reshape(where.nj, where.ni)
    inside = projector.rays_inside_grid(view).reshape(where.nj, where.ni) & ~at_full_scale(values, where.camera.sensor)
    if which is not None:
        inside &= which
    return values, inside[:, STEP:] & inside[:, :-STEP]
