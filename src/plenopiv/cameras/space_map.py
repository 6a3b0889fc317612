"""A smooth map between the laboratory and lens space.

*Lens space* is the object space of a thin lens in air: in it the light of a point meets the microlens plane at
s = A(z) u + B(z) x (``optics``), which is what the projection computes. The laboratory differs from it by windows and
fluids, by the distortion of the lens, by the distance between its pupils and its principal planes, and by where the
frame of the laboratory was put. A polynomial in x, y and z carries positions across, one each way, as in Soloff,
Adrian & Liu (1997), Meas. Sci. Technol. 8, 1441.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits

PLACE_POWERS = [(p, q) for p in range(4) for q in range(4 - p)]  # of s and t, in what a view's light falls beside
DEGREE = 5  # of the polynomials; windows and distortion leave 1e-5 mm at 5 (tests/cameras/test_space_map.py)


@dataclass(frozen=True)
class Polynomial:
    """Three polynomials of total degree ``degree`` in x, y, z about ``centre_mm``, in units of ``half_mm``.

    ``coefficients`` (terms, 3), in mm: of the monomials in the order of ``powers(degree)``, for each of the three
    coordinates that it gives.
    """

    centre_mm: tuple[float, float, float]
    half_mm: tuple[float, float, float]
    degree: int
    coefficients: tuple[tuple[float, float, float], ...]

    def __repr__(self) -> str:
        ranges = zip("xyz", self.centre_mm, self.half_mm, strict=True)
        limits = ", ".join(f"{name} {c - h:.4g} to {c + h:.4g}" for name, c, h in ranges)
        return f"<Polynomial of degree {self.degree} in {limits} mm>"

    @classmethod
    def fitted(cls, points_mm: ArrayLike, images_mm: ArrayLike, degree: int, weights: ArrayLike = 1.0) -> Polynomial:
        """The polynomial that carries ``points_mm`` (n, 3) to ``images_mm`` (n, 3) with the least weighted squares.

        Raises:
            PlenoPIVError: the points do not determine it.
        """
        points, images = np.asarray(points_mm, float), np.asarray(images_mm, float)
        low, high = points.min(0), points.max(0)
        half = np.where(high > low, (high - low) / 2, 1.0)
        centre = (low + high) / 2
        w = np.broadcast_to(np.asarray(weights, float), len(points))[:, None]
        terms = _monomials((points - centre) / half, degree)
        found, _, rank, _ = np.linalg.lstsq(terms * w, images * w, rcond=1e-12)
        if rank < terms.shape[1]:
            raise PlenoPIVError(
                f"{len(points)} points do not determine polynomials of degree {degree}: give more planes or more points"
            )
        return cls(_three(centre), _three(half), degree, tuple(_three(row) for row in found))

    def __call__(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Where ``points_mm`` (..., 3) lie on the other side, (..., 3)."""
        points = (np.asarray(points_mm, float) - self.centre_mm) / self.half_mm
        flat = _monomials(points.reshape(-1, 3), self.degree) @ np.array(self.coefficients)
        return flat.reshape(points.shape)

    def jacobian(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """(..., 3, 3): how image coordinate a changes with coordinate b at ``points_mm`` (..., 3), [..., a, b]."""
        points = (np.asarray(points_mm, float) - self.centre_mm) / self.half_mm
        flat, coefficients = points.reshape(-1, 3), np.array(self.coefficients)
        out = np.empty((len(flat), 3, 3))
        for b in range(3):
            out[:, :, b] = _monomials(flat, self.degree, b) @ coefficients / self.half_mm[b]
        return out.reshape(*points.shape[:-1], 3, 3)


@dataclass(frozen=True)
class ViewShift:
    """How far the light of a view falls beside that of a thin lens, on the microlens plane, as spherical aberration
    makes it: polynomials of total degree ``degree`` in the view's place (u, v) on the main lens, in units of ``u_mm``,
    and the place (s, t) on the microlens plane, in units of ``s_mm``.

    ``coefficients_mm`` (terms, 2): of ds and dt.
    """

    u_mm: float
    s_mm: float
    degree: int
    coefficients_mm: tuple[tuple[float, float], ...]

    @classmethod
    def fitted(cls, u_mm: ArrayLike, s_mm: ArrayLike, left_mm: ArrayLike, degree: int = DEGREE) -> ViewShift:
        """The polynomials nearest to ``left_mm`` (n, 2) at places ``u_mm`` and ``s_mm`` (n, 2)."""
        u, s, left = (np.asarray(v, float) for v in (u_mm, s_mm, left_mm))
        units = float(np.abs(u).max()), float(np.abs(s).max())
        found = np.linalg.lstsq(_of_view_and_place(u / units[0], s / units[1], degree), left, rcond=1e-12)[0]
        return cls(*units, degree, tuple((float(a), float(b)) for a, b in found))

    def __call__(self, u_mm: ArrayLike, s_mm: ArrayLike) -> NDArray[np.float64]:
        """(ds, dt) in mm at places (n, 2) of the main lens and (n, 2) of the microlens plane."""
        u, s = np.asarray(u_mm, float) / self.u_mm, np.asarray(s_mm, float) / self.s_mm
        return _of_view_and_place(u, s, self.degree) @ np.array(self.coefficients_mm)

    def plus(self, other: ViewShift) -> ViewShift:
        """Both shifts together."""
        degree = max(self.degree, other.degree)
        every = [p for p in product(range(degree + 1), repeat=4) if sum(p) <= degree]
        total = dict.fromkeys(every, np.zeros(2))
        for one in (self, other):
            u, s = self.u_mm / one.u_mm, self.s_mm / one.s_mm
            of_one = (p for p in every if sum(p) <= one.degree)
            for p, coefficients in zip(of_one, one.coefficients_mm, strict=True):
                total[p] = total[p] + np.array(coefficients) * u ** (p[0] + p[1]) * s ** (p[2] + p[3])
        return ViewShift(self.u_mm, self.s_mm, degree, tuple((float(a), float(b)) for a, b in total.values()))

    def of_views(self, u_mm: ArrayLike) -> NDArray[np.float32]:
        """Of views at ``u_mm`` (views, 2) the nearest sums of ``PLACE_POWERS``, s and t in mm: (views, terms, 2)."""
        axis = np.linspace(-self.s_mm, self.s_mm, 9)
        places = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
        s, t = places.T
        terms = np.linalg.pinv(np.stack([s**p * t**q for p, q in PLACE_POWERS], 1))
        views = np.asarray(u_mm, float)
        return np.array([terms @ self(np.tile(view, (len(places), 1)), places) for view in views], np.float32)


@dataclass(frozen=True)
class SpaceMap:
    """The map between laboratory and lens space, both in mm; right within the volume that it was fitted on.

    Arrays (..., 3) hold x, y, z in their last axis. ``left``: what no map of space holds, as it differs between views;
    None where that is nothing. ``growth``: by what share micro-images are wider, per mm of a microlens' s and t, as
    where the gap behind the array is; lens space has them wide by its views, not by its aperture.
    """

    to_lens: Polynomial
    to_laboratory: Polynomial
    left: ViewShift | None = None
    growth: tuple[float, float] = (0.0, 0.0)

    def __repr__(self) -> str:
        return f"<SpaceMap laboratory to lens space {self.to_lens!r}>"

    @classmethod
    def fitted(cls, laboratory_mm: ArrayLike, lens_mm: ArrayLike, degree: int = DEGREE) -> SpaceMap:
        """The map for points (n, 3) of which both positions are known; each way is fitted by itself.

        Raises:
            PlenoPIVError: the points do not determine it.
        """
        return cls(Polynomial.fitted(laboratory_mm, lens_mm, degree), Polynomial.fitted(lens_mm, laboratory_mm, degree))

    def lens_limits(self, laboratory: Limits, points: int = 9) -> Limits:
        """The box of lens space, outer faces along x, y and z, that holds a box of the laboratory."""
        axes = [np.linspace(lo, hi, points) for lo, hi in laboratory]
        found = self.to_lens(np.stack(np.meshgrid(*axes, indexing="ij"), -1)).reshape(-1, 3)
        (x0, y0, z0), (x1, y1, z1) = found.min(0).tolist(), found.max(0).tolist()
        return (x0, x1), (y0, y1), (z0, z1)


def powers(degree: int) -> NDArray[np.int64]:
    """The powers (terms, 3) of x, y, z of all monomials of total degree up to ``degree``."""
    every = [p for p in product(range(degree + 1), repeat=3) if sum(p) <= degree]
    return np.array(sorted(every, key=lambda p: (sum(p), p)))


def _monomials(points: NDArray, degree: int, derivative: int | None = None) -> NDArray[np.float64]:
    """The monomials (n, terms) at ``points`` (n, 3), or their derivatives along one coordinate."""
    out = np.ones((len(points), len(powers(degree))))
    for axis in range(3):
        power = powers(degree)[:, axis]
        column = points[:, axis : axis + 1]
        out *= power * column ** np.maximum(power - 1, 0) if axis == derivative else column**power
    return out


def _of_view_and_place(u: NDArray, s: NDArray, degree: int) -> NDArray[np.float64]:
    """All monomials (n, terms) of total degree up to ``degree`` in u, v, s and t, each (n, 2)."""
    values = np.concatenate([u, s], 1)
    every = [p for p in product(range(degree + 1), repeat=4) if sum(p) <= degree]
    of = np.stack([values**p for p in range(degree + 1)])
    return np.stack([of[a, :, 0] * of[b, :, 1] * of[c, :, 2] * of[d, :, 3] for a, b, c, d in every], 1)


def _three(values: NDArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
