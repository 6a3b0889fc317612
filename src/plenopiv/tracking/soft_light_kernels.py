"""The light of a point where the main lens blurs, in every pixel, with its derivatives: sums over parts of pixels.

Under the microlens S a point's light is a patch on the sensor: the image of the aperture, a disc, times what of the
rays through each place of it arrives in the microlens' cell (``soft_cells``). The cell has no boundary then, so Gauss'
theorem (``light_kernels``) does not serve. Each pixel is cut into PARTS x PARTS squares. A square holds

    density * cover(R - |w|) * cell(A u + B x - S)

of light, w = X - x0 its place in the disc, u = w / to_px that on the main lens, cover how much of the square the disc
covers. As the point moves, the square stands still, and ``light_kernels``' symbols make of its change

    dw/dx = e B / px    d(A u + B x)/dx = B / (1 - A)    d(A u + B x)/dz = (A' u + B' x) / (1 - A)

and along z the disc and its density change as well. Diffraction gives each square's light to its pixel and to the
next ones.
"""

from __future__ import annotations

from math import ceil, floor, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part
from plenopiv.tracking.bent_cells import left_of
from plenopiv.tracking.light_kernels import LEAST, SMALLEST_SPREAD, LightConstants, _lens_rows, _lenses_of_row
from plenopiv.tracking.soft_cells import SoftCell

PARTS = 4  # of a pixel's side


@part
def _squares(
    cam: LightConstants,
    soft: SoftCell,
    weights: NDArray[np.float32],
    x: float, y: float,  # of the point, mm
    a: float, b: float, rate: float,
    lens_s: float, lens_t: float,
    x0: float, y0: float,  # the disc's middle, px
    radius: float, to_px: float,
    shift: NDArray[np.float64],
    window: NDArray[np.int64],  # first column and row of the squares' pixels, columns, rows
    left: NDArray[np.float64], column: NDArray[np.float32], patch: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add the light of all squares of a patch, and its derivatives, to ``patch`` (rows, 4 columns)."""
    count, near = weights.shape[0], weights.shape[1]
    side = 1.0 / count
    columns, rows = window[2], window[3]
    wide = 4 * (columns + near - 1)
    image_s, image_t = b * x, b * y
    by_point, by_depth = cam.image_scale * b / cam.pixel, cam.image_scale * rate / cam.pixel
    slower = 1.0 / (1.0 - a)
    last_t, last_s = soft.values.shape[0] - 1, soft.values.shape[1] - 1
    for row in range(rows):
        for part_y in range(count):
            wy = window[1] + row + (part_y + 0.5) * side - 0.5 - y0
            chord = (radius + 0.5 * side) ** 2 - wy * wy
            if chord <= 0.0:
                continue
            chord = sqrt(chord)
            v = -wy / to_px
            for q in range(wide):
                column[q] = 0.0
            first = max(floor(x0 - chord + 0.5) - window[0], 0)
            last = min(floor(x0 + chord + 0.5) - window[0] + 1, columns)
            for c in range(first, last):
                for part_x in range(count):
                    wx = window[0] + c + (part_x + 0.5) * side - 0.5 - x0
                    far = sqrt(wx * wx + wy * wy)
                    cover = (radius - far) * count + 0.5
                    if cover <= 0.0:
                        continue
                    u = wx / to_px
                    s, t = a * u + image_s - lens_s, a * v + image_t - lens_t
                    if shift.shape[0] > 0:
                        left_of(shift, cam.radius, u, v, left)
                        s += left[0]
                        t += left[1]
                    at_s, at_t = (s + soft.half_s) / soft.step, (t + soft.half_t) / soft.step
                    if not (0.0 <= at_s < last_s and 0.0 <= at_t < last_t):
                        continue
                    i, j = int(at_s), int(at_t)
                    along, across = np.float32(at_s - i), np.float32(at_t - j)
                    w00, w01 = (np.float32(1) - along) * (np.float32(1) - across), along * (np.float32(1) - across)
                    w10, w11 = (np.float32(1) - along) * across, along * across
                    one, other = soft.values[j], soft.values[j + 1]
                    cell = w00 * one[i, 0] + w01 * one[i + 1, 0] + w10 * other[i, 0] + w11 * other[i + 1, 0]
                    cell_s = w00 * one[i, 1] + w01 * one[i + 1, 1] + w10 * other[i, 1] + w11 * other[i + 1, 1]
                    cell_t = w00 * one[i, 2] + w01 * one[i + 1, 2] + w10 * other[i, 2] + w11 * other[i + 1, 2]
                    mx, my = rate * (u - x) * slower, rate * (v - y) * slower
                    gx, gy = b * slower * cell_s, b * slower * cell_t
                    if shift.shape[0] > 0:
                        gx, gy = (
                            gx + b * slower * (left[2] * cell_s + left[4] * cell_t),
                            gy + b * slower * (left[3] * cell_s + left[5] * cell_t),
                        )
                        mx, my = mx + left[2] * mx + left[3] * my, my + left[4] * mx + left[5] * my
                    gz = mx * cell_s + my * cell_t
                    if cover < 1.0:
                        rim = cell * count
                        share = cover * cell
                        gx = cover * gx - rim * wx * by_point / far
                        gy = cover * gy + rim * wy * by_point / far
                        gz = cover * gz + rim * ((wx * x - wy * y) * by_depth / far - radius * rate * slower)
                    else:
                        share = cell
                    share32, gx32, gy32, gz32 = np.float32(share), np.float32(gx), np.float32(gy), np.float32(gz)
                    for n in range(near):
                        weight, q = weights[part_x, n], 4 * (c + n)
                        column[q] += weight * share32
                        column[q + 1] += weight * gx32
                        column[q + 2] += weight * gy32
                        column[q + 3] += weight * gz32
            low, high = 4 * first, 4 * (last + near - 1)
            for n in range(near):
                weight = weights[part_y, n]
                for q in range(low, high):
                    patch[row + n, q] += weight * column[q]


@part
def _light_of_point(
    cam: LightConstants,
    centres: NDArray[np.float64],  # (nj, ni, 2): centres of the microlenses, mm
    soft: SoftCell,
    weights: NDArray[np.float32],  # (parts, neighbours)
    x: float, y: float, z: float,
    shift: NDArray[np.float64],  # (terms, 2), or no terms where the main lens is a thin one
    count_alone: bool,
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
    at: int,  # where this point's entries begin
    window: NDArray[np.int64], left: NDArray[np.float64], column: NDArray[np.float32], patch: NDArray[np.float32],
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
    widest = cam.radius * (1.0 + cam.growth_s * image_s + cam.growth_t * image_t)
    half = sqrt(soft.half_s * soft.half_s + soft.half_t * soft.half_t)
    reach = (abs(a) * widest + half) / cam.pitch + cam.moved
    count, near = weights.shape[0], weights.shape[1] // 2
    first = at
    low, high = _lens_rows(cam, across, reach)
    for j in range(max(low, cam.j0), min(high, cam.j0 + centres.shape[0])):
        lo, hi = _lenses_of_row(cam, along, across, reach, j)
        for i in range(max(lo, cam.i0), min(hi, cam.i0 + centres.shape[1])):
            lens_s, lens_t = centres[j - cam.j0, i - cam.i0, 0], centres[j - cam.j0, i - cam.i0, 1]
            radius = cam.radius * to_px * (1.0 + cam.growth_s * lens_s + cam.growth_t * lens_t)
            left_x, right_x, left_y, right_y = -radius, radius, -radius, radius
            if shift.shape[0] == 0:  # where rays fall beside, the cell may be anywhere in the disc
                at_x, at_y = cell_px * (lens_s - image_s), -cell_px * (lens_t - image_t)
                wide, high_px = abs(cell_px) * soft.half_s, abs(cell_px) * soft.half_t
                left_x, right_x = max(left_x, at_x - wide), min(right_x, at_x + wide)
                left_y, right_y = max(left_y, at_y - high_px), min(right_y, at_y + high_px)
            if left_x >= right_x or left_y >= right_y:
                continue
            x0 = cam.column0 - (lens_s + e * image_s) / px
            y0 = cam.row0 + (lens_t + e * image_t) / px
            window[0], window[1] = floor(x0 + left_x + 0.5), floor(y0 + left_y + 0.5)
            window[2] = ceil(x0 + right_x + 0.5) - window[0]
            window[3] = ceil(y0 + right_y + 0.5) - window[1]
            columns, rows = window[2] + 2 * near, window[3] + 2 * near
            if count_alone:
                at += columns * rows
                continue
            for r in range(rows):
                for q in range(4 * columns):
                    patch[r, q] = 0.0
            _squares(
                cam, soft, weights, x, y, a, b, rate, lens_s, lens_t, x0, y0, radius, to_px, shift, window, left,
                column, patch,
            )  # fmt: skip
            density = 1.0 / (pi * radius * radius * count * count)
            least = LEAST * of_cell * count * count
            for r in range(rows):
                row = window[1] - near + r
                if row < 0 or row >= cam.rows:
                    continue
                for c in range(columns):
                    col = window[0] - near + c
                    if patch[r, 4 * c] > least and 0 <= col < cam.columns:
                        pixel[at] = row * cam.columns + col
                        share[at] = density * patch[r, 4 * c]
                        gradient[at, 0] = density * patch[r, 4 * c + 1]
                        gradient[at, 1] = density * patch[r, 4 * c + 2]
                        gradient[at, 2] = density * (patch[r, 4 * c + 3] + swell * patch[r, 4 * c])
                        at += 1
    return at - first


@kernel
def soft_light_of_points(
    begin: int, end: int,
    cam: LightConstants,
    centres: NDArray[np.float64], soft: SoftCell, weights: NDArray[np.float32],
    position: NDArray[np.float64],  # (points, 3): x, y, z, mm
    shift: NDArray[np.float64],  # (points, terms, 2)
    count_alone: bool,
    start: NDArray[np.int64],  # (points,): where a point's entries begin
    count: NDArray[np.int64],  # (points,): filled, how many a point has, or may have where count_alone
    pixel: NDArray[np.int32], share: NDArray[np.float32], gradient: NDArray[np.float32],
) -> None:  # fmt: skip
    """Pixels, shares and gradients of points ``begin`` to ``end``, or how many pixels each may light."""
    window, left = np.empty(4, np.int64), np.empty(6)
    side = int(2.0 * cam.radius * cam.image_scale / cam.pixel * 1.5) + 8 + weights.shape[1]
    column, patch = np.empty(4 * side, np.float32), np.empty((side, 4 * side), np.float32)
    for n in range(begin, end):
        count[n] = _light_of_point(
            cam, centres, soft, weights, position[n, 0], position[n, 1], position[n, 2],
            shift[n], count_alone, pixel, share, gradient, start[n], window, left, column, patch,
        )  # fmt: skip
