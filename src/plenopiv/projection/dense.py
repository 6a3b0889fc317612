"""CPU kernels for dense planes of voxels, run from the microlens' side.

For a view and a plane each microlens has a footprint of some 5 to 10 voxels a side, contiguous along x: no list of
voxels, no gather. Threads own microlenses (forward) or planes (back), so no sum depends on their number.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from plenopiv.kernels import inlined, kernel, parallel_kernel
from plenopiv.projection.pixels import (
    EXACT,
    ONE_RAY,
    STRIPS,
    floor_of,
    pixel_share,
    plane_of,
    ray_inside,
    ray_share,
    reach_of,
    strip_share,
)

LANES = 16  # voxels of a row computed at once: the widest float32 vector
F = np.float32


@inlined
def outward(x, by):
    """``x`` moved away from 0."""
    return x + by if x >= F(0) else x - by


@kernel
def row_weights(geo, plane, rule, rim, share, qx, qy, x0, y0, step_x, step_y, out_x, out_y, n, weight):
    """Shares of a pixel for voxels in a row: voxel i lies (x0 + i step_x, y0 + i step_y) cells off its footprint's
    centre.

    Computes whole vectors of LANES voxels, so that no scalar remainder is left: n is a multiple of LANES. Voxels
    outside the footprint get 0. ``share``: of the pixel that is lit, for a single ray. ``out_x``, ``out_y``: cells by
    which an exact area is taken further out than the voxel's centre.
    """
    for b in range(0, n, LANES):
        part = weight[b : b + LANES]
        if rule == EXACT and not rim:
            for i in range(LANES):
                f = F(b + i)
                x, y = outward(x0 + f * step_x, out_x), outward(y0 + f * step_y, out_y)
                part[i] = pixel_share(geo, plane, x, y)
        elif rule == EXACT:
            part[:] = F(0)
            for strip in range(STRIPS):
                for i in range(LANES):
                    f = F(b + i)
                    x, y = outward(x0 + f * step_x, out_x), outward(y0 + f * step_y, out_y)
                    part[i] += strip_share(geo, plane, qx, qy, strip, x, y)
        elif rule == ONE_RAY:
            for i in range(LANES):
                f = F(b + i)
                part[i] = share * ray_inside(geo, x0 + f * step_x, y0 + f * step_y)
        else:
            part[:] = F(0)
            for ray in range(9):
                for i in range(LANES):
                    f = F(b + i)
                    part[i] += ray_share(geo, plane, rim, qx, qy, ray, x0 + f * step_x, y0 + f * step_y)


@kernel
def footprint_of(geo, plane, rule, s, t, qx, qy):
    """Where a pixel's light comes from in a plane: centre and half widths (voxels, x and y) of the box around it."""
    cx = plane.voxel_s * s + plane.step_x * qx - geo.x0
    cy = plane.voxel_t * t + plane.step_y * qy - geo.y0
    wide, high = reach_of(geo, plane, rule)
    c, s = abs(geo.cos), abs(geo.sin)
    reach_x = (c * wide + s * high) / abs(plane.cell_x)
    reach_y = (c * high + s * wide) / abs(plane.cell_y)
    return cx, cy, reach_x, reach_y


@parallel_kernel
def forward(geo, table, rule, rim, m, n, lens_mm, phase, share, seen, chunks, volume, image):
    """Light of ``volume`` (nz, ny, nx) in every microlens of one view, into ``image`` (lens,); unseen pixels get 0."""
    nz, ny, nx = volume.shape
    for c in prange(chunks.size - 1):
        weight = np.empty(nx + LANES, np.float32)
        image[chunks[c] : chunks[c + 1]] = F(0)  # threads own lenses
        for k in range(nz):
            plane = plane_of(table, k)
            for lens in range(chunks[c], chunks[c + 1]):
                if not seen[lens]:
                    continue
                qx, qy = m - phase[lens, 0], phase[lens, 1] - n
                cx, cy, reach_x, reach_y = footprint_of(geo, plane, rule, lens_mm[lens, 0], lens_mm[lens, 1], qx, qy)
                i0, i1 = max(floor_of(cx - reach_x) + 1, 0), min(floor_of(cx + reach_x) + 1, nx - LANES)
                j0, j1 = max(floor_of(cy - reach_y) + 1, 0), min(floor_of(cy + reach_y) + 1, ny)
                if i0 >= i1 or j0 >= j1:
                    continue
                total = F(0)
                lanes = (i1 - i0 + LANES - 1) // LANES * LANES
                step_x, step_y = plane.cell_x * geo.cos, -plane.cell_x * geo.sin
                for j in range(j0, j1):
                    row = volume[k, j, i0 : i0 + lanes]
                    if is_dark(row):
                        continue
                    ox, oy = plane.cell_x * (F(i0) - cx), plane.cell_y * (F(j) - cy)
                    x0, y0 = geo.cos * ox + geo.sin * oy, geo.cos * oy - geo.sin * ox
                    row_weights(
                        geo, plane, rule, rim, share[lens], qx, qy, x0, y0, step_x, step_y, F(0), F(0), lanes, weight
                    )
                    for i in range(lanes):
                        total += weight[i] * row[i]
                image[lens] += plane.light * total


@kernel
def is_dark(row):
    """Whether voxels (none negative) are all empty."""
    total = F(0)
    for i in range(row.size):
        total += row[i]
    return total == F(0)


@kernel
def spread_back(geo, plane, rule, rim, m, n, lens_mm, phase, share, seen, image, where, weight, out):
    """Sum of share times ``image`` (lens,) over the microlenses that each voxel of a plane lights, added to ``out``.

    ``where`` and ``out`` are (ny, nx); stretches of a row in which ``where`` is 0 throughout are left out.
    """
    ny, nx = out.shape
    for lens in range(image.size):
        value = image[lens]
        if not seen[lens] or value == F(0):
            continue
        qx, qy = m - phase[lens, 0], phase[lens, 1] - n
        cx, cy, reach_x, reach_y = footprint_of(geo, plane, rule, lens_mm[lens, 0], lens_mm[lens, 1], qx, qy)
        i0, i1 = max(floor_of(cx - reach_x) + 1, 0), min(floor_of(cx + reach_x) + 1, nx - LANES)
        j0, j1 = max(floor_of(cy - reach_y) + 1, 0), min(floor_of(cy + reach_y) + 1, ny)
        if i0 >= i1 or j0 >= j1:
            continue
        lanes = (i1 - i0 + LANES - 1) // LANES * LANES
        step_x, step_y = plane.cell_x * geo.cos, -plane.cell_x * geo.sin
        for j in range(j0, j1):
            if is_dark(where[j, i0 : i0 + lanes]):
                continue
            ox, oy = plane.cell_x * (F(i0) - cx), plane.cell_y * (F(j) - cy)
            x0, y0 = geo.cos * ox + geo.sin * oy, geo.cos * oy - geo.sin * ox
            row_weights(geo, plane, rule, rim, share[lens], qx, qy, x0, y0, step_x, step_y, F(0), F(0), lanes, weight)
            row = out[j, i0 : i0 + lanes]
            for i in range(lanes):
                row[i] += weight[i] * value


@parallel_kernel
def adjoint(geo, table, rule, rim, m, n, lens_mm, phase, share, seen, image, out):
    """The transpose of ``forward``: ``out`` (nz, ny, nx) += A' image."""
    nz, ny, nx = out.shape
    for k in prange(nz):
        weight = np.empty(nx + LANES, np.float32)
        total, everywhere = np.zeros((ny, nx), np.float32), np.ones((ny, nx), np.float32)
        plane = plane_of(table, k)
        spread_back(geo, plane, rule, rim, m, n, lens_mm, phase, share, seen, image, everywhere, weight, total)
        for j in range(ny):
            for i in range(nx - LANES):
                out[k, j, i] += plane.light * total[j, i]


@parallel_kernel
def multiply(geo, table, rule, rim, m, n, lens_mm, phase, share, seen, image, volume):
    """MART's correction by one view: each voxel times (1 + sum of share times ``image``), kept >= 0."""
    nz, ny, nx = volume.shape
    for k in prange(nz):
        weight = np.empty(nx + LANES, np.float32)
        total = np.zeros((ny, nx), np.float32)
        plane, values = plane_of(table, k), volume[k]
        spread_back(geo, plane, rule, rim, m, n, lens_mm, phase, share, seen, image, values, weight, total)
        for j in range(ny):
            for i in range(nx):
                values[j, i] *= max(F(1) + total[j, i], F(0))
