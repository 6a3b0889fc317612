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
BLOCKS = 6  # along each side of the field: light and density may differ between them
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


class Differences(NamedTuple):
    """Between pixels of microlenses STEP apart: ``counts`` (n,), and ``block`` (n,), in which part of the field."""

    counts: Array
    block: NDArray[np.int64]


def typical_particle(lightfield: LightField, projector: PlenopticProjector, noise: Noise) -> float:
    """Light of a typical particle, in counts, all its pixels together; 0 where no pixel sees the volume alone.

    That is <E^2>/<E>, or, where particles differ WIDEly, <E>. A few far brighter ones, aggregates say, make any spread
    look wide: microlenses with pixels FAR_BRIGHTER than the typical particle in focus, and those about them, are left
    out where enough others are, in which it is FAINTER. The variance is taken between microlenses STEP apart along a
    row, which removes a slowly varying illumination, and over pixels that see the volume alone and are not saturated.
    """
    where = lightfield.layout
    every = np.ones((where.nj, where.ni), bool)
    found = moments(lightfield, projector, noise, every)
    if found.light == 0:
        return 0.0
    spread = relative_spread(lightfield, projector, noise, found, every)
    if spread < WIDE:
        return found.light
    bright = (lightfield.values > FAR_BRIGHTER * found.light * projector.light_in_focus).any(0)
    others = ~with_neighbours(bright.reshape(where.nj, where.ni))
    if others.mean() >= LEFT and not others.all():
        without = moments(lightfield, projector, noise, others)
        if 0 < without.light < FAINTER * found.light:
            found, spread = without, relative_spread(lightfield, projector, noise, without, others)
    return found.light if spread < WIDE else found.light / (1.0 + spread**2)


def moments(lightfield: LightField, projector: PlenopticProjector, noise: Noise, which: NDArray[np.bool_]) -> Moments:
    """Of the microlenses ``which`` (nj, ni)."""
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


def relative_spread(
    lightfield: LightField, projector: PlenopticProjector, noise: Noise, found: Moments, which: NDArray[np.bool_]
) -> float:
    """Standard deviation of the light of particles over its mean, were it log-normal, at most the last of SPREADS.
    ``found``: of the same microlenses."""
    between = differences(lightfield, projector, which)
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


def differences(lightfield: LightField, projector: PlenopticProjector, which: NDArray[np.bool_]) -> Differences:
    """SAMPLE of them, at most, of the microlenses ``which`` (nj, ni)."""
    where, counts, blocks = lightfield.layout, [], []
    block = np.add.outer(np.arange(where.nj) * BLOCKS // where.nj * BLOCKS, np.arange(where.ni) * BLOCKS // where.ni)
    views = projector.whole_views
    step = max(len(views) * where.nj * where.ni // SAMPLE, 1)
    for number, view in enumerate(views):
        values, both = _pairs(lightfield, projector, int(view), which)
        some = slice(number % step, None, step)
        counts.append((values[:, STEP:][both][some] - values[:, :-STEP][both][some]).astype(np.float64))
        blocks.append(block[:, STEP:][both][some])
    return Differences(np.concatenate(counts), np.concatenate(blocks))


def exponent(between: Differences, turn: float) -> float:
    """-log |<exp(itI)>| of a pixel's counts I at t = ``turn``, the mean over the blocks."""
    of_block = np.bincount(between.block, minlength=BLOCKS**2)
    sums = np.bincount(between.block, np.cos(turn * between.counts), BLOCKS**2)
    some = of_block > 0
    least = 1.0 / of_block[some]  # of very few, or very dense ones: as much as chance leaves
    return float(-0.5 * np.average(np.log(np.maximum(sums[some] / of_block[some], least)), weights=of_block[some]))


def _turn(counts: Array, most: float) -> float:
    """Where the characteristic function of ``counts`` falls to LEVEL; ``most`` at most."""
    low, high = 0.0, most
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.mean(np.cos(middle * counts)) > LEVEL else (low, middle)
    return high


def _pairs(
    lightfield: LightField, projector: PlenopticProjector, view: int, which: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The values (nj, ni) of one view, and which of them (nj, ni - STEP), and those STEP before, count."""
    where = lightfield.layout
    values = lightfield.values[view].reshape(where.nj, where.ni)
    inside = which & projector.rays_inside_grid(view).reshape(where.nj, where.ni)
    inside &= ~at_full_scale(values, where.camera.sensor)
    return values, inside[:, STEP:] & inside[:, :-STEP]
