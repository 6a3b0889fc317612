"""Square and hexagonal lattices of microlenses.

A lattice lives on the microlens plane with coordinates ``(s, t)`` in mm, the optical axis at the origin. Lens
``(i, j)`` is number ``i`` of row ``j``. Before the rotation the rows run along s (which is along the object's x):

    square      s = i,            t = j               (in pitches)
    hexagonal   s = i + (j % 2)/2,  t = j sqrt(3)/2   odd rows are shifted by half a pitch

The rotation is counter-clockwise in (s, t) about lens (0, 0), which sits at ``offset_mm``.

Real arrays are a little stretched, sheared and distorted: a ``LatticeMap`` moves the centres of the regular lattice to
where they are. It is a map of the plane, so that it stays as it is when lenses are numbered in another way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, degrees, pi, sin, sqrt
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError, check_positive

LatticeKind = Literal["square", "hexagonal"]
ROW_SPACING = {"square": 1.0, "hexagonal": sqrt(3.0) / 2.0}  # in pitches
CELL_AREA = ROW_SPACING  # area of one cell in pitches squared: one lens per pitch along a row


CLOSE_MM = 1e-9  # at which the inverse of a map ends
STEPS = 8  # of the inverse of a map: each leaves the map's largest gradient, at most some percent, of the last error


@dataclass(frozen=True)
class LatticeMap:
    """How far an array departs from a regular lattice: a centre of the lattice at (s, t) is moved by polynomials of s
    and t of total degree ``degree``, without a constant term, so that nothing moves on the optical axis.

    ``coefficients_mm``: (ds, dt) of the monomials of s and t, both in units of ``unit_mm``, in the order of ``powers``.
    """

    degree: int
    unit_mm: float
    coefficients_mm: tuple[tuple[float, float], ...]

    def displacement(self, s_mm: ArrayLike, t_mm: ArrayLike) -> tuple[NDArray, NDArray]:
        """(ds, dt) in mm of centres of the regular lattice at (s, t) in mm."""
        u, v = np.asarray(s_mm, float) / self.unit_mm, np.asarray(t_mm, float) / self.unit_mm
        ds, dt = np.zeros(np.broadcast(u, v).shape), np.zeros(np.broadcast(u, v).shape)
        of = [(np.ones_like(u), np.ones_like(v))]  # powers by products: NumPy's power takes forty times as long
        for _ in range(self.degree):
            of.append((of[-1][0] * u, of[-1][1] * v))
        for (p, q), (a, b) in zip(powers(self.degree), self.coefficients_mm, strict=True):
            term = of[p][0] * of[q][1]
            ds, dt = ds + a * term, dt + b * term
        return ds, dt

    def regular(self, s_mm: ArrayLike, t_mm: ArrayLike) -> tuple[NDArray, NDArray]:
        """The inverse: where on the regular lattice the points lie that are moved to (s, t), all in mm."""
        s, t = np.asarray(s_mm, float), np.asarray(t_mm, float)
        at = s, t
        for _ in range(STEPS):
            ds, dt = self.displacement(*at)
            before, at = at, (s - ds, t - dt)
            if max(np.abs(at[0] - before[0]).max(initial=0), np.abs(at[1] - before[1]).max(initial=0)) < CLOSE_MM:
                break
        return at

    def moved(self, shift_mm: complex, by: complex) -> tuple[LatticeMap, complex]:
        """The map of an array that was turned and stretched by ``by`` about the optical axis, then shifted, and how
        much further its regular lattice is shifted, mm: what it moves on the axis belongs there."""

        def displaced(at: NDArray[np.complex128]) -> NDArray[np.complex128]:
            """Displacement of points of the regular lattice that lie at ``at`` after the motion."""
            was = (at - shift_mm) / by
            ds, dt = self.displacement(was.real, was.imag)
            return np.asarray(by * (ds + 1j * dt))

        more = 0j
        for _ in range(STEPS):
            more = complex(displaced(np.array([-more]))[0])
        size = np.linspace(-1.0, 1.0, 2 * self.degree + 3)
        u, v = (each.ravel() for each in np.meshgrid(size, size))
        found = displaced(np.asarray((u + 1j * v) * self.unit_mm - more, np.complex128)) - more
        terms = np.stack([u**p * v**q for p, q in powers(self.degree)], -1)
        fitted = np.linalg.lstsq(terms.astype(complex), found, rcond=None)[0]
        return replace(self, coefficients_mm=tuple((float(c.real), float(c.imag)) for c in fitted)), more


def powers(degree: int) -> list[tuple[int, int]]:
    """Powers (of s, of t) of the monomials of total degree 1 to ``degree``: s, t, s^2, s t, t^2, s^3, ..."""
    return [(total - q, q) for total in range(1, degree + 1) for q in range(total + 1)]


@dataclass(frozen=True)
class Lattice:
    """Where the microlenses are. Lengths in mm, rotation in rad (counter-clockwise in (s, t)).

    ``pitch_mm`` is the distance of lenses along the rows. ``map``: what moves the centres of the regular lattice that
    the other numbers describe; None for a regular array. Raises PlenoPIVError for another kind, and a pitch that is not
    positive.
    """

    kind: LatticeKind
    pitch_mm: float
    rotation_rad: float = 0.0
    offset_mm: tuple[float, float] = (0.0, 0.0)
    map: LatticeMap | None = None

    def __post_init__(self) -> None:
        if self.kind not in ROW_SPACING:
            raise PlenoPIVError(f'lattice: kind = {self.kind!r}, give "square" or "hexagonal"')
        check_positive("lattice", pitch_mm=self.pitch_mm)
        if np.shape(self.offset_mm) != (2,) or not np.isfinite([self.rotation_rad, *self.offset_mm]).all():
            raise PlenoPIVError(
                f"lattice: rotation_rad = {self.rotation_rad}, offset_mm = {self.offset_mm}; give a number, and (s, t)"
            )

    def __repr__(self) -> str:
        bent = "" if self.map is None else f", distorted by polynomials of degree {self.map.degree}"
        return (
            f"<Lattice {self.kind}, pitch {self.pitch_mm:g} mm, turned by {degrees(self.rotation_rad):.4g} deg{bent}>"
        )

    @property
    def row_spacing(self) -> float:
        """Distance between rows, in pitches: 1 (square) or sqrt(3)/2 (hexagonal)."""
        return ROW_SPACING[self.kind]

    @property
    def cell_area_mm2(self) -> float:
        """Area of the microlens plane that one lens covers."""
        return CELL_AREA[self.kind] * self.pitch_mm**2

    @property
    def turn_rad(self) -> float:
        """Angle between the rows and the nearer axis of the sensor, -pi/4 to pi/4."""
        return self.rotation_rad - pi / 2 * round(self.rotation_rad / (pi / 2))

    def aligned(self) -> Lattice:
        """The same lenses, numbered along the rows that are nearest to an axis of the sensor.

        A hexagonal lattice looks the same turned by 60 degrees: its rows are within 15 degrees of s or of t.
        """
        step = pi / 2 if self.kind == "square" else pi / 3
        same = [replace(self, rotation_rad=self.rotation_rad + k * step) for k in (0, 1, -1, 2, -2, 3, -3)]
        return min(same, key=lambda lattice: (round(abs(lattice.turn_rad), 9), abs(lattice.rotation_rad)))

    def centres(self, i: ArrayLike, j: ArrayLike) -> tuple[NDArray, NDArray]:
        """Centres (s, t) in mm of lenses (i, j); any broadcastable integer arrays."""
        s, t = self.regular_centres(i, j)
        if self.map is None:
            return s, t
        ds, dt = self.map.displacement(s, t)
        return s + ds, t + dt

    def scaled(self, factor: float) -> Lattice:
        """The same lenses, all ``factor`` times as far from the optical axis."""
        s, t = self.offset_mm
        moved = None
        if self.map is not None:
            coefficients = tuple((a * factor, b * factor) for a, b in self.map.coefficients_mm)
            moved = replace(self.map, unit_mm=self.map.unit_mm * factor, coefficients_mm=coefficients)
        return replace(self, pitch_mm=self.pitch_mm * factor, offset_mm=(s * factor, t * factor), map=moved)

    def moved(self, shift_mm: tuple[float, float], turn_rad: float = 0.0, scale: float = 0.0) -> Lattice:
        """The same lenses, turned counter-clockwise in (s, t) about the optical axis, 1 + ``scale`` times as far from
        it, and then shifted by ``shift_mm`` in s and t."""
        by, shift = (1.0 + scale) * complex(cos(turn_rad), sin(turn_rad)), complex(*shift_mm)
        offset = shift + by * complex(*self.offset_mm)
        bent = None
        if self.map is not None:
            bent, more = self.map.moved(shift, by)
            offset += more
        return Lattice(
            self.kind, self.pitch_mm * abs(by), self.rotation_rad + turn_rad, (offset.real, offset.imag), bent
        )

    def regular_centres(self, i: ArrayLike, j: ArrayLike) -> tuple[NDArray, NDArray]:
        """``centres`` before ``map`` moves them."""
        i, j = np.asarray(i), np.asarray(j)
        half = 0.5 * (j & 1) if self.kind == "hexagonal" else 0.0
        a, b = (i + half) * self.pitch_mm, j * (self.row_spacing * self.pitch_mm)
        c, s = cos(self.rotation_rad), sin(self.rotation_rad)
        return self.offset_mm[0] + c * a - s * b, self.offset_mm[1] + s * a + c * b

    def coordinates(self, s_mm: ArrayLike, t_mm: ArrayLike) -> tuple[NDArray, NDArray]:
        """Points (s, t) in mm as lattice coordinates (along rows, across rows), in pitches from lens (0, 0), of the
        regular lattice."""
        if self.map is not None:
            s_mm, t_mm = self.map.regular(s_mm, t_mm)
        a, b = np.asarray(s_mm) - self.offset_mm[0], np.asarray(t_mm) - self.offset_mm[1]
        c, s = cos(self.rotation_rad), sin(self.rotation_rad)
        return (c * a + s * b) / self.pitch_mm, (c * b - s * a) / self.pitch_mm

    def nearest(self, s_mm: ArrayLike, t_mm: ArrayLike) -> tuple[NDArray, NDArray]:
        """The lens (i, j) whose cell holds each point (s, t) in mm."""
        i, j = nearest_lens(self.kind == "hexagonal", self.row_spacing, *self.coordinates(s_mm, t_mm))
        return i.astype(np.int64), j.astype(np.int64)


def nearest_lens(hexagonal: bool, row_spacing: float, a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """The lens (i, j), whole numbers in floating point, whose cell holds lattice coordinates (a, b) in pitches.

    Of a hexagonal lattice it is the nearer of two, one in the row below the point and one in the row above. Arithmetic
    alone, so that it takes arrays here and is compiled for single numbers by ``plenopiv.kernels`` where candidates are
    judged.
    """
    if not hexagonal:
        return np.rint(a), np.rint(b)
    low = np.floor(b / row_spacing)
    low_shift = 0.5 * (low - 2.0 * np.floor(0.5 * low))  # odd rows are shifted by half a pitch
    high, high_shift = low + 1.0, 0.5 - low_shift
    low_i, high_i = np.rint(a - low_shift), np.rint(a - high_shift)
    to_low = (a - low_i - low_shift) ** 2 + (b - low * row_spacing) ** 2
    to_high = (a - high_i - high_shift) ** 2 + (b - high * row_spacing) ** 2
    nearer = to_high < to_low
    return low_i + nearer * (high_i - low_i), low + nearer
