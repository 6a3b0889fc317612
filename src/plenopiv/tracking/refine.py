"""Joint Gauss-Newton of particles on raw pixels.

Pixel p expects  mu_p = background + sum_i E_i w_p(x_i)  counts and scatters with V_p = noise + gain * mu_p. Positions
and light minimise

    chi^2 = sum_p (counts_p - mu_p)^2 / V_p + sum_i |(x_i - prior_i) / prior std|^2 .

Each iteration asks by how much chi^2 falls where a particle moves alone, a sum over its pixels. Those that would gain
little (``Effort``) rest: their light is known from before. The others move together (``steps``); their exact light and
its derivatives are computed anew. The prior keeps particles in the dead zone, whose depth no pixel tells, where they
were first seen; it is wide against any other's error.

Of very many particles those of one area (``areas``) are fitted after those of another, the light of all others taken
as it is by then (block Gauss-Seidel, or multiplicative Schwarz: Saad, *Iterative Methods for Sparse Linear Systems*,
section 14.3); areas that are far from each other are fitted at once. Areas are cut elsewhere each time, so that of two
that are coupled both are soon in one. Lists of pixels are then never made of all particles together.

Source: Bjorck, *Numerical Methods for Least Squares Problems* (1996), sections 7.4 and 9.2; the same normal equations
are the Fisher information of ``accuracy.bound``, so their inverse is the covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.linalg import LinearOperator, cg

from plenopiv.threads import each_in_threads, in_threads, one_thread
from plenopiv.tracking import areas, entry_kernels, normal_kernels
from plenopiv.tracking.alone import alone, with_priors
from plenopiv.tracking.equations import normal_equations, own_equations, with_information
from plenopiv.tracking.light import LightOfPoints, Lights
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.steps import PARTS, step_of

Array = NDArray[np.float64]
Single = NDArray[np.float32]
OF_LIGHT, PRODUCTS = 1e-3, 80  # tolerance of conjugate gradients for light alone, and how many products at most
LARGEST_STEP = np.array([1.2, 1.2, 1.6])  # units: farther the derivatives do not hold
OUTLYING = 4.0  # standard deviations from which on pixels count less, as light of a particle not yet found (Huber 1981)
A_TURN = 4  # iterations of an area before the others are fitted to what it leaves
LEAST_LIGHT = 1e-3  # of the median: light stays positive


@dataclass(frozen=True)
class Prior:
    """Where particles were first seen, or are predicted to be, (n, 3) mm, and how well that is known in the least:
    ``std_mm`` (3,) or (n, 3)."""

    position_mm: Array
    std_mm: Array

    def information(self, unit_mm: Array) -> Array:
        """On x, y, z (n, 3), in units (3,) of ``unit_mm``."""
        return np.broadcast_to((unit_mm / self.std_mm) ** 2, self.position_mm.shape)

    def of(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Prior:
        """That of the particles ``which`` alone."""
        return Prior(self.position_mm[which], self.std_mm if self.std_mm.ndim == 1 else self.std_mm[which])

    def joined(self, position_mm: Array, std_mm: Array) -> Prior:
        """The same, and then particles first seen at ``position_mm`` (k, 3), all known to ``std_mm`` (3,)."""
        first = np.concatenate([self.position_mm, position_mm])
        if self.std_mm.ndim == 1:
            return Prior(first, self.std_mm)
        return Prior(first, np.concatenate([self.std_mm, np.broadcast_to(std_mm, position_mm.shape)]))


@dataclass(frozen=True)
class Effort:
    """How far a fit is taken. ``still``: the root of chi^2 that a particle must gain to move; ``near``: units of
    ``Lights.unit_mm`` within which light follows its derivatives, without being computed anew; ``told``: whether what
    each particle says by itself is kept."""

    still: float = 0.0
    near: float = 0.0
    told: bool = False


WHOLE = Effort()


@dataclass(frozen=True)
class Fit:
    """Particles fitted to the pixels: ``position_mm`` (n, 3), ``light`` (n,) counts; ``image``: counts of all of them,
    ``residual``, ``variance`` and ``weight``, one over the standard deviation that it counts with, of each pixel;
    ``prior``: of the particles; ``moved`` (n,): which did not rest; ``unit_mm`` (3,): of the unknowns; ``kept``: where
    light goes, where there are not too many particles to keep that; ``told`` (n, 2): as ``alone``, when each particle's
    area was left, NaN where none was fitted; none (0, 2) where it was not asked for."""

    of_points: LightOfPoints
    position_mm: Array
    light: Array
    image: Array
    residual: Array
    variance: Array
    weight: Single
    prior: Prior
    moved: NDArray[np.bool_]
    unit_mm: Array
    kept: Lights | None
    told: Array

    @cached_property
    def lights(self) -> Lights:
        """Where the light of all particles goes."""
        return self.of_points(self.position_mm) if self.kept is None else self.kept

    def lights_of(self, which: NDArray[np.int64]) -> Lights:
        """Where that of the particles ``which``, ascending, goes."""
        return self.of_points(self.position_mm[which]) if self.kept is None else _of(self.kept, which)

    def carried(self, which: NDArray[np.int64], new_mm: Array) -> Lights | None:
        """Where the light of the particles ``which`` and then of new ones at ``new_mm`` (k, 3) goes, for the next fit;
        None where it is not kept."""
        return None if self.kept is None else self.kept.with_others(which, self.of_points(new_mm))

    def normal(self, which: NDArray[np.int64] | None = None, lights: Lights | None = None) -> bsr_array:
        """The normal equations (4m, 4m) of the particles ``which`` (m,), ascending, or of all, the prior's information
        included, in units of ``unit_mm`` and of each one's light. ``lights``: of these, where they are known."""
        which = np.arange(len(self.light)) if which is None else which
        lights = self.lights_of(which) if lights is None else lights
        normal = normal_equations(lights, self.light[which], self.weight)
        with_information(normal, self.prior.of(which).information(self.unit_mm))
        return normal


def refine(
    of_points: LightOfPoints,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: Prior,
    iterations: int,
    effort: Effort = WHOLE,
    lights: Lights | None = None,
    image: Array | None = None,
    turn: int = 0,
) -> Fit:
    """Fit particles by ``iterations`` of Gauss-Newton, at most, from positions (n, 3) mm and light (n,) counts.
    ``lights``: of the positions, and ``image``: counts of all particles in each pixel, where they are known; the first
    may be changed; ``turn``: how areas are cut."""
    position, light = np.array(position_mm, np.float64), np.array(light, np.float64)
    if len(light) <= areas.TOGETHER:
        begin = position, light, prior, iterations, of_points(position) if lights is None else lights
        position, light, moved, kept = _stepped(of_points, pixels, *begin, lambda lit: np.zeros(len(lit)), effort)
        image, unit = kept.image(light, len(pixels.counts)), kept.unit_mm
        told = _told(kept, light, prior, pixels, image) if effort.told else np.empty((0, 2))
    else:
        kept, unit = None, of_points(position[:1]).unit_mm
        known = image_of(of_points, position, light, len(pixels.counts)) if image is None else image
        image, moved = known.copy(), np.zeros(len(light), bool)
        told = np.full((len(light) if effort.told else 0, 2), np.nan)
        for number, steps in enumerate(_turns(iterations)):
            fitted = partial(_of_area, of_points, pixels, position, light, prior, steps, image, effort)
            cut = areas.areas(position[:, :2], turn + number)
            for group in areas.groups(position[:, :2], cut, areas.ABOUT * unit[:2]):
                made = list(each_in_threads(fitted, group)) if len(group) > 1 else [fitted(group[0], single=True)]
                for area, (place, brighter, of_area, says, changes) in zip(group, made, strict=True):
                    position[area], light[area] = place, brighter
                    moved[area] |= of_area
                    if effort.told:
                        told[area] = says
                    for lit, counts in changes:
                        image[lit] += counts
    residual, variance = residual_of(image, pixels)
    weight, _ = pixel_weights(pixels.usable, residual, variance)
    return Fit(of_points, position, light, image, residual, variance, weight, prior, moved, unit, kept, told)


def _of_area(
    of_points: LightOfPoints,
    pixels: Pixels,
    position: Array,
    light: Array,
    prior: Prior,
    iterations: int,
    image: Array,
    effort: Effort,
    area: areas.Numbers,
    single: bool = False,
) -> tuple[Array, Array, NDArray[np.bool_], Array, list[tuple[NDArray[np.int64], Array]]]:
    """Positions and light of the particles of an ``area``, fitted among all others, of which the ``image`` is; which
    moved; what each says by itself; pixels and by how many counts they change. ``single``: no other area is fitted at
    once."""
    with nullcontext() if single else one_thread():
        own = of_points(position[area])
        lit, counts, _ = _counts(own, -light[area])

        def others(which: NDArray[np.int64]) -> Array:
            found = image[which]
            entry_kernels.add_where(lit, counts, which, found)
            return found

        begin = position[area], light[area], prior.of(area), iterations, own
        parts = PARTS if single else 1
        place, brighter, moved, own = _stepped(of_points, pixels, *begin, others, effort, parts)
        lit_after, counts_after, of_lit = _counts(own, brighter)
        says = np.empty((0, 2))
        if effort.told:
            says = _told(of_lit, brighter, prior.of(area), pixels.among(lit_after, others(lit_after)), counts_after)
        return place, brighter, moved, says, [(lit, counts), (lit_after, counts_after)]


def _told(lights: Lights, light: Array, prior: Prior, pixels: Pixels, image: Array) -> Array:
    """What particles say by themselves (n, 2), as ``alone``, of whose light the ``image`` is."""
    residual, variance = residual_of(image, pixels)
    weight, _ = pixel_weights(pixels.usable, residual, variance)
    chi2 = chi2_of(pixels.usable, residual, variance)
    return alone(lights, light, weight, chi2, prior.information(lights.unit_mm))


def _counts(lights: Lights, light: Array) -> tuple[NDArray[np.int64], Array, Lights]:
    """The pixels that particles of so much ``light`` light, their counts, and the lights in these alone."""
    lit, of_lit = lights.of_lit()
    return lit, of_lit.image(light, len(lit)), of_lit


def _turns(iterations: int) -> list[int]:
    """Iterations of each time that all areas are gone through."""
    return [min(A_TURN, iterations - done) for done in range(0, iterations, A_TURN)]


def image_of(of_points: LightOfPoints, position_mm: Array, light: Array, pixels: int) -> Array:
    """Counts in each of ``pixels`` of particles at positions (n, 3) mm and of light (n,) counts."""
    image = np.zeros(pixels)
    for area in areas.areas(position_mm[:, :2]):
        of_points(position_mm[area]).add_to(image, light[area])
    return image


def add_light(of_points: LightOfPoints, position_mm: Array, light: Array, image: Array) -> None:
    """Add to an ``image`` (pixels,) the counts of particles at positions (n, 3) mm and of light (n,) counts, some at a
    time: lists of pixels of all would take gigabytes."""
    for first in range(0, len(light), areas.TOGETHER):
        some = slice(first, first + areas.TOGETHER)
        of_points(position_mm[some]).add_to(image, light[some])


def _stepped(
    of_points: LightOfPoints,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: Prior,
    iterations: int,
    lights: Lights,
    others: Callable[[NDArray[np.int64]], Array],
    effort: Effort,
    parts: int = PARTS,
) -> tuple[Array, Array, NDArray[np.bool_], Lights]:
    """Positions, light, which moved, and where light goes after ``iterations`` of all particles together, as
    ``refine``. ``lights`` may be changed; ``others``: counts of other particles, which stay where they are, in some
    pixels (k,); ``parts``: of the particles, for threads."""
    position, light, unit = position_mm.copy(), light.copy(), lights.unit_mm
    of_priors = prior.information(unit)
    ever = np.zeros(len(light), bool)
    since = np.zeros_like(position)  # steps, in units, since a particle's light was computed
    for _ in range(iterations):
        lit, of_lit = lights.of_lit()
        seen = pixels.among(lit, others(lit))
        weight, pull = pixel_weights(seen.usable, *residual_of(of_lit.image(light, len(seen.counts)), seen))
        own, slope = own_equations(of_lit, light, weight, pull)
        slope[:, :3] += of_priors * (prior.position_mm - position) / unit
        known = with_priors(own, of_priors)
        gain = np.einsum("ni,ni->n", slope, np.linalg.solve(known, slope[:, :, None])[:, :, 0])
        which = np.flatnonzero(gain > effort.still**2)
        if len(which) == 0:
            break
        ever[which] = True
        step = step_of(of_lit, light, weight, which, own[which], of_priors[which], slope[which], parts)
        del of_lit
        moved = np.clip(step[:, :3], -LARGEST_STEP, LARGEST_STEP)
        position[which] += unit * moved
        least = LEAST_LIGHT * float(np.median(light))
        light[which] = np.maximum(light[which] * (1.0 + np.clip(step[:, 3], -0.7, 2.0)), least)
        since[which] += moved
        far = np.abs(since[which]).max(1) > effort.near
        if not far.all():
            lights = lights.shifted(which[~far], unit * moved[~far])
        if far.any():
            anew = which[far]
            since[anew] = 0.0
            lights = lights.replaced(anew, of_points(position[anew]))
    return position, light, ever, lights


def _of(lights: Lights, which: NDArray[np.int64]) -> Lights:
    """The light of the points ``which``, ascending."""
    return lights if len(which) == len(lights.start) - 1 else lights.of(which)


def fit_light(lights: Lights, pixels: Pixels, light: Array, iterations: int = 3) -> Array:
    """The light (n,) in counts that fits best where ``lights`` are; positive."""
    start = lights.start.astype(np.int32 if lights.start[-1] < 2**31 else np.int64)
    for _ in range(iterations):
        residual, variance = residual_of(lights.image(light, len(pixels.counts)), pixels)
        weight = np.where(pixels.usable, 1.0 / variance, 0.0)
        whitened, own, slope = np.empty(len(lights.pixel), np.float32), np.empty(len(light)), np.empty(len(light))
        entries = lights.start, lights.pixel, lights.share
        in_threads(normal_kernels.light_equations, len(light), *entries, weight, residual, whitened, own, slope)
        share = csr_array((whitened, lights.pixel, start), shape=(len(light), len(residual)))
        own, shape, across = np.maximum(own, 1e-30), (len(light), len(light)), share.T
        normal = LinearOperator(shape, lambda v, a=share, b=across: a @ (b @ v.astype(np.float32)), dtype=np.float64)
        alone = LinearOperator(shape, lambda v, d=own: v / d, dtype=np.float64)
        step, _ = cg(normal, slope, rtol=OF_LIGHT, maxiter=PRODUCTS, M=alone)
        light = np.maximum(light + step, LEAST_LIGHT * float(np.median(light)))
    return light


def first_light(of_points: LightOfPoints, pixels: Pixels, position_mm: Array, light: Array) -> Array:
    """The light (n,) in counts that fits best at positions (n, 3) mm, as ``fit_light``, one area after the other."""
    image, light = image_of(of_points, position_mm, light, len(pixels.counts)), light.copy()
    for area in areas.areas(position_mm[:, :2]):
        own = of_points(position_mm[area])
        own.add_to(image, -light[area])
        lit, of_lit = own.of_lit()
        light[area] = fit_light(of_lit, pixels.among(lit, image[lit]), light[area])
        own.add_to(image, light[area])
    return light


def residual_of(image: Array, pixels: Pixels) -> tuple[Array, Array]:
    """Counts that particles, of so many counts in the ``image``, do not explain, and the variance, of each pixel."""
    return np.where(pixels.usable, pixels.counts - pixels.background - image, 0.0), pixels.variance(image)


def chi2_of(usable: NDArray[np.bool_], residual: Array, variance: Array) -> Array:
    """Chi^2 of each pixel, NaN where it cannot be used."""
    return np.where(usable, residual**2 / variance, np.nan)


def pixel_weights(usable: NDArray[np.bool_], residual: Array, variance: Array) -> tuple[Single, Single]:
    """Of each pixel one over the standard deviation that it counts with, 0 where it cannot be used, and the residual in
    such standard deviations."""
    std = np.sqrt(variance)
    std *= np.sqrt(np.maximum(np.abs(residual) / std / OUTLYING, 1.0))
    weight = np.where(usable, 1.0 / std, 0.0)
    return weight.astype(np.float32), (weight * residual).astype(np.float32)
