"""CPU kernels for sparse volumes, run from the voxel's side: for each listed voxel the microlenses that take its light.

A block of listed voxels of one plane is worked on at once. The microlenses that a voxel may light in a view are a small
window of lattice indices, SLOTS of them for every voxel of the plane; slot by slot their shares are plain arithmetic
on whole vectors of voxels, without a branch or a look-up (a lens' phase comes from ``Layout.clock``). Only then are the
images read or added to.

The list is cut into fixed chunks; each sums into an image of its own and the caller adds those in order, so results
do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from plenopiv.kernels import kernel, parallel_kernel
from plenopiv.projection.footprint import TIP
from plenopiv.projection.pixels import (
    EXACT,
    ONE_RAY,
    floor_of,
    pixel_share,
    plane_of,
    ray_inside,
    ray_share,
    rim_share,
)

BLOCK = 128  # voxels worked on at once
F = np.float32
PX = F(2.0**-32)  # of the clock's ticks


@kernel
def window_of(geo, plane, rule):
    """The window of lenses around a voxel: its half widths in cells along and across rows, its lenses and rows."""
    half = plane.half if rule == EXACT else F(0.67) * plane.half * (abs(geo.cos) + abs(geo.sin))
    moved = F(0.5) * abs(plane.move) * (abs(geo.cos) + abs(geo.sin))  # what a phase of half a pixel can move
    wide = F(0.5) + half + moved
    high = (TIP if geo.hexagonal else F(0.5)) + half + moved
    return wide, high, np.int64(F(2) * wide / plane.pitch) + 1, np.int64(F(2) * high / (plane.pitch * geo.row)) + 1


@kernel
def slot_places(geo, box, clock, plane, count, cx, cy, first_i, j_of, dj, di, lens, x, y, qx, qy, inside, m, n):
    """For one slot: the lens of each voxel, where the voxel lies from its footprint's centre (cells), and the pixel's
    q.

    ``lens`` is the flat index or, outside the block of lenses, one past the last; ``inside`` 1 or 0.
    """
    i0, j0, ni, nj = box
    spacing = plane.pitch * geo.row
    for k in range(count):
        j = j_of[k] + dj
        odd = (j & 1) if geo.hexagonal else 0
        i = first_i[k] + di
        half_pitches = 2 * i + odd
        phase_c = F(np.int32(clock[0, 0] + half_pitches * clock[1, 0] + j * clock[2, 0])) * PX
        phase_r = F(np.int32(clock[0, 1] + half_pitches * clock[1, 1] + j * clock[2, 1])) * PX
        px, py = -plane.move * phase_c, plane.move * phase_r
        x[k] = cx[k] - F(0.5) * plane.pitch * F(half_pitches) + geo.cos * px + geo.sin * py
        y[k] = cy[k] - spacing * F(j) + geo.cos * py - geo.sin * px
        qx[k], qy[k] = m - phase_c, phase_r - n
        here = (i >= i0) & (i < i0 + ni) & (j >= j0) & (j < j0 + nj)
        lens[k] = (j - j0) * ni + (i - i0) if here else ni * nj
        inside[k] = F(1) if here else F(0)


@kernel
def slot_shares(geo, plane, rule, rim, share, count, lens, x, y, qx, qy, inside, weight):
    """For one slot: the share of its lens' pixel that each voxel gives, into ``weight``."""
    if rule == ONE_RAY:
        for k in range(count):
            lit = share[lens[k]] if inside[k] > F(0) else F(0)
            weight[k] = lit * ray_inside(geo, x[k], y[k])
    elif rule == EXACT and not rim:
        for k in range(count):
            weight[k] = inside[k] * pixel_share(geo, plane, x[k], y[k])
    elif rule == EXACT:
        for k in range(count):
            weight[k] = inside[k] * rim_share(geo, plane, qx[k], qy[k], x[k], y[k])
    else:
        for k in range(count):
            weight[k] = F(0)
        for ray in range(9):
            for k in range(count):
                weight[k] += inside[k] * ray_share(geo, plane, rim, qx[k], qy[k], ray, x[k], y[k])


@kernel
def block_begin(geo, plane, m, n, count, column, row, cx, cy, j_of, high):
    """Voxels of a block in cells from lens (0, 0), seen through the view's nominal portion, and their first row of
    lenses."""
    spacing = plane.pitch * geo.row
    for k in range(count):
        ax = plane.cell_x * (geo.x0 + F(column[k])) + plane.move * m - plane.origin_x
        ay = plane.cell_y * (geo.y0 + F(row[k])) - plane.move * n - plane.origin_y
        cx[k], cy[k] = geo.cos * ax + geo.sin * ay, geo.cos * ay - geo.sin * ax
        j_of[k] = floor_of((cy[k] - high) / spacing) + 1


@kernel
def block_columns(geo, plane, count, cx, j_of, dj, wide, first_i):
    """First lens of the window in its row ``dj``, for each voxel of a block."""
    for k in range(count):
        odd = F((j_of[k] + dj) & 1) if geo.hexagonal else F(0)
        first_i[k] = floor_of((cx[k] - wide) / plane.pitch - F(0.5) * odd) + 1


@kernel
def fill_block(plane_end, start, row, ny, row_start, column, block_column, block_row):
    """The next block of listed voxels of a plane from voxel ``start`` in ``row``; returns their number and the row
    reached."""
    count = 0
    while count < BLOCK and start + count < plane_end:
        while row_start[row + 1] <= start + count:
            row += 1
        block_column[count] = column[start + count]
        block_row[count] = row % ny
        count += 1
    return count, row


@parallel_kernel
def walk(
    geo, box, clock, table, ny, rule, rim, m, n, share, chunks, row_start, column, values, image, partial, out, scatter
):
    """The listed voxels and the lenses that each lights in one view.

    ``scatter``: add the voxels' light to ``partial`` (chunk, lens + 1). Otherwise: the share-weighted sum of ``image``
    (lens + 1,) for each voxel into ``out``. ``chunks``: bounds of runs of rows.
    """
    for c in prange(chunks.size - 1):
        block_column, block_row = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
        j_of, first_i = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
        cx, cy = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        x, y, qx, qy = (
            np.empty(BLOCK, np.float32),
            np.empty(BLOCK, np.float32),
            np.empty(BLOCK, np.float32),
            np.empty(BLOCK, np.float32),
        )
        inside, weight = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        lens, total = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.float32)
        if scatter:
            partial[c, :] = F(0)
        row = chunks[c]
        while row < chunks[c + 1]:
            plane = plane_of(table, row // ny)
            last_row = min((row // ny + 1) * ny, chunks[c + 1])
            start, plane_end = row_start[row], row_start[last_row]
            wide, high, lenses, lens_rows = window_of(geo, plane, rule)
            while start < plane_end:
                count, row = fill_block(plane_end, start, row, ny, row_start, column, block_column, block_row)
                block_begin(geo, plane, m, n, count, block_column, block_row, cx, cy, j_of, high)
                for k in range(count):
                    total[k] = values[start + k] * plane.light if scatter else F(0)
                for dj in range(lens_rows):
                    block_columns(geo, plane, count, cx, j_of, dj, wide, first_i)
                    for di in range(lenses):
                        slot_places(
                            geo,
                            box,
                            clock,
                            plane,
                            count,
                            cx,
                            cy,
                            first_i,
                            j_of,
                            dj,
                            di,
                            lens,
                            x,
                            y,
                            qx,
                            qy,
                            inside,
                            m,
                            n,
                        )
                        slot_shares(geo, plane, rule, rim, share, count, lens, x, y, qx, qy, inside, weight)
                        if scatter:
                            for k in range(count):
                                if weight[k] > F(0):
                                    partial[c, lens[k]] += weight[k] * total[k]
                        else:
                            for k in range(count):
                                total[k] += weight[k] * image[lens[k]]
                if not scatter:
                    for k in range(count):
                        out[start + k] = total[k]
                start += count
            row = last_row
