"""Discs cut by polygons: area and lit side against a grid of points, for polygons that are convex and that are not."""

import numpy as np
import pytest

from plenopiv.tracking.cut_discs import ARCS, about, boundary

RADIUS = 1.0
SQUARE = [(-0.6, -0.7), (0.9, -0.7), (0.9, 0.5), (-0.6, 0.5)]
HALF = [(0.2, -5.0), (5.0, -5.0), (5.0, 5.0), (0.2, 5.0)]
AROUND = [(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)]
BESIDE = [(2.0, -5.0), (5.0, -5.0), (5.0, 5.0), (2.0, 5.0)]
# a side that leaves the disc and comes back: two slivers to its right, or all but two
WAVY = [(0.99, -0.3), (1.02, 0.0), (0.99, 0.3)]
SLIVERS = [*reversed(WAVY), (1.2, -1.0), (3.0, -1.0), (3.0, 1.0), (1.2, 1.0)]
BUT_SLIVERS = [(1.2, -1.0), *WAVY, (1.2, 1.0), (1.2, 3.0), (-3.0, 3.0), (-3.0, -3.0), (1.2, -3.0)]
CASES = {
    "square": SQUARE, "half": HALF, "around": AROUND, "beside": BESIDE, "slivers": SLIVERS, "but slivers": BUT_SLIVERS,
}  # fmt: skip


def inside(points, polygon):
    """Which points lie in a polygon, by the angles that its sides turn through."""
    turn = np.zeros(len(points))
    for (x0, y0), (x1, y1) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        a = points - (x0, y0)
        b = points - (x1, y1)
        turn += np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(1))
    return np.abs(turn) > np.pi


def area_of(pieces):
    """By Gauss' theorem, arcs about the origin."""
    total = 0.0
    for kind, a, b, c, d in pieces:
        total += 0.5 * c * c * (b - a) if kind == ARCS else 0.5 * (a * d - c * b)
    return total


@pytest.mark.parametrize("name", CASES)
def test_area_is_that_of_points(name):
    polygon = np.array(CASES[name])
    pieces, box, work = np.empty((40, 5)), np.empty(4), np.empty((2, 20))
    found = pieces[: boundary(polygon, len(polygon), RADIUS, pieces, box, work)]
    side = np.linspace(-1.0, 1.0, 1201)
    points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    lit = points[(np.hypot(*points.T) < RADIUS) & inside(points, CASES[name])]
    assert area_of(found) == pytest.approx(len(lit) * (side[1] - side[0]) ** 2, abs=2e-3)
    if len(lit):
        least, most = lit.min(0), lit.max(0)
        assert box == pytest.approx([least[0], most[0], least[1], most[1]], abs=5e-3)
        assert about(polygon, len(polygon), RADIUS, work[0]) == 1
        assert (work[0, [0, 2]] <= box[[0, 2]] + 1e-12).all()
        assert (work[0, [1, 3]] >= box[[1, 3]] - 1e-12).all()
    else:
        assert len(found) == 0
