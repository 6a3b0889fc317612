"""By how much the rays of each view fall beside where the calibration has them, from the particles of a frame.

Rays of lens space are s = A(z) u + B(z) x. What a calibration leaves wrong is, of each ray, a small shift on the
microlens plane: a polynomial of its view (u, v) and of its place (s, t), as ``cameras.space_map.ViewShift`` is; along a
ray it is the same at every depth, so that place and view hold the depth, too. It is fitted with all particles at once:
light that is shifted by ds is that of a particle at x + ds/B, so the derivatives of pixels by the shifts are those by x
and y, over B, times the polynomial's terms (``with_calibration`` has the rest).

Some shifts no particle tells: those that all rays of every point share with rays of another point (a displacement of
all that is seen, a scale, a shift of depth). With each point's displacement taken off, what is left of a shift is its
visible share; combinations with less than ``VISIBLE`` are not fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.ray_model import on_disc
from plenopiv.cameras.space_map import ViewShift
from plenopiv.tracking.light import LightOfPoints, PointLights
from plenopiv.tracking.refine import Fit

DEGREE = 3  # of the polynomials, in u, v, s and t together
VISIBLE = 0.3  # share, by squares, of a shift that points elsewhere do not make
EXPECTED_UM = 10.0  # of each combination: an a-priori standard deviation
SAMPLE, PLACES = 400, 61  # points, and places of the main lens, by which shifts are weighed
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
class RayShifts:
    """The shifts that a light field's particles can tell, as ``with_calibration.Calibration``: amounts are in um.
    ``blur_px``, ``left``, ``growth``: of ``PointLights``, which the shift adds to."""

    camera: PlenopticCamera
    terms: Terms
    blur_px: float | None = None
    left: ViewShift | None = None
    growth: tuple[float, float] = (0.0, 0.0)

    @property
    def expected(self) -> float:
        """Of each combination, um: an a-priori standard deviation."""
        return EXPECTED_UM

    @property
    def count(self) -> int:
        """How many combinations are fitted."""
        return self.terms.visible.shape[1]

    def lights(self, amounts: Array) -> PointLights:
        """The light of points whose rays are shifted by ``amounts`` more."""
        shift = self.terms.shift(amounts) if amounts.any() else None
        return PointLights(self.camera, self.blur_px, together(self.left, shift), self.growth)

    def slopes(self, of_points: LightOfPoints, fit: Fit, weight: Array) -> tuple[NDArray[np.int64], Array]:
        """As ``Calibration.slopes``."""
        return by_shifts(self.camera, self.terms, fit, weight)


def together(one: ViewShift | None, other: ViewShift | None) -> ViewShift | None:
    """Both shifts; None where there is neither."""
    if one is None or other is None:
        return other if one is None else one
    return one.plus(other)


def by_shifts(camera: PlenopticCamera, terms: Terms, fit: Fit, weight: Array) -> tuple[NDArray[np.int64], Array]:
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
