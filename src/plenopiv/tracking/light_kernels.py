"""The light of a point in every pixel, with its derivatives: integrals along the boundaries of its micro-images.

Lengths are pixels of an upright image (columns, rows) unless their name says mm. A point's light under the microlens S
is an even patch on the sensor: the image of the aperture, a disc, cut by the microlens' cell as the point sees it on
the main lens, a convex polygon (``accuracy.point_light`` has the derivation). A pixel collects the patch G convolved
with the pixel's square and with diffraction, a Gaussian; both are  k(X - column) k(Y - row)  with k a square of width 1
convolved with a Gaussian. With K the integral of k, Gauss' theorem makes of the area an integral along the boundary,

    share       = density * sum over the boundary of  K(X - column) k(Y - row) n_x ds
    d share     = density * sum over the boundary of  k(X - column) k(Y - row) (velocity . n) ds

n the outward normal; the velocity is that of the boundary as the point moves. Along z the density changes as well.
Boundaries are taken in pieces of at most PIECE pixels with three Gauss-Legendre nodes each.
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part

PIECE = 0.4  # px between two sets of nodes: gradients are exact to half a percent for diffraction of 0.16 px
NODES = 3
ROOT = sqrt(0.6)  # Gauss-Legendre of three nodes on -1 ... 1
PER_PX = 256  # entries of the tables of k and K
TAIL = 4.0  # standard deviations of diffraction that the tables reach beyond the pixel
EDGE = 2.5  # standard deviations beyond its boundary at which a patch ends: 1e-5 of the light is left out
LINES, ARCS = 0, 1  # kinds of pieces
SHIFT_DEGREE = 3  # of the polynomial in a ray's place on the main lens by which it falls beside a thin lens'
SHIFT_POWERS = [(p, q) for p in range(SHIFT_DEGREE + 1) for q in range(SHIFT_DEGREE + 1 - p)]
SMALLEST_SPREAD = 1e-7  # stands for A in focus, where cells are larger than the aperture


class LightConstants(NamedTuple):
    """What kernels need of a camera. Lengths in mm where not pixels."""

    hexagonal: bool
    cos: float  # of the lattice's rotation
    sin: float
    pitch: float
    row_spacing: float  # pitches
    offset_s: float
    offset_t: float
    i0: int  # first lens along and across rows of the table of centres
    j0: int
    image_scale: float  # e
    radius: float  # of the aperture
    pixel: float
    column0: float  # the optical axis in the image
    row0: float
    columns: int
    rows: int
    object_distance: float  # S_o
    image_distance: float  # S_i
    focal: float  # of the main lens
    tail_px: float  # half width of k
    edge_px: float  # what a patch is widened by
    corners: int  # of a cell
    moved: float  # how far, in pitches, lenses may be from their places on the regular lattice


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
    radius: float,
    pieces: NDArray[np.float64],  # (n, 5) filled: kind; a line's ends, or an arc's angles and radius
    box: NDArray[np.float64],  # (4,) filled: least and largest x and y
) -> int:
    """The boundary of a disc about the origin cut by a convex polygon, anticlockwise; returns how many pieces."""
    count, square = corner.shape[0], radius * radius
    box[0], box[1], box[2], box[3] = 1e300, -1e300, 1e300, -1e300
    n, left, first, holds = 0, 1e300, 1e300, True
    for k in range(count):
        x0, y0 = corner[k, 0], corner[k, 1]
        x1, y1 = corner[(k + 1) % count, 0], corner[(k + 1) % count, 1]
        dx, dy = x1 - x0, y1 - y0
        holds = holds and dx * -y0 - dy * -x0 > 0.0
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
            angle = atan2(ay, ax)
            if left < 1e299:
                n = _add_piece(pieces, box, n, ARCS, left, angle if angle >= left else angle + 2 * pi, radius, 0.0)
            else:
                first = angle
        n = _add_piece(pieces, box, n, LINES, ax, ay, bx, by)
        if not inside1:
            left = atan2(by, bx)
    if n == 0:
        return _add_piece(pieces, box, 0, ARCS, 0.0, 2.0 * pi, radius, 0.0) if holds else 0
    if first < 1e299 and left < 1e299:
        n = _add_piece(pieces, box, n, ARCS, left, first if first >= left else first + 2 * pi, radius, 0.0)
    return n


@part
def _table_at(table: NDArray[np.float64], tail: float, x: float) -> float:
    """A table of k or K at x, between its entries; what it ends with beyond."""
    at = (min(max(x, -tail), tail) + tail) * PER_PX
    i = min(int(at), table.size - 2)
    return table[i] + (at - i) * (table[i + 1] - table[i])


@part
def _patch(cam: LightConstants, x0: float, y0: float, box: NDArray[np.float64], window: NDArray[np.int64]) -> int:
    """First column, first row, columns and rows of the pixels that a patch about (x0, y0) lights; how many."""
    lo = max(ceil(x0 + box[0] - cam.edge_px), 0)
    hi = min(floor(x0 + box[1] + cam.edge_px), cam.columns - 1)
    low = max(ceil(y0 + box[2] - cam.edge_px), 0)
    high = min(floor(y0 + box[3] + cam.edge_px), cam.rows - 1)
    window[0], window[1] = lo, low
    window[2], window[3] = max(hi - lo + 1, 0), max(high - low + 1, 0)
    return int(window[2] * window[3])


@part
def _lens_rows(cam: LightConstants, b: float, reach: float) -> tuple[int, int]:
    """The rows of lenses that hold light within ``reach`` pitches of b pitches across the rows: first, and one past."""
    return ceil((b - reach) / cam.row_spacing), floor((b + reach) / cam.row_spacing) + 1


@part
def _lenses_of_row(cam: LightConstants, a: float, b: float, reach: float, j: int) -> tuple[int, int]:
    """The lenses of row j within ``reach`` pitches of (a, b): first, and one past."""
    apart = b - j * cam.row_spacing
    half = sqrt(max(reach * reach - apart * apart, 0.0))
    odd = 0.5 * (j & 1) if cam.hexagonal else 0.0
    return ceil(a - odd - half), floor(a - odd + half) + 1


@part
def _shift_corners(
    corner: NDArray[np.float64], cell_px: float, to_px: float, radius: float, shift: NDArray[np.float64]
) -> None:
    """Move the corners of a cell to where rays that fall beside those of a thin lens cross the main lens, in place.
    ``shift`` (terms, 2): of SHIFT_POWERS of (u, v) in units of the aperture's radius, mm on the microlens plane.
    Corners beyond the aperture take what it is at its edge."""
    for k in range(corner.shape[0]):
        u, v = corner[k, 0] / (to_px * radius), -corner[k, 1] / (to_px * radius)
        far = sqrt(u * u + v * v)
        if far > 1.0:
            u, v = u / far, v / far
        ds, dt = 0.0, 0.0
        power_u, term = 1.0, 0
        for p in range(SHIFT_DEGREE + 1):
            power = power_u
            for _ in range(SHIFT_DEGREE + 1 - p):
                ds += shift[term, 0] * power
                dt += shift[term, 1] * power
                power *= v
                term += 1
            power_u *= u
        corner[k, 0] -= cell_px * ds
        corner[k, 1] += cell_px * dt


@part
def _light_of_point(
    cam: LightConstants,
    centres: NDArray[np.float64],  # (nj, ni, 2): centres of the microlenses, mm
    cell: NDArray[np.float64],  # (corners, 2): of a cell about its centre, mm, clockwise in (s, t)
    k_table: NDArray[np.float64], big_k_table: NDArray[np.float64],
    x: float, y: float, z: float,
    shift: NDArray[np.float64],  # (terms, 2), or no terms where the main lens is a thin one
    count_alone: bool,
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    at: int,  # where this point's entries begin
    corner: NDArray[np.float64], pieces: NDArray[np.float64], box: NDArray[np.float64], window: NDArray[np.int64],
    column_k: NDArray[np.float64], column_big: NDArray[np.float64],  # (columns of a patch,) to work in
) -> int:  # fmt: skip
    """Fill the pixels of a point; how many. ``count_alone``: only count them."""
    distance = cam.object_distance - z
    a = 1.0 + cam.image_distance / distance - cam.image_distance / cam.focal
    b = -cam.image_distance / distance
    rate = cam.image_distance / (distance * distance)  # A' = -B'
    if abs(a) < SMALLEST_SPREAD:
        a = SMALLEST_SPREAD
    e, px = cam.image_scale, cam.pixel
    image_s, image_t = b * x, b * y
    to_px = e * (1.0 - a) / px  # mm on the main lens -> px of the patch
    radius = cam.radius * to_px
    cell_px = to_px / a
    density = 1.0 / (pi * radius * radius)
    swell = 2.0 * rate / (1.0 - a)
    ds, dt = image_s - cam.offset_s, image_t - cam.offset_t
    along, across = (cam.cos * ds + cam.sin * dt) / cam.pitch, (cam.cos * dt - cam.sin * ds) / cam.pitch
    reach = abs(a) * cam.radius / cam.pitch + 0.7072 + cam.moved
    first = at
    low, high = _lens_rows(cam, across, reach)
    for j in range(max(low, cam.j0), min(high, cam.j0 + centres.shape[0])):
        lo, hi = _lenses_of_row(cam, along, across, reach, j)
        for i in range(max(lo, cam.i0), min(hi, cam.i0 + centres.shape[1])):
            lens_s, lens_t = centres[j - cam.j0, i - cam.i0, 0], centres[j - cam.j0, i - cam.i0, 1]
            for k in range(cam.corners):
                corner[k, 0] = cell_px * (lens_s + cell[k, 0] - image_s)
                corner[k, 1] = -cell_px * (lens_t + cell[k, 1] - image_t)
            if shift.shape[0] > 0:
                _shift_corners(corner, cell_px, to_px, cam.radius, shift)
            n = boundary(corner, radius, pieces, box)
            if n == 0:
                continue
            x0 = cam.column0 - (lens_s + e * image_s) / px
            y0 = cam.row0 + (lens_t + e * image_t) / px
            size = _patch(cam, x0, y0, box, window)
            if size == 0:
                continue
            if count_alone:
                at += size
                continue
            columns, rows = window[2], window[3]
            for r in range(rows):
                for c in range(columns):
                    entry = at + r * columns + c
                    pixel[entry] = (window[1] + r) * cam.columns + window[0] + c
                    share[entry] = 0.0
                    gradient[entry, 0] = 0.0
                    gradient[entry, 1] = 0.0
                    gradient[entry, 2] = 0.0
            for p in range(n):
                arc = pieces[p, 0] == ARCS
                if arc:
                    turn = pieces[p, 2] - pieces[p, 1]
                    length = radius * turn
                else:
                    px0, py0 = pieces[p, 1], pieces[p, 2]
                    dx, dy = pieces[p, 3] - px0, pieces[p, 4] - py0
                    length = sqrt(dx * dx + dy * dy)
                if length <= 0.0:
                    continue
                parts = ceil(length / PIECE)
                step = length / parts
                for node in range(NODES * parts):
                    of_three = node % NODES
                    middle = (node // NODES + 0.5 + 0.5 * ROOT * (of_three - 1)) / parts
                    ds_px = step * (4.0 / 9.0 if of_three == 1 else 5.0 / 18.0)
                    if arc:
                        angle = pieces[p, 1] + middle * turn
                        nx, ny = cos(angle), sin(angle)
                        wx, wy = radius * nx, radius * ny
                        slow = 1.0
                    else:
                        wx, wy = px0 + middle * dx, py0 + middle * dy
                        nx, ny = dy / length, -dx / length
                        slow = 1.0 / a
                    # along the columns, u of the main lens is wx / to_px; along the rows, -wy / to_px
                    factor = e / px * ds_px * density
                    if arc:
                        gx, gy = -b * nx * factor, b * ny * factor
                        gz = rate * ((x - wx / to_px) * nx + (-y - wy / to_px) * ny) * factor
                    else:
                        gx, gy = -b * slow * nx * factor, b * slow * ny * factor
                        gz = rate * slow * ((x - wx / to_px) * nx + (-y - wy / to_px) * ny) * factor
                    of_share = nx * ds_px * density
                    for c in range(columns):
                        column_k[c] = _table_at(k_table, cam.tail_px, x0 + wx - window[0] - c)
                        column_big[c] = _table_at(big_k_table, cam.tail_px, x0 + wx - window[0] - c)
                    y_here = y0 + wy - window[1]
                    for r in range(max(ceil(y_here - cam.tail_px), 0), min(int(y_here + cam.tail_px) + 1, rows)):
                        ky = _table_at(k_table, cam.tail_px, y_here - r)
                        for c in range(columns):
                            entry = at + r * columns + c
                            share[entry] += of_share * ky * column_big[c]
                            both = ky * column_k[c]
                            gradient[entry, 0] += gx * both
                            gradient[entry, 1] += gy * both
                            gradient[entry, 2] += gz * both
            for entry in range(at, at + size):
                gradient[entry, 2] += swell * share[entry]
            at += size
    return at - first


@kernel
def light_of_points(
    begin: int, end: int,
    cam: LightConstants,
    centres: NDArray[np.float64], cell: NDArray[np.float64],
    k_table: NDArray[np.float64], big_k_table: NDArray[np.float64],
    position: NDArray[np.float64],  # (points, 3): x, y, z, mm
    shift: NDArray[np.float64],  # (points, terms, 2)
    count_alone: bool,
    start: NDArray[np.int64],  # (points,): where a point's entries begin
    count: NDArray[np.int64],  # (points,): filled where count_alone
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
) -> None:  # fmt: skip
    """Pixels, shares and gradients of points ``begin`` to ``end``, or how many pixels each lights."""
    corner, pieces = np.empty((cam.corners, 2)), np.empty((2 * cam.corners + 2, 5))
    box, window = np.empty(4), np.empty(4, np.int64)
    side = int(2.0 * cam.radius * cam.image_scale / cam.pixel * 1.5) + 8
    column_k, column_big = np.empty(side), np.empty(side)
    for n in range(begin, end):
        found = _light_of_point(
            cam, centres, cell, k_table, big_k_table, position[n, 0], position[n, 1], position[n, 2],
            shift[n], count_alone,
            pixel, share, gradient, start[n], corner, pieces, box, window, column_k, column_big,
        )  # fmt: skip
        if count_alone:
            count[n] = found
