"""Area of a patch of light inside a microlens' cell. Functions of scalars, inlined by kernels.

Lengths are in *cells*, microlens pitches divided by (1 - A), with axes along and across the lattice's rows and the
microlens at the origin (see ``geometry``): a square lens is the unit square, a hexagonal one the hexagon of unit width
whose flat sides face along the rows.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plenopiv.kernels import inlined

F = np.float32
HALF, ONE, ZERO = F(0.5), F(1.0), F(0.0)
ROOT3 = F(sqrt(3.0))
TIP = F(1.0 / sqrt(3.0))  # the hexagon's upper corner
BEND = F(1.0 / (2.0 * sqrt(3.0)))


@inlined
def corner(x: np.float32, y: np.float32) -> np.float32:
    """Area that the hexagon's slanted sides cut off the rectangle 0..x, 0..y: odd in x and in y."""
    beyond = max(abs(x) + ROOT3 * abs(y) - ONE, ZERO)
    cut = BEND * beyond * beyond
    return cut if x * y >= ZERO else -cut


@inlined
def rectangle_in_hexagon(x: np.float32, y: np.float32, half_x: np.float32, half_y: np.float32) -> np.float32:
    """Area of a rectangle centred at (x, y), half widths (half_x, half_y), inside the hexagon.

    At x the hexagon reaches up to h(x) = (1 - |x|)/sqrt(3), so the overlap is the integral of
    clip(y2, -h, h) - clip(y1, -h, h): the clipped rectangle less four corner terms.
    """
    x1, x2 = min(max(x - half_x, -HALF), HALF), min(max(x + half_x, -HALF), HALF)
    y1, y2 = min(max(y - half_y, -TIP), TIP), min(max(y + half_y, -TIP), TIP)
    corners = corner(x2, y2) - corner(x1, y2) - corner(x2, y1) + corner(x1, y1)
    return max((x2 - x1) * (y2 - y1) - corners, ZERO)  # rounding may leave less than nothing


@inlined
def rectangle_in_square(x: np.float32, y: np.float32, half_x: np.float32, half_y: np.float32) -> np.float32:
    """Area of the same rectangle inside the unit square."""
    x1, x2 = min(max(x - half_x, -HALF), HALF), min(max(x + half_x, -HALF), HALF)
    y1, y2 = min(max(y - half_y, -HALF), HALF), min(max(y + half_y, -HALF), HALF)
    return (x2 - x1) * (y2 - y1)


@inlined
def point_in_hexagon(x: np.float32, y: np.float32) -> np.float32:
    """1 inside the hexagon, else 0."""
    inside = (abs(x) <= HALF) & (abs(x) + ROOT3 * abs(y) <= ONE)
    return ONE if inside else ZERO


@inlined
def point_in_square(x: np.float32, y: np.float32) -> np.float32:
    """1 inside the unit square, else 0."""
    inside = (abs(x) <= HALF) & (abs(y) <= HALF)
    return ONE if inside else ZERO
