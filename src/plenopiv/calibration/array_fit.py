"""Where the microlenses are, as a function of their numbers: a similarity, or as much more as the data ask for.

A lens' number is its place on the unit lattice (complex). Its micro-image lies at a polynomial of it: of degree 1 for
an array that is stretched or sheared, of 2 or 3 for one that is tilted or distorted. A higher degree is taken where,
fitted to one half of the lenses, it predicts the other half better by far more than chance, and by enough to matter.
"""

from __future__ import annotations

from cmath import phase
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.spectrum import reduced_angle
from plenopiv.lattice import Lattice, LatticeKind, LatticeMap, powers

SIMILARITY = 0  # in place of a degree
DEGREES = (1, 2, 3)
LARGEST_F = 12.0  # of the halves: F of more terms that chance does not reach
WORTH_PX = 0.02  # by which more terms must move a lens somewhere on the sensor
LENSES_PER_TERM = 6
PARTS = 4  # the sensor is cut into PARTS x PARTS to tell deviations


@dataclass(frozen=True)
class ArrayFit:
    """Positions (complex, pixels from the axis) of lenses by a polynomial of their numbers: ``coefficients`` (complex)
    of 1 and of the monomials ``powers(degree)`` of real and imaginary part, in units of ``unit``. ``along`` and
    ``across``: mean change of the position with the number along the rows and across them, over the lenses fitted."""

    degree: int
    unit: float
    coefficients: NDArray[np.complex128]
    along: complex
    across: complex

    @classmethod
    def fitted(cls, numbers: NDArray[np.complex128], position: NDArray[np.complex128], degree: int) -> ArrayFit:
        """The least-squares fit to measured positions; ``degree`` may be ``SIMILARITY``."""
        unit = float(np.abs(numbers).max()) or 1.0
        if degree == SIMILARITY:
            middle = numbers.mean()
            w = numbers - middle
            pitch = complex(np.sum(np.conj(w) * position) / np.sum(np.abs(w) ** 2))
            return cls.similar(pitch, complex(position.mean() - pitch * middle), unit)
        solved = np.linalg.lstsq(_terms(numbers / unit, degree).astype(complex), position, rcond=None)[0]
        _, along, across = np.linalg.lstsq(_terms(numbers / unit, 1).astype(complex), position, rcond=None)[0]
        return cls(degree, unit, np.asarray(solved, np.complex128), complex(along) / unit, complex(across) / unit)

    @classmethod
    def similar(cls, pitch: complex, offset: complex, unit: float = 1.0) -> ArrayFit:
        """The similarity offset + pitch * number."""
        coefficients = np.array([offset, pitch * unit, 1j * pitch * unit], np.complex128)
        return cls(SIMILARITY, unit, coefficients, pitch, 1j * pitch)

    def __call__(self, numbers: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Positions of the lenses."""
        return _terms(np.asarray(numbers) / self.unit, max(self.degree, 1)) @ self.coefficients

    @property
    def pitch(self) -> complex:
        """Complex distance of lenses along the rows, pixels."""
        return self.along

    @property
    def stretch(self) -> float:
        """By how much, relatively, the spacing along the rows exceeds that across them."""
        return 2.0 * (abs(self.along) - abs(self.across)) / (abs(self.along) + abs(self.across))

    @property
    def shear_rad(self) -> float:
        """By how much the angle between rows and columns falls short of a right angle."""
        return -phase(self.across / (1j * self.along))

    def lattice(self, kind: LatticeKind, mm_per_px: float) -> Lattice:
        """The lattice in mm, numbered from the lens nearest to the axis: the regular one that has the fit's pitch and
        rotation along the rows, and the map from it to the fit."""
        pitch, axis = self.pitch, self._number_at_axis()
        angle = reduced_angle(kind, phase(pitch))
        if self.degree == SIMILARITY:
            offset = complex(self.coefficients[0])
            return nearest_to_axis(
                Lattice(kind, abs(pitch) * mm_per_px, angle, (offset.real * mm_per_px, offset.imag * mm_per_px))
            )
        offset = -pitch * axis  # of the regular lattice: where the map moves nothing
        size = np.linspace(-1.0, 1.0, 2 * self.degree + 3)
        numbers = np.asarray(axis + self.unit * (size + 1j * size[:, None]).ravel(), np.complex128)
        regular = offset + pitch * numbers
        unit = float(np.abs(regular).max())
        u, v = regular.real / unit, regular.imag / unit
        terms = np.stack([u**p * v**q for p, q in powers(self.degree)], -1)
        moved = np.linalg.lstsq(terms.astype(complex), self(numbers) - regular, rcond=None)[0] * mm_per_px
        by = LatticeMap(self.degree, unit * mm_per_px, tuple((float(m.real), float(m.imag)) for m in moved))
        return nearest_to_axis(
            Lattice(kind, abs(pitch) * mm_per_px, angle, (offset.real * mm_per_px, offset.imag * mm_per_px), by)
        )

    def _number_at_axis(self) -> complex:
        """The point of the unit lattice that lies on the optical axis."""
        number, pitch = 0j, self.pitch
        for _ in range(20):
            number -= complex(self(np.array([number]))[0]) / pitch
        return number


def _terms(w: NDArray[np.complex128], degree: int) -> NDArray[np.float64]:
    """1 and the monomials of real and imaginary part, (lens, terms)."""
    return np.stack([np.ones(w.shape), *(w.real**p * w.imag**q for p, q in powers(degree))], -1)


def parameters(degree: int) -> int:
    """Numbers that a fit of a degree determines."""
    return 4 if degree == SIMILARITY else 2 * (1 + len(powers(degree)))


def best_fit(numbers: NDArray[np.complex128], position: NDArray[np.complex128]) -> ArrayFit:
    """The fit of the lowest degree that describes the array as well as a higher one does."""
    best = SIMILARITY
    halves = _halves(numbers)
    for degree in DEGREES:
        if 2 * numbers.size < LENSES_PER_TERM * parameters(degree):
            break
        low, high = (_left(numbers, position, halves, d) for d in (best, degree))
        more = parameters(degree) - parameters(best)
        chance = high / (2 * numbers.size) * more
        moved = ArrayFit.fitted(numbers, position, degree)(numbers) - ArrayFit.fitted(numbers, position, best)(numbers)
        if low - high > LARGEST_F * chance and np.abs(moved).max() > WORTH_PX:
            best = degree
    return ArrayFit.fitted(numbers, position, best)


def _halves(numbers: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """One half of the lenses, evenly mixed with the other."""
    return np.random.default_rng(numbers.size).random(numbers.size) < 0.5


def _left(
    numbers: NDArray[np.complex128], position: NDArray[np.complex128], half: NDArray[np.bool_], degree: int
) -> float:
    """Sum of squares that a fit to each half leaves of the other."""
    total = 0.0
    for fit, test in ((half, ~half), (~half, half)):
        predicted = ArrayFit.fitted(numbers[fit], position[fit], degree)(numbers[test])
        total += float(np.sum(np.abs(position[test] - predicted) ** 2))
    return total


def deviations(
    numbers: NDArray[np.complex128], position: NDArray[np.complex128], degree: int
) -> tuple[float, float, float]:
    """Standard deviations of rotation (rad), stretch and shear (rad), by leaving out each of PARTS x PARTS parts of
    the array in turn: what errors do that neighbouring lenses share is counted in."""
    part = np.zeros(numbers.size, int)
    for values in (numbers.real, numbers.imag):
        edges = np.quantile(values, np.linspace(0, 1, PARTS + 1)[1:-1])
        part = PARTS * part + np.searchsorted(edges, values)
    found, least = [], LENSES_PER_TERM * parameters(degree)
    for k in np.unique(part):
        kept = part != k
        if 2 * np.count_nonzero(kept) >= least:
            fit = ArrayFit.fitted(numbers[kept], position[kept], degree)
            affine = ArrayFit.fitted(numbers[kept], position[kept], max(degree, 1))
            found.append((phase(fit.pitch), affine.stretch, affine.shear_rad))
    if len(found) < 2:
        return 0.0, 0.0, 0.0
    values = np.array(found)
    spread = np.sqrt((len(found) - 1) / len(found) * ((values - values.mean(0)) ** 2).sum(0))
    return float(spread[0]), float(spread[1]), float(spread[2])


def nearest_to_axis(lattice: Lattice) -> Lattice:
    """The same lattice, numbered from the lens nearest to the optical axis."""
    s, t = lattice.regular_centres(*lattice.nearest(0.0, 0.0))
    return Lattice(lattice.kind, lattice.pitch_mm, lattice.rotation_rad, (float(s), float(t)), lattice.map)
