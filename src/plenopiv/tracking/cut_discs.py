"""The boundary of a disc that a polygon cuts: straight pieces and arcs, anticlockwise."""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import part

LINES, ARCS = 0, 1  # kinds of pieces


@part
def _add_piece(
    pieces: NDArray[np.float64], box: NDArray[np.float64], n: int, kind: int, a: float, b: float, c: float, d: float
) -> int:
    pieces[n, 0], pieces[n, 1], pieces[n, 2], pieces[n, 3], pieces[n, 4] = kind, a, b, c, d
    if kind == LINES:
        box[0], box[1] = min(box[0], a, c), max(box[1], a, c)
        box[2], box[3] = min(box[2], b, d), max(box[3], b, d)
        return n + 1
    for quarter in range(-4, 9):  # an arc: its ends are those of lines; its extremes
        angle = 0.5 * pi * quarter
        if a <= angle <= b:
            x, y = c * cos(angle), c * sin(angle)
            box[0], box[1], box[2], box[3] = min(box[0], x), max(box[1], x), min(box[2], y), max(box[3], y)
    return n + 1


@part
def boundary(
    corner: NDArray[np.float64],  # (corners, 2): the cell, anticlockwise, from the disc's middle
    count: int,  # of the corners
    radius: float,
    pieces: NDArray[np.float64],  # (n, 5) filled: kind; a line's ends, or an arc's angles and radius
    box: NDArray[np.float64],  # (4,) filled: least and largest x and y
    crossing: NDArray[np.float64],  # (2, corners) to work in
) -> int:
    """The boundary of a disc about the origin cut by a polygon, anticlockwise; returns how many pieces. Where a side
    leaves the disc, its edge goes on to where the next side enters it."""
    square = radius * radius
    box[0], box[1], box[2], box[3] = 1e300, -1e300, 1e300, -1e300
    n, entered, left, holds = 0, 0, 0, False
    for k in range(count):
        x0, y0 = corner[k, 0], corner[k, 1]
        x1, y1 = corner[(k + 1) % count, 0], corner[(k + 1) % count, 1]
        dx, dy = x1 - x0, y1 - y0
        if (y0 > 0.0) != (y1 > 0.0) and (x0 * dy > y0 * dx) == (dy > 0.0):  # it crosses the axis of positive x
            holds = not holds
        inside0, inside1 = x0 * x0 + y0 * y0 <= square, x1 * x1 + y1 * y1 <= square
        lo, hi = 0.0, 1.0
        if not (inside0 and inside1):
            length = dx * dx + dy * dy
            half = x0 * dx + y0 * dy
            root = half * half - length * (x0 * x0 + y0 * y0 - square)
            if root <= 0.0:
                continue
            root = sqrt(root)
            if not inside0:
                lo = (-half - root) / length
            if not inside1:
                hi = (-half + root) / length
            if not (lo < 1.0 and hi > 0.0 and lo < hi):
                continue
        ax, ay, bx, by = x0 + lo * dx, y0 + lo * dy, x0 + hi * dx, y0 + hi * dy
        if not inside0:
            crossing[0, entered] = atan2(ay, ax)
            entered += 1
        n = _add_piece(pieces, box, n, LINES, ax, ay, bx, by)
        if not inside1:
            crossing[1, left] = atan2(by, bx)
            left += 1
    if n == 0:
        return _add_piece(pieces, box, 0, ARCS, 0.0, 2.0 * pi, radius, 0.0) if holds else 0
    for k in range(left):
        angle, turn = crossing[1, k], 1e300
        for m in range(entered):
            on = crossing[0, m] - angle
            turn = min(turn, on if on >= 0.0 else on + 2 * pi)
        if turn < 1e299:
            n = _add_piece(pieces, box, n, ARCS, angle, angle + turn, radius, 0.0)
    return n


@part
def about(corner: NDArray[np.float64], count: int, radius: float, box: NDArray[np.float64]) -> int:
    """A box that holds what a disc about the origin shares with a polygon; 0 where they share nothing."""
    for axis in range(2):
        low, high = corner[0, axis], corner[0, axis]
        for k in range(1, count):
            low, high = min(low, corner[k, axis]), max(high, corner[k, axis])
        box[2 * axis], box[2 * axis + 1] = max(low, -radius), min(high, radius)
    return 1 if box[0] < box[1] and box[2] < box[3] else 0
