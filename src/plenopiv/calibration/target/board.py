"""A calibration target: white dots on a square grid, and images of it at known z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Board:
    """White dots in rows along x and y, ``pitch_mm`` apart, ``dot_mm`` wide. The one of ``origin_dot_mm`` is x = y = 0,
    its neighbour along +x is ``x_dot_mm`` wide; None: that dot is as wide as the others, and +x is to the right in an
    upright image. ``step_mm``: of a target with two levels, by how much the columns of odd numbers lie farther from the
    camera than the origin's, whose z is the plane's; 0 for a flat one."""

    pitch_mm: float
    dot_mm: float
    origin_dot_mm: float
    x_dot_mm: float | None = None
    step_mm: float = 0.0

    def diameter_mm(self, number: NDArray[np.int64]) -> NDArray[np.float64]:
        """Diameters (n,) of the dots of ``number`` (n, 2)."""
        out = np.full(len(number), self.dot_mm)
        out[(number == (0, 0)).all(1)] = self.origin_dot_mm
        if self.x_dot_mm is not None:
            out[(number == (1, 0)).all(1)] = self.x_dot_mm
        return out

    def places_mm(self, number: NDArray[np.int64], z_mm: float) -> NDArray[np.float64]:
        """Where the dots of ``number`` (n, 2), along x and y, are in the laboratory, (n, 3), the target at ``z_mm``."""
        z = z_mm - self.step_mm * (number[:, 0] % 2)
        return np.column_stack([self.pitch_mm * number, z])


@dataclass(frozen=True)
class TargetImage:
    """One image of the target: upright counts (rows, columns) with the black level still in, and the traverse's
    reading. ``name`` is what messages call it."""

    name: str
    z_mm: float
    counts: NDArray
