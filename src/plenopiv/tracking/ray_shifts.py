"""By how much the rays of each view fall beside where the calibration has them, from the particles of a frame.

Rays of lens space are s = A(z) u + B(z) x. What a calibration leaves wrong is, of each ray, a small shift on the
microlens plane: a polynomial of its view (u, v) and of its place (s, t), as ``cameras.space_map.ViewShift`` is; along a
ray it is the same at every depth, so that place and view hold the depth, too. It is fitted with all particles at once:
light that is shifted by ds is that of a particle at x + ds/B, so the derivatives of pixels by the shifts are those by x
and y, over B, times the polynomial's terms. Positions and light are eliminated (Schur complement), so that no shift is
found that particles elsewhere explain as well.

Some shifts no particle tells: those that all rays of every point share with rays of another point (a displacement of
all that is seen, a scale, a shift of depth). With each point's displacement taken off, what is left of a shift is its
visible share; combinations with less than ``VISIBLE`` are not fitted.

Source: volume self-calibration, Wieneke (2008), Exp. Fluids 45, 549, and (2018), Meas. Sci. Technol. 29, 084002, there
by disparities of matched particles; bundle adjustment, Triggs et al. (2000), section 6.1, for the elimination.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.linalg import LinearOperator, cg

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.ray_model import on_disc
from plenopiv.cameras.space_map import ViewShift
from plenopiv.tracking import refine as joint
from plenopiv.tracking.equations import own_blocks, own_equations
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.pixels import Pixels

DEGREE = 3  # of the polynomials, in u, v, s and t together
VISIBLE = 0.3  # share, by squares, of a shift that points elsewhere do not make
EXPECTED_UM = 10.0  # of each combination: an a-priori standard deviation
SAMPLE, PLACES = 400, 61  # points, and places of the main lens, by which shifts are weighed
TOLERANCE, PRODUCTS = 1e-3, 150  # of conjugate gradients
UM = 1e-3  # mm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Terms:
    """Monomials u^a v^b s^c t^d, ``powers`` (terms, 4), of places on the main lens in units of ``u_mm`` and on the
    microlens plane in units of ``s_mm``; and the combinations of them, ``visible`` (2 terms, n), first of ds, then of
    dt, that are fitted: orthogonal, each 1 um RMS. ``hidden``: how many are not."""

    powers: tuple[tuple[int, int, int, int], ...]
    u_mm: float
    s_mm: float
    visible: Array
    hidden: int

    def values(self, u_mm: Array, s_mm: Array) -> Array:
        """The monomials (n, terms) of rays at ``u_mm`` and ``s_mm`` (n, 2)."""
        return monomials(self.powers, u_mm / self.u_mm, s_mm / self.s_mm)

    def shift(self, amounts_um: Array) -> ViewShift:
        """The shift that is the sum of ``amounts_um`` of the visible combinations."""
        found = UM * (self.visible @ amounts_um).reshape(2, -1).T
        return ViewShift(self.u_mm, self.s_mm, DEGREE, tuple((float(a), float(b)) for a, b in found))


def monomials(powers: tuple[tuple[int, int, int, int], ...], u: Array, s: Array) -> Array:
    """Products of powers of u, v, s and t, (n, terms)."""
    of = np.concatenate([u, s], 1)
    raised = np.stack([of**p for p in range(DEGREE + 1)])
    return np.stack([raised[a, :, 0] * raised[b, :, 1] * raised[c, :, 2] * raised[d, :, 3] for a, b, c, d in powers], 1)


def visible_terms(camera: PlenopticCamera, points_mm: Array) -> Terms:
    """The shifts that particles at ``points_mm`` (n, 3) of lens space can tell."""
    sensor, radius = camera.sensor, 0.5 * camera.main_lens.aperture_mm
    half = 0.5 * sensor.pixel_pitch_mm * np.array([sensor.columns, sensor.rows])
    powers = tuple(
        (a, b, c, d)
        for a in range(DEGREE + 1)
        for b in range(DEGREE + 1 - a)
        for c in range(DEGREE + 1 - a - b)
        for d in range(DEGREE + 1 - a - b - c)
    )
    some = points_mm[:: max(1, len(points_mm) // SAMPLE)]
    u, n = on_disc(radius, PLACES), 2 * len(powers)
    every, left = np.zeros((n, n)), np.zeros((n, n))
    rays = 0
    for (x, y), spread, scale in zip(some[:, :2], camera.spread(some[:, 2]), camera.scale(some[:, 2]), strict=True):
        s = spread * u + scale * np.array([x, y])
        seen = (np.abs(s) < half).all(1)
        if np.count_nonzero(seen) < PLACES // 2:
            continue
        rays += int(np.count_nonzero(seen))
        shift = np.kron(np.eye(2), monomials(powers, u[seen] / radius, s[seen] / half.max()))
        ones, none = np.ones(seen.sum()), np.zeros(seen.sum())
        elsewhere = np.stack([np.r_[ones, none], np.r_[none, ones], u[seen].T.ravel()], 1)  # along x, y and z
        basis = np.linalg.qr(elsewhere)[0]
        rest = shift - basis @ (basis.T @ shift)
        every, left = every + shift.T @ shift, left + rest.T @ rest
    every /= max(rays, 1)
    left /= max(rays, 1)
    share, combined = eigh(left, every + 1e-9 * np.trace(every) / n * np.eye(n))
    kept = share > VISIBLE
    return Terms(powers, radius, float(half.max()), combined[:, kept], int(np.count_nonzero(~kept)))


@dataclass(frozen=True)
class Step:
    """Particles, (n, 3) mm and counts, and the shift, in ``amounts_um`` of ``Terms.visible``, after a step; standard
    deviation of the whole shift, um RMS; ``chi2`` of the lit pixels before it."""

    position_mm: Array
    light: Array
    amounts_um: Array
    std_um: float
    chi2: float

    @property
    def rms_um(self) -> float:
        """The shift's root mean square over all rays."""
        return float(np.linalg.norm(self.amounts_um))


def step(
    of_points: PointLights,
    pixels: Pixels,
    position_mm: Array,
    light: Array,
    prior: joint.Prior,
    terms: Terms,
    before_um: Array,
    iterations: int,
) -> Step:
    """One step of Gauss and Newton for particles and shift together, after ``iterations`` of the particles alone.
    ``of_points``: with the shift of ``before_um``; ``prior``: of the particles, as for ``tracking.refine.refine``."""
    fit = joint.refine(of_points, pixels, position_mm, light, prior, iterations)
    light, lights = fit.light, fit.lights
    single, residual = joint.pixel_weights(pixels.usable, fit.residual, fit.variance)
    weight = single.astype(np.float64) ** 2
    lit, slopes = by_shifts(of_points.camera, terms, fit, weight)
    weighted = slopes * weight[lit][:, None]
    of_shift, pull = slopes.T @ weighted, weighted.T @ fit.residual[lit]
    _, slope = own_equations(lights, light, single, residual)
    unit = lights.unit_mm
    slope[:, :3] += prior.information(unit) * (prior.position_mm - fit.position_mm) / unit
    coupling = _coupling(fit, weighted, lit, weight.size)
    normal = fit.normal()
    solve = _solver(normal, own_blocks(normal))
    per_shift = np.stack([solve(column) for column in coupling.T], 1)
    alone = solve(slope.ravel())
    reduced = of_shift - coupling.T @ per_shift
    reduced = 0.5 * (reduced + reduced.T) + np.eye(len(reduced)) / EXPECTED_UM**2
    found = np.linalg.solve(reduced, pull - coupling.T @ alone - before_um / EXPECTED_UM**2)
    moved = (alone - per_shift @ found).reshape(-1, 4)
    position = fit.position_mm + unit * np.clip(moved[:, :3], -joint.LARGEST_STEP, joint.LARGEST_STEP)
    least = joint.LEAST_LIGHT * float(np.median(light))
    brighter = np.maximum(light * (1.0 + np.clip(moved[:, 3], -0.7, 2.0)), least)
    std = float(np.sqrt(np.trace(np.linalg.inv(reduced))))
    chi2 = float(np.mean(fit.residual[lit] ** 2 / fit.variance[lit]))
    return Step(position, brighter, before_um + found, std, chi2)


def by_shifts(camera: PlenopticCamera, terms: Terms, fit: joint.Fit, weight: Array) -> tuple[NDArray[np.int64], Array]:
    """The lit pixels of weight, by number, and the change of their counts (pixel, n) per um of each visible shift."""
    sensor, e, lights = camera.sensor, camera.image_scale, fit.lights
    each = (fit.light / camera.scale(fit.position_mm[:, 2]))[lights.point]
    along = [np.bincount(lights.pixel, each * lights.gradient[:, axis], weight.size) for axis in (0, 1)]
    lit = np.flatnonzero((weight > 0) & ((along[0] != 0) | (along[1] != 0)))
    x, y = sensor.plane_from_pixel(lit % sensor.columns, lit // sensor.columns)
    s, t = camera.lattice.centres(*camera.lattice.nearest(x / (1 + e), y / (1 + e)))
    u = -np.stack([x - s * (1 + e), y - t * (1 + e)], 1) / e  # a micro-image shows the main lens inverted
    values, half = terms.values(u, np.stack([s, t], 1)), len(terms.powers)
    of_s, of_t = values @ terms.visible[:half], values @ terms.visible[half:]
    return lit, UM * (along[0][lit][:, None] * of_s + along[1][lit][:, None] * of_t)


def _coupling(fit: joint.Fit, weighted: Array, lit: NDArray[np.int64], pixels: int) -> Array:
    """Weighted products of what pixels change by, per unknown of each particle and per shift: (4 particles, n)."""
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
