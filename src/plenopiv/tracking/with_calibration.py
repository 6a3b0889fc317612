"""Particles and what is wrong of a calibration, fitted to the raw pixels together.

A calibration is a little wrong by a few numbers, ``amounts``, which change the light of all particles: of one light
field the shifts of its rays (``ray_shifts``), of pinhole cameras their places and directions (``camera_changes``). A
step of Gauss and Newton is for both; positions and light are eliminated (Schur complement), so that nothing is found of
a calibration that particles elsewhere explain as well.

Source: bundle adjustment, Triggs et al. (2000), section 6.1, for the elimination; volume self-calibration, Wieneke
(2008), Exp. Fluids 45, 549, and (2018), Meas. Sci. Technol. 29, 084002, there by disparities of matched particles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.linalg import LinearOperator, cg

from plenopiv.tracking import refine as joint
from plenopiv.tracking.equations import own_blocks, own_equations
from plenopiv.tracking.light import LightOfPoints
from plenopiv.tracking.pixels import Pixels

TOLERANCE, PRODUCTS = 1e-3, 150  # of conjugate gradients
STEPS = 5
FIRST, THEN = 5, 3  # Gauss-Newton iterations of the particles alone before a step, the first one and those after it
STILL = 0.1  # of the amounts: a step that changes them by less, or by less than their standard deviation, is the last
HELPS = 0.003  # share by which chi^2 of a frame that had no part in the fit must fall
LARGEST = 16.0  # chi^2 of a pixel, as light of a particle that was not found

Array = NDArray[np.float64]
Lit = NDArray[np.int64]


class Calibration(Protocol):
    """What may be wrong of one: ``count`` orthogonal combinations, of ``expected`` root mean square each, a priori."""

    @property
    def count(self) -> int:
        """How many combinations are fitted."""

    @property
    def expected(self) -> float:
        """A-priori standard deviation of each amount."""

    def lights(self, amounts: Array) -> LightOfPoints:
        """The light of points, if the calibration is wrong by ``amounts`` (count,)."""

    def slopes(self, of_points: LightOfPoints, fit: joint.Fit, weight: Array) -> tuple[Lit, Array]:
        """The lit pixels of ``weight``, by number, and the change of their counts (pixel, count) per unit of each
        amount; ``of_points``: with the amounts of now."""


@dataclass(frozen=True)
class Seen:
    """A frame: its pixels, and where particles are first seen in it, (n, 3) mm, with their light."""

    pixels: Pixels
    position_mm: Array
    light: Array


@dataclass(frozen=True)
class Step:
    """Particles, (n, 3) mm and counts, and the ``amounts`` after a step; ``std``: standard deviation of all amounts
    together; ``chi2`` of the lit pixels before it; ``change``: of the amounts by it, root mean square."""

    position_mm: Array
    light: Array
    amounts: Array
    std: float
    chi2: float
    change: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether this step hardly changed the amounts."""
        return self.change < max(STILL * self.rms, self.std)

    @property
    def rms(self) -> float:
        """What is wrong of the calibration, root mean square."""
        return float(np.linalg.norm(self.amounts))


def settle(
    calibration: Calibration, seen: Seen, prior_std_mm: Array, done: Callable[[int], None] = lambda step: None
) -> tuple[Step, int]:
    """Steps, STEPS at the most, until the amounts hardly change; the last one, and how many there were."""
    none = np.zeros(calibration.count)
    light = joint.fit_light(calibration.lights(none)(seen.position_mm), seen.pixels, seen.light)
    prior, found, number = joint.Prior(seen.position_mm, prior_std_mm), Step(seen.position_mm, light, none, 0, 0), 0
    for number in range(1, STEPS + 1):
        iterations = THEN if number > 1 else FIRST
        found = step(calibration, seen.pixels, found.position_mm, found.light, prior, found.amounts, iterations)
        done(number)
        if found.settled:
            break
    return found, number


def misfit(of_points: LightOfPoints, seen: Seen) -> float:
    """chi^2 per lit pixel of particles fitted to a frame."""
    light = joint.fit_light(of_points(seen.position_mm), seen.pixels, seen.light)
    prior = joint.Prior(seen.position_mm, of_points.prior_std_mm)
    fit = joint.refine(of_points, seen.pixels, seen.position_mm, light, prior, FIRST)
    lit = np.zeros(fit.residual.size, bool)
    lit[fit.lights.pixel] = True
    lit &= seen.pixels.usable
    return float(np.mean(np.minimum(fit.residual[lit] ** 2 / fit.variance[lit], LARGEST)))


def step(
    calibration: Calibration,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: joint.Prior,
    before: Array,
    iterations: int,
) -> Step:
    """One step of Gauss and Newton for particles and calibration together, after ``iterations`` of the particles alone.
    ``before``: the amounts of now; ``prior``: of the particles, as for ``tracking.refine.refine``."""
    of_points = calibration.lights(before)
    fit = joint.refine(of_points, pixels, position_mm, light, prior, iterations)
    light, lights = fit.light, fit.lights
    single, residual = joint.pixel_weights(pixels.usable, fit.residual, fit.variance)
    weight = single.astype(np.float64) ** 2
    lit, slopes = calibration.slopes(of_points, fit, weight)
    weighted = slopes * weight[lit][:, None]
    of_amounts, pull = slopes.T @ weighted, weighted.T @ fit.residual[lit]
    _, slope = own_equations(lights, light, single, residual)
    unit = lights.unit_mm
    slope[:, :3] += prior.information(unit) * (prior.position_mm - fit.position_mm) / unit
    coupling = _coupling(fit, weighted, lit, weight.size)
    normal = fit.normal()
    solve = _solver(normal, own_blocks(normal))
    per_amount = np.stack([solve(column) for column in coupling.T], 1)
    alone = solve(slope.ravel())
    reduced = of_amounts - coupling.T @ per_amount
    reduced = 0.5 * (reduced + reduced.T) + np.eye(len(reduced)) / calibration.expected**2
    found = np.linalg.solve(reduced, pull - coupling.T @ alone - before / calibration.expected**2)
    moved = (alone - per_amount @ found).reshape(-1, 4)
    position = fit.position_mm + unit * np.clip(moved[:, :3], -joint.LARGEST_STEP, joint.LARGEST_STEP)
    least = joint.LEAST_LIGHT * float(np.median(light))
    brighter = np.maximum(light * (1.0 + np.clip(moved[:, 3], -0.7, 2.0)), least)
    std = float(np.sqrt(np.trace(np.linalg.inv(reduced))))
    chi2 = float(np.mean(fit.residual[lit] ** 2 / fit.variance[lit]))
    return Step(position, brighter, before + found, std, chi2, float(np.linalg.norm(found)))


def _coupling(fit: joint.Fit, weighted: Array, lit: Lit, pixels: int) -> Array:
    """Weighted products of what pixels change by, per unknown of each particle and per amount: (4 particles, count)."""
    lights, n = fit.lights, len(fit.light)
    place = np.full(pixels, -1)
    place[lit] = np.arange(lit.size)
    column = place[lights.pixel]
    used, point = column >= 0, lights.point
    out = np.empty((4 * n, weighted.shape[1]))
    for k in range(4):
        change = lights.share if k == 3 else lights.gradient[:, k] * lights.unit_mm[k]
        value = (change * fit.light[point])[used]
        out[k::4] = csr_array((value, (point[used], column[used])), shape=(n, lit.size)) @ weighted
    return out


def _solver(normal: bsr_array, own: Array) -> Callable[[Array], Array]:
    """What solves the particles' equations, little damped, for one right side (4 particles,)."""
    little = 1e-6 * np.einsum("nii->ni", own) + 1e-12
    inverse = np.linalg.inv(own + little[:, :, None] * np.eye(4))
    shape, n = normal.shape, len(own)
    matrix = LinearOperator(shape, lambda v: normal @ v + little.ravel() * v.ravel())
    first = LinearOperator(shape, lambda v: np.einsum("nij,nj->ni", inverse, v.reshape(n, 4)).ravel())
    return lambda right: np.asarray(cg(matrix, right, rtol=TOLERANCE, maxiter=PRODUCTS, M=first)[0])
