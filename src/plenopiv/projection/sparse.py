"""CPU kernels for sparse volumes, run from the voxel's side: for each listed voxel the microlenses that take its light.

The list is cut into fixed chunks; each sums into an image of its own and the caller adds those in order, so that results
do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from plenopiv.projection.footprint import TIP
from plenopiv.projection.pixels import EXACT, FAST, floor_of, pixel_share, plane_of

LENSES = 256  # that one voxel can light in one view
F = np.float32


@njit(fastmath=FAST, cache=True)
def lit_lenses(geo, box, plane, rule, rim, m, n, x, y, phase, cut, share, seen, lens, weight):
    """The seen microlenses that take light of the voxel (x, y) (voxels from the axis) in view (m, n), and its shares.

    Fills ``lens`` and ``weight``; returns their number. ``box`` is (i0, j0, ni, nj) of the block of lenses.
    """
    i0, j0, ni, nj = box
    half = plane.half if rule == EXACT else F(0.70) * plane.half
    wide, high = F(0.5) + half, (TIP if geo.hexagonal else F(0.5)) + half
    # voxel in cells from lens (0, 0), seen through the view's nominal portion
    ax, ay = plane.cell_x * x + plane.move * m - plane.origin_x, plane.cell_y * y - plane.move * n - plane.origin_y
    cx, cy = geo.cos * ax + geo.sin * ay, geo.cos * ay - geo.sin * ax
    slack = F(0.5) * abs(plane.move) * (abs(geo.cos) + abs(geo.sin))  # what the phase can move it
    spacing, pitch = plane.pitch * geo.row, plane.pitch
    count = 0
    for j in range(
        max(floor_of((cy - high - slack) / spacing) + 1, j0), min(floor_of((cy + high + slack) / spacing) + 1, j0 + nj)
    ):
        shift = F(0.5) * F(j & 1) if geo.hexagonal else F(0)
        dy = cy - spacing * F(j)
        for i in range(
            max(floor_of((cx - wide - slack) / pitch - shift) + 1, i0),
            min(floor_of((cx + wide + slack) / pitch - shift) + 1, i0 + ni),
        ):
            index = (j - j0) * ni + (i - i0)
            px, py = -plane.move * phase[index, 0], plane.move * phase[index, 1]
            oy = dy + geo.cos * py - geo.sin * px
            ox = cx - pitch * (F(i) + shift) + geo.cos * px + geo.sin * py
            if abs(oy) >= high or abs(ox) >= wide or not seen[index]:
                continue
            qx, qy = m - phase[index, 0], phase[index, 1] - n
            part = pixel_share(geo, plane, rule, rim, cut, index, share, qx, qy, ox, oy)
            if part > F(0) and count < LENSES:
                lens[count] = index
                weight[count] = part
                count += 1
    return count


@njit(parallel=True, fastmath=FAST, cache=True)
def forward(geo, box, table, ny, rule, rim, m, n, phase, cut, share, seen, chunks, row_start, column, values, partial):
    """Light of the listed voxels in one view, a sum per chunk of rows into ``partial`` (chunk, lens)."""
    for c in prange(chunks.size - 1):
        lens, weight = np.empty(LENSES, np.int32), np.empty(LENSES, np.float32)
        image = partial[c]
        image[:] = F(0)
        for row in range(chunks[c], chunks[c + 1]):
            plane = plane_of(table, row // ny)
            y = geo.y0 + F(row % ny)
            for v in range(row_start[row], row_start[row + 1]):
                light, x = values[v] * plane.light, geo.x0 + F(column[v])
                count = lit_lenses(geo, box, plane, rule, rim, m, n, x, y, phase, cut, share, seen, lens, weight)
                for k in range(count):
                    image[lens[k]] += weight[k] * light


@njit(parallel=True, fastmath=FAST, cache=True)
def gather(geo, box, table, ny, rule, rim, m, n, phase, cut, share, seen, chunks, row_start, column, image, out):
    """For each listed voxel the share-weighted sum of ``image`` (lens,) over the microlenses that it lights."""
    for c in prange(chunks.size - 1):
        lens, weight = np.empty(LENSES, np.int32), np.empty(LENSES, np.float32)
        for row in range(chunks[c], chunks[c + 1]):
            plane = plane_of(table, row // ny)
            y = geo.y0 + F(row % ny)
            for v in range(row_start[row], row_start[row + 1]):
                x = geo.x0 + F(column[v])
                count = lit_lenses(geo, box, plane, rule, rim, m, n, x, y, phase, cut, share, seen, lens, weight)
                total = F(0)
                for k in range(count):
                    total += weight[k] * image[lens[k]]
                out[v] = total
