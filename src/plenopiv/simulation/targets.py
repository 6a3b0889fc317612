"""Targets of white dots in rows along x and y, as a laboratory has them."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, radians, sin

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError


@dataclass(frozen=True)
class CutDot:
    """Dot (column, row) from the origin's, of which what lies beyond a straight line is dark: the line is ``keep``
    radii from the dot's centre, toward ``direction_deg`` (counter-clockwise from +x)."""

    column: int
    row: int
    direction_deg: float = 0.0
    keep: float = 0.0


@dataclass(frozen=True)
class DotTarget:
    """Dots ``pitch_mm`` apart. The one at the origin has another diameter, ``origin_dot_mm``, and so has its neighbour
    along +x, ``x_dot_mm`` (None: as the others).

    ``step_mm``: columns of odd numbers lie so much farther from the camera (two-level targets), 0 for a plane one.
    ``missing``: dots (column, row) that are not there. ``half_mm``: half sides of the board along x and y, None for one
    larger than the field. ``background``: how brightly the board shines, as a share of the dots.
    """

    pitch_mm: float
    dot_mm: float
    origin_dot_mm: float | None = None
    x_dot_mm: float | None = None
    step_mm: float = 0.0
    missing: tuple[tuple[int, int], ...] = ()
    cut: tuple[CutDot, ...] = ()
    half_mm: tuple[float, float] | None = None
    background: float = 0.02

    def __post_init__(self) -> None:
        largest = max(self.dot_mm, self.origin_dot_mm or 0.0, self.x_dot_mm or 0.0)
        if not 0 < self.dot_mm <= largest < self.pitch_mm:
            raise PlenoPIVError(f"target: dots of {largest:g} mm touch at a pitch of {self.pitch_mm:g} mm")

    def dots(self, farthest_mm: float) -> NDArray[np.float64]:
        """(rows, columns, 4) of the dots up to ``farthest_mm`` from the origin, that one in the middle: radius in mm,
        and unit vector (x, y) and distance in mm of the line that cuts it."""
        reach = int(farthest_mm / self.pitch_mm) + 2
        if self.half_mm is not None:
            reach = min(reach, int(max(self.half_mm) / self.pitch_mm) + 2)
        table = np.zeros((2 * reach + 1, 2 * reach + 1, 4))
        table[..., 0], table[..., 3] = 0.5 * self.dot_mm, inf
        table[reach, reach, 0] = 0.5 * (self.origin_dot_mm or self.dot_mm)
        table[reach, reach + 1, 0] = 0.5 * (self.x_dot_mm or self.dot_mm)
        for column, row in self.missing:
            if max(abs(column), abs(row)) <= reach:
                table[reach + row, reach + column, 0] = 0.0
        for cut in self.cut:
            if max(abs(cut.column), abs(cut.row)) <= reach:
                way, at = radians(cut.direction_deg), (reach + cut.row, reach + cut.column)
                table[at][1:] = cos(way), sin(way), cut.keep * table[at][0]
        return table
