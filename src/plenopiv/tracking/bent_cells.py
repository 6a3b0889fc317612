"""Cells of microlenses as points see them on the main lens, where rays fall beside those of a thin lens.

A ray through u of the main lens falls at  A u + B x + left(u),  left a polynomial of third degree. The side of a cell
that a point sees is the curve on which that is a straight line of the microlens plane. It is cut into short straight
pieces within the aperture, whose ends are found by Newton's method. As the point moves, the curve moves with
-J^-1 d(A u + B x), J = A + dleft/du.
"""

from __future__ import annotations

from math import ceil, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import part

SHIFT_DEGREE = 3  # of the polynomial in a ray's place on the main lens by which it falls beside a thin lens'
SHIFT_POWERS = [(p, q) for p in range(SHIFT_DEGREE + 1) for q in range(SHIFT_DEGREE + 1 - p)]
STEP_PX = 1.0  # length of a straight piece
MOST = 16  # of them in a side
BEYOND = 1.3  # radii of the aperture, as a thin lens shows the cell, within which a side is bent
HELD = 1.02  # radii of the aperture beyond which left goes on straight: polynomials do not hold there
NEWTON = 4
RINGS, AROUND = 3, 8  # places of the aperture at which J is looked at
STEEP, FLAT = -0.3, 6.0  # of A^2: where J's determinant is less or more, a point's rays cross, or Newton's method fails
LEAST = 0.05  # of A^2, that the determinant is taken as in Newton's method

Terms = NDArray[np.float64]


@part
def left_of(shift: Terms, radius: float, u: float, v: float, out: NDArray[np.float64]) -> None:
    """How far a ray through (u, v) mm falls beside, ds and dt (mm), and the derivatives ds/du, ds/dv, dt/du, dt/dv;
    ``shift`` (terms, 2) of SHIFT_POWERS of (u, v) / ``radius``."""
    u, v = u / radius, v / radius
    far = max(sqrt(u * u + v * v) / HELD, 1.0)
    beyond_u, beyond_v = radius * (u - u / far), radius * (v - v / far)
    u, v = u / far, v / far
    for k in range(6):
        out[k] = 0.0
    term = 0
    power_u, before_u = 1.0, 0.0  # u^p, u^(p - 1)
    for p in range(SHIFT_DEGREE + 1):
        power_v, before_v = 1.0, 0.0
        for q in range(SHIFT_DEGREE + 1 - p):
            a, b = shift[term, 0], shift[term, 1]
            value, du, dv = power_u * power_v, p * before_u * power_v / radius, q * power_u * before_v / radius
            out[0] += a * value
            out[1] += b * value
            out[2] += a * du
            out[3] += a * dv
            out[4] += b * du
            out[5] += b * dv
            before_v = power_v
            power_v *= v
            term += 1
        before_u = power_u
        power_u *= u
    out[0] += out[2] * beyond_u + out[3] * beyond_v
    out[1] += out[4] * beyond_u + out[5] * beyond_v


@part
def inverse_of(spread: float, left: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """J^-1 (4,), row by row, of what ``left_of`` gives."""
    a, b, c, d = spread + left[2], left[3], left[4], spread + left[5]
    det = max(a * d - b * c, LEAST * spread * spread)
    out[0], out[1], out[2], out[3] = d / det, -b / det, -c / det, a / det


@part
def bends(spread: float, radius: float, shift: Terms, left: NDArray[np.float64]) -> bool:
    """Whether the sides of cells can be traced: not close to focus, where rays of a point cross all over the aperture
    and cells are taken as a thin lens shows them."""
    for k in range(RINGS * AROUND):
        r, angle = HELD * radius * (1 + k // AROUND) / RINGS, 2.0 * pi * k / AROUND
        left_of(shift, radius, r * cos(angle), r * sin(angle), left)
        share = ((spread + left[2]) * (spread + left[5]) - left[3] * left[4]) / (spread * spread)
        if not STEEP < share < FLAT:
            return False
    return True


@part
def _bent(
    x: float, y: float, to_px: float, spread: float, radius: float, shift: Terms,
    left: NDArray[np.float64], inverse: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Where the ray crosses the main lens, px, that a thin lens' would at (x, y) px."""
    u0, v0 = x / to_px, -y / to_px
    u, v = u0, v0
    for _ in range(NEWTON):
        left_of(shift, radius, u, v, left)
        inverse_of(spread, left, inverse)
        s, t = spread * (u - u0) + left[0], spread * (v - v0) + left[1]
        u -= inverse[0] * s + inverse[1] * t
        v -= inverse[2] * s + inverse[3] * t
    out[0], out[1] = to_px * u, -to_px * v


@part
def bend(
    corner: NDArray[np.float64],  # (corners, 2): the cell as a thin lens shows it, px from the disc's middle
    to_px: float, spread: float, radius: float, shift: Terms,
    out: NDArray[np.float64],  # (corners * (MOST + 2), 2), filled
    left: NDArray[np.float64], inverse: NDArray[np.float64],  # (6,), (4,) to work in
) -> int:  # fmt: skip
    """The outline of a cell as its rays show it, in the order of its corners; how many points."""
    n, count = 0, corner.shape[0]
    square = (BEYOND * radius * to_px) ** 2
    for k in range(count):
        x, y = corner[k, 0], corner[k, 1]
        dx, dy = corner[(k + 1) % count, 0] - x, corner[(k + 1) % count, 1] - y
        _bent(x, y, to_px, spread, radius, shift, left, inverse, out[n])
        n += 1
        length = dx * dx + dy * dy
        half = x * dx + y * dy
        root = half * half - length * (x * x + y * y - square)
        if root <= 0.0:
            continue
        root = sqrt(root)
        lo, hi = max((-half - root) / length, 0.0), min((-half + root) / length, 1.0)
        if lo >= hi:
            continue
        pieces = min(ceil((hi - lo) * sqrt(length) / STEP_PX), MOST)
        for i in range(pieces + 1):
            at = lo + (hi - lo) * i / pieces
            if 0.0 < at < 1.0:
                _bent(x + at * dx, y + at * dy, to_px, spread, radius, shift, left, inverse, out[n])
                n += 1
    return n
