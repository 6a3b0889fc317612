"""The light of a point in every pixel, with its derivatives: integrals along the boundaries of its micro-images.

Lengths are pixels of an upright image (columns, rows) unless their name says mm. A point's light under the microlens S
is an even patch on the sensor: the image of the aperture, a disc, cut by the microlens' cell as the point sees it on
the main lens, a convex polygon (``accuracy.point_light`` has the derivation). A pixel collects the patch G convolved
with the pixel's square and with diffraction, a Gaussian; both are  k(X - column) k(Y - row)  with k a square of width 1
convolved with a Gaussian. With K the integral of k, Gauss' theorem makes of the area an integral along the boundary,

    share       = density * sum over the boundary of  K(X - column) k(Y - row) n_x ds
    d share     = density * sum over the boundary of  k(X - column) k(Y - row) (velocity . n) ds

n the outward normal; the velocity is that of the boundary as the point moves. Along z the density changes as well.
Boundaries are taken in pieces of at most PIECE pixels with three Gauss-Legendre nodes each. Cells that lie within the
disc as a whole differ by size and place alone: their light is looked up (``whole_cells``).
"""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part
from plenopiv.tracking.bent_cells import MOST, bend, bends, inverse_of, left_of
from plenopiv.tracking.cut_discs import ARCS, about, boundary
from plenopiv.tracking.edge_integrals import at_node, node_of, nodes_of
from plenopiv.tracking.whole_cells import WholeCells, expanded, number_of, place_of

LEAST = 1e-4  # of the light of a pixel that is wholly lit, or of a cell: pixels with less of it are left out
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
    growth_s: float  # by what share its image under a microlens is wider, per mm of the microlens' s and t
    growth_t: float
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
def _light_of_point(
    cam: LightConstants,
    centres: NDArray[np.float64],  # (nj, ni, 2): centres of the microlenses, mm
    cell: NDArray[np.float64],  # (corners, 2): of a cell about its centre, mm, clockwise in (s, t)
    profile: NDArray[np.float32], whole: WholeCells,
    x: float, y: float, z: float,
    shift: NDArray[np.float64],  # (terms, 2), or no terms where the main lens is a thin one
    count_alone: bool,
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    at: int,  # where this point's entries begin
    corner: NDArray[np.float64], pieces: NDArray[np.float64], box: NDArray[np.float64], window: NDArray[np.int64],
    bent: NDArray[np.float64], left: NDArray[np.float64], inverse: NDArray[np.float64], crossing: NDArray[np.float64],
    column: NDArray[np.float32], patch: NDArray[np.float32],
) -> int:  # fmt: skip
    """Fill the pixels of a point; how many. ``count_alone``: only count those that there may be."""
    distance = cam.object_distance - z
    a = 1.0 + cam.image_distance / distance - cam.image_distance / cam.focal
    b = -cam.image_distance / distance
    rate = cam.image_distance / (distance * distance)  # A' = -B'
    if abs(a) < SMALLEST_SPREAD:
        a = SMALLEST_SPREAD
    e, px = cam.image_scale, cam.pixel
    image_s, image_t = b * x, b * y
    to_px = e * (1.0 - a) / px  # mm on the main lens -> px of the patch
    cell_px = to_px / a
    swell = 2.0 * rate / (1.0 - a)
    of_cell = min((cell_px * cam.pitch) ** 2 * cam.row_spacing, 1.0)
    ds, dt = image_s - cam.offset_s, image_t - cam.offset_t
    along, across = (cam.cos * ds + cam.sin * dt) / cam.pitch, (cam.cos * dt - cam.sin * ds) / cam.pitch
    wide = 1.0 + cam.growth_s * image_s + cam.growth_t * image_t
    reach = abs(a) * cam.radius * wide / cam.pitch + 0.7072 + cam.moved
    first, thin = at, shift.shape[0] == 0 or not bends(a, cam.radius, shift, left)
    inverse[0], inverse[1], inverse[2], inverse[3] = 1.0 / a, 0.0, 0.0, 1.0 / a
    size = abs(cell_px) * cam.pitch
    number = number_of(whole, size) if thin else -1
    off_size = np.float32(size - (number + 1) * whole.size_step)
    grows = -rate / (a * (1.0 - a))  # cell_px, per mm of z and of itself
    low, high = _lens_rows(cam, across, reach)
    for j in range(max(low, cam.j0), min(high, cam.j0 + centres.shape[0])):
        lo, hi = _lenses_of_row(cam, along, across, reach, j)
        for i in range(max(lo, cam.i0), min(hi, cam.i0 + centres.shape[1])):
            lens_s, lens_t = centres[j - cam.j0, i - cam.i0, 0], centres[j - cam.j0, i - cam.i0, 1]
            radius = cam.radius * to_px * (1.0 + cam.growth_s * lens_s + cam.growth_t * lens_t)
            density = 1.0 / (pi * radius * radius)
            least = LEAST * density * of_cell
            x0 = cam.column0 - (lens_s + e * image_s) / px
            y0 = cam.row0 + (lens_t + e * image_t) / px
            if number >= 0:
                beside_s, beside_t = lens_s - image_s, lens_t - image_t
                most = radius - size * whole.far
                if most > 0.0 and cell_px * cell_px * (beside_s * beside_s + beside_t * beside_t) < most * most:
                    x0, y0 = x0 + cell_px * beside_s, y0 - cell_px * beside_t
                    middle_column, middle_row = floor(x0 + 0.5), floor(y0 + 0.5)
                    half = whole.half[number]
                    window[0], window[1] = max(middle_column - half, 0), max(middle_row - half, 0)
                    window[2] = min(middle_column + half, cam.columns - 1) + 1
                    window[3] = min(middle_row + half, cam.rows - 1) + 1
                    if count_alone:
                        at += max(window[2] - window[0], 0) * max(window[3] - window[1], 0)
                        continue
                    n, dx, dy = place_of(whole, number, x0 - middle_column, y0 - middle_row)
                    off_x, off_y = np.float32(dx), np.float32(dy)
                    here = density * size * size
                    to_x = -here * b * e / (px * a)  # of a px that the middle moves by, per mm of the point's x
                    z_x = here * (rate * x * e / (px * a) + cell_px * grows * beside_s)
                    z_y = -here * (rate * y * e / (px * a) + cell_px * grows * beside_t)
                    z_size, z_share = here * size * grows, here * (2.0 * grows + swell)
                    for r in range(window[1], window[3]):
                        in_row = (r - middle_row + half) * (2 * half + 1) - middle_column + half
                        for c in range(window[0], window[2]):
                            f, fx, fy, fq = expanded(whole.values, np.uint64(n + in_row + c), off_x, off_y, off_size)
                            if here * f > least:
                                to = np.uint64(at)
                                pixel[to] = r * cam.columns + c
                                share[to] = here * f
                                gradient[to, 0] = to_x * fx
                                gradient[to, 1] = -to_x * fy
                                gradient[to, 2] = z_x * fx + z_y * fy + z_size * fq + z_share * f
                                at += 1
                    continue
            for k in range(cam.corners):
                corner[k, 0] = cell_px * (lens_s + cell[k, 0] - image_s)
                corner[k, 1] = -cell_px * (lens_t + cell[k, 1] - image_t)
            if thin and count_alone:
                n = about(corner, cam.corners, radius, box)
            elif thin:
                n = boundary(corner, cam.corners, radius, pieces, box, crossing)
            else:
                points = bend(corner, to_px, a, cam.radius, shift, bent, left, inverse)
                n = boundary(bent, points, radius, pieces, box, crossing)
            if n == 0:
                continue
            pixels = _patch(cam, x0, y0, box, window)
            if pixels == 0:
                continue
            if count_alone:
                at += pixels
                continue
            columns, rows = window[2], window[3]
            for r in range(rows):
                for q in range(4 * columns):
                    patch[r, q] = 0.0
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
                if not (arc or thin):
                    left_of(shift, cam.radius, (px0 + 0.5 * dx) / to_px, -(py0 + 0.5 * dy) / to_px, left)
                    inverse_of(a, left, inverse)
                    for k in range(4):
                        inverse[k] *= 1.0 - a
                    inverse[0] += 1.0
                    inverse[3] += 1.0
                nodes = nodes_of(length)
                for node in range(nodes):
                    middle, ds_px = node_of(node, nodes, length)
                    if arc:
                        angle = pieces[p, 1] + middle * turn
                        nx, ny = cos(angle), sin(angle)
                        wx, wy = radius * nx, radius * ny
                        along_u, along_v = nx, -ny
                    else:
                        wx, wy = px0 + middle * dx, py0 + middle * dy
                        nx, ny = dy / length, -dx / length
                        along_u, along_v = nx * inverse[0] - ny * inverse[2], nx * inverse[1] - ny * inverse[3]
                    # along the columns, u of the main lens is wx / to_px; along the rows, -wy / to_px
                    factor = e / px * ds_px * density
                    gx, gy = -b * along_u * factor, -b * along_v * factor
                    gz = rate * ((x - wx / to_px) * along_u + (y + wy / to_px) * along_v) * factor
                    of_share = nx * ds_px * density
                    here_x, here_y = x0 + wx - window[0], y0 + wy - window[1]
                    at_node(cam.tail_px, profile, here_x, here_y, rows, columns, of_share, gx, gy, gz, column, patch)
            for r in range(rows):
                for c in range(columns):
                    if patch[r, 4 * c] > least:
                        pixel[at] = (window[1] + r) * cam.columns + window[0] + c
                        share[at] = patch[r, 4 * c]
                        gradient[at, 0] = patch[r, 4 * c + 1]
                        gradient[at, 1] = patch[r, 4 * c + 2]
                        gradient[at, 2] = patch[r, 4 * c + 3] + swell * patch[r, 4 * c]
                        at += 1
    return at - first


@kernel
def light_of_points(
    begin: int, end: int,
    cam: LightConstants,
    centres: NDArray[np.float64], cell: NDArray[np.float64], profile: NDArray[np.float32], whole: WholeCells,
    position: NDArray[np.float64],  # (points, 3): x, y, z, mm
    shift: NDArray[np.float64],  # (points, terms, 2)
    count_alone: bool,
    start: NDArray[np.int64],  # (points,): where a point's entries begin
    count: NDArray[np.int64],  # (points,): filled, how many a point has, or may have where count_alone
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
) -> None:  # fmt: skip
    """Pixels, shares and gradients of points ``begin`` to ``end``, or how many pixels each may light."""
    corner, bent = np.empty((cam.corners, 2)), np.empty((cam.corners * (MOST + 2), 2))
    pieces, left, inverse = np.empty((2 * len(bent) + 2, 5)), np.empty(6), np.empty(4)
    crossing = np.empty((2, len(bent)))
    box, window = np.empty(4), np.empty(4, np.int64)
    side = int(2.0 * cam.radius * cam.image_scale / cam.pixel * 1.5) + 8
    column, patch = np.empty(4 * side, np.float32), np.empty((side, 4 * side), np.float32)
    for n in range(begin, end):
        count[n] = _light_of_point(
            cam, centres, cell, profile, whole, position[n, 0], position[n, 1], position[n, 2],
            shift[n], count_alone,
            pixel, share, gradient, start[n], corner, pieces, box, window, bent, left, inverse,
            crossing, column, patch,
        )  # fmt: skip
