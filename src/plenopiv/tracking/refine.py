"""Joint Gauss-Newton of particles on raw pixels.

Pixel p expects  mu_p = background + sum_i E_i w_p(x_i)  counts and scatters with V_p = noise + gain * mu_p. Positions
and light minimise

    chi^2 = sum_p (counts_p - mu_p)^2 / V_p + sum_i |(x_i - prior_i) / prior std|^2 .

Each iteration asks by how much chi^2 falls where a particle moves alone, a sum over its pixels. Those that would gain
less than STILL^2 rest: their light is known from before. The others move together: the normal equations couple
particles that share pixels by 4 x 4 blocks, so the matrix is sparse, and conjugate gradients with each particle's own
block as preconditioner need a few tens of products; their exact light and its derivatives are computed anew. The prior
keeps particles in the dead zone, whose depth no pixel tells, where they were first seen; it is wide against the error
of any other.

Source: Bjorck, *Numerical Methods for Least Squares Problems* (1996), sections 7.4 and 9.2; the same normal equations
are the Fisher information of ``accuracy.bound``, so their inverse is the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array
from scipy.sparse.linalg import LinearOperator, cg

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.threads import in_threads
from plenopiv.tracking import normal_kernels
from plenopiv.tracking.light import Lights, PointLights
from plenopiv.tracking.pixels import Pixels

Array = NDArray[np.float64]
Single = NDArray[np.float32]
UNIT_MM = np.array([0.01, 0.01, 0.05])  # of the unknowns, so that all of a particle's information is of one order
TOLERANCE, PRODUCTS = 1e-3, 80  # of conjugate gradients: the next iteration is a better one
DAMPING = 1e-3  # of each particle's own information (Levenberg-Marquardt)
LEAST_KNOWN = 1e-12  # information added to a particle's, of whose light no pixel is used
LARGEST_STEP = np.array([1.2, 1.2, 1.6])  # units: farther the derivatives do not hold
OUTLYING = 4.0  # standard deviations from which on pixels count less, as light of a particle not yet found (Huber 1981)
LEAST_LIGHT = 1e-3  # of the median: light stays positive


@dataclass(frozen=True)
class Prior:
    """Where particles were first seen, or are predicted to be, (n, 3) mm, and how well that is known in the least:
    ``std_mm`` (3,) or (n, 3)."""

    position_mm: Array
    std_mm: Array

    @property
    def information(self) -> Array:
        """(n, 3), in UNIT_MM^-2."""
        return np.broadcast_to((UNIT_MM / self.std_mm) ** 2, self.position_mm.shape)

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
class Fit:
    """Particles fitted to the pixels: ``position_mm`` (n, 3), ``light`` (n,) counts; ``normal`` (4n, 4n), the normal
    equations in units of UNIT_MM and of each one's light; ``lights``: where their light goes."""

    position_mm: Array
    light: Array
    normal: bsr_array
    lights: Lights
    residual: Array
    variance: Array


def prior_std_mm(camera: PlenopticCamera) -> Array:
    """Standard deviations (3,) of a particle somewhere in a dead zone: even within a microlens' cell, as the focal
    plane sees it, and within the zone's depth."""
    across = camera.lattice.pitch_mm / abs(camera.main_lens.magnification) / 12.0**0.5
    low, high = camera.dead_zone_mm()
    return np.array([across, across, 0.5 * (high - low) / 3.0**0.5])


def refine(
    of_points: PointLights,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: Prior,
    iterations: int,
    lights: Lights | None = None,
    still: float = 0.0,
    near: float = 0.0,
) -> Fit:
    """Fit particles by ``iterations`` of Gauss-Newton, at most, from positions (n, 3) mm and light (n,) counts.
    ``lights``: of the positions, where it is known; ``still``: the root of chi^2 that a particle must gain to move;
    ``near``: units of UNIT_MM within which light follows its derivatives, without being computed anew."""
    lights = of_points(position_mm) if lights is None else lights
    position, light, lights = stepped(
        of_points, pixels, position_mm, light, prior, iterations, lights, still=still, near=near
    )
    residual, variance = residual_of(lights, pixels, light)
    weight, _ = pixel_weights(pixels.usable, residual, variance)
    normal = normal_equations(lights, light, weight)
    with_prior(normal, prior)
    return Fit(position, light, normal, lights, residual, variance)


def stepped(
    of_points: PointLights,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: Prior,
    iterations: int,
    lights: Lights,
    *,
    still: float,
    near: float,
    tolerance: float = TOLERANCE,
) -> tuple[Array, Array, Lights]:
    """Positions, light and where it goes after ``iterations``, as ``refine``; ``tolerance``: of conjugate gradients."""
    position, light = position_mm.copy(), light.copy()
    since = np.zeros_like(position)  # steps, in units, since a particle's light was computed
    for _ in range(iterations):
        residual, variance = residual_of(lights, pixels, light)
        weight, pull = pixel_weights(pixels.usable, residual, variance)
        own, slope = own_equations(lights, light, weight, pull)
        slope[:, :3] += prior.information * (prior.position_mm - position) / UNIT_MM
        known = own + LEAST_KNOWN * np.eye(4)
        for axis in range(3):
            known[:, axis, axis] += prior.information[:, axis]
        gain = np.einsum("ni,ni->n", slope, np.linalg.solve(known, slope[:, :, None])[:, :, 0])
        which = np.flatnonzero(gain > still**2)
        if len(which) == 0:
            break
        some = lights if len(which) == len(light) else lights.of(which)
        normal = normal_equations(some, light[which], weight)
        step = _solved(normal, with_prior(normal, prior.of(which)), slope[which], tolerance)
        moved = np.clip(step[:, :3], -LARGEST_STEP, LARGEST_STEP)
        position[which] += UNIT_MM * moved
        least = LEAST_LIGHT * float(np.median(light))
        light[which] = np.maximum(light[which] * (1.0 + np.clip(step[:, 3], -0.7, 2.0)), least)
        since[which] += moved
        far = np.abs(since[which]).max(1) > near
        if not far.all():
            lights = lights.shifted(which[~far], UNIT_MM * moved[~far])
        if far.any():
            since[which[far]] = 0.0
            lights = lights.replaced(which[far], of_points(position[which[far]]))
    return position, light, lights


def fit_light(lights: Lights, pixels: Pixels, light: Array, iterations: int = 3) -> Array:
    """The light (n,) in counts that fits best where ``lights`` are; positive."""
    for _ in range(iterations):
        residual, variance = residual_of(lights, pixels, light)
        weight = np.where(pixels.usable, 1.0 / variance, 0.0)[lights.pixel]
        share = bsr_array(
            ((lights.share * np.sqrt(weight)).astype(np.float32)[:, None, None], lights.pixel, lights.start),
            shape=(len(light), len(residual)),
        ).tocsr()
        normal = (share @ share.T).tocsr()
        slope = np.bincount(lights.point, lights.share * weight * residual[lights.pixel], len(light))
        own = np.maximum(normal.diagonal(), 1e-30).astype(np.float64)
        step, _ = cg(
            normal, slope, rtol=TOLERANCE, maxiter=PRODUCTS, M=LinearOperator(normal.shape, lambda v, d=own: v / d)
        )
        light = np.maximum(light + step, LEAST_LIGHT * float(np.median(light)))
    return light


def residual_of(lights: Lights, pixels: Pixels, light: Array) -> tuple[Array, Array]:
    """Counts that particles do not explain, and the variance, of each pixel."""
    expected = lights.image(light, len(pixels.counts))
    return np.where(pixels.usable, pixels.counts - pixels.background - expected, 0.0), pixels.variance(expected)


def pixel_weights(usable: NDArray[np.bool_], residual: Array, variance: Array) -> tuple[Single, Single]:
    """Of each pixel one over the standard deviation that it counts with, 0 where it cannot be used, and the residual in
    such standard deviations."""
    std = np.sqrt(variance)
    std *= np.sqrt(np.maximum(np.abs(residual) / std / OUTLYING, 1.0))
    weight = np.where(usable, 1.0 / std, 0.0)
    return weight.astype(np.float32), (weight * residual).astype(np.float32)


def own_equations(lights: Lights, light: Array, weight: Single, pull: Single) -> tuple[Array, Array]:
    """Each particle's own block (n, 4, 4) of the normal equations, pixels that two of its microlenses light taken as
    two, and the right side (n, 4)."""
    own, slope = np.empty((len(light), 4, 4)), np.empty((len(light), 4))
    entries = lights.start, lights.pixel, lights.share, lights.gradient
    in_threads(normal_kernels.own_equations, len(light), *entries, light, UNIT_MM, weight, pull, own, slope)
    return own, slope


def normal_equations(lights: Lights, light: Array, weight: Single) -> bsr_array:
    """The normal equations (4n, 4n) of particles, in blocks."""
    n, m = len(light), len(lights.pixel)
    pixel_end = np.zeros(len(weight), np.int64)
    rank, particle, whitened = np.empty(m, np.int32), np.empty(m, np.int32), np.empty((m, 4), np.float32)
    normal_kernels.by_pixels(lights.start, lights.pixel, pixel_end, rank, particle)
    entries = lights.start, lights.pixel, lights.share, lights.gradient
    in_threads(normal_kernels.whiten, n, *entries, light, UNIT_MM, weight, rank, whitened)
    count, shared = np.empty(n, np.int64), (lights.start, lights.pixel, pixel_end, rank, particle)
    in_threads(normal_kernels.count_later, n, *shared, count)
    later_start = np.concatenate([[0], np.cumsum(count)])
    later, of_later = np.empty(later_start[-1], np.int32), np.zeros((later_start[-1], 4, 4), np.float32)
    in_threads(normal_kernels.sum_later, n, *shared, whitened, later_start, later, of_later)
    both, block_start = 2 * int(later_start[-1]) - n, np.zeros(n + 1, np.int64)
    neighbour, block = np.empty(both, np.int32), np.empty((both, 4, 4), np.float32)
    normal_kernels.both_ways(later_start, later, of_later, block_start, neighbour, block)
    return bsr_array((block, neighbour, block_start), shape=(4 * n, 4 * n))


def _diagonal(normal: bsr_array) -> NDArray[np.int64]:
    """Which of the blocks are the particles' own."""
    row = np.repeat(np.arange(normal.indptr.size - 1), np.diff(normal.indptr))
    return np.flatnonzero(row == normal.indices)


def with_prior(normal: bsr_array, prior: Prior) -> Array:
    """Add the prior's information to the equations, in place; the particles' own blocks (n, 4, 4)."""
    own = _diagonal(normal)
    for axis in range(3):
        normal.data[own, axis, axis] += prior.information[:, axis]
    return np.asarray(normal.data[own], np.float64)


def _solved(normal: bsr_array, own: Array, slope: Array, tolerance: float) -> Array:
    """The step (n, 4), in units, that solves the damped equations."""
    diagonal = np.einsum("nii->ni", own)
    damping = DAMPING * diagonal + LEAST_KNOWN
    inverse = np.linalg.inv(own + damping[:, :, None] * np.eye(4))
    n = len(own)

    def times(v: Array) -> Array:
        return np.asarray(normal @ v.astype(np.float32)) + damping.ravel() * v.ravel()

    def precondition(v: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", inverse, v.reshape(n, 4))).ravel()

    shape = (4 * n, 4 * n)
    step, _ = cg(
        LinearOperator(shape, times),
        slope.ravel(),
        rtol=tolerance,
        maxiter=PRODUCTS,
        M=LinearOperator(shape, precondition),
    )
    return np.asarray(step, np.float64).reshape(n, 4)
