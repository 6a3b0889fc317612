"""CPU kernels for dense planes of voxels, run from the microlens' side over tabulated footprints (``patterns``).

For a view and a plane each microlens has a footprint of some 5 to 15 voxels a side. Its shares are looked up as a
whole: what is left is a product of two contiguous rows. Footprints without light are told by a map of tiles. Threads
own planes; forward, a fixed number of images is summed in order, so that no sum depends on the number of threads.

Arrays are flat and indices unsigned where they are multiplied: an index that might be negative keeps loops from being
vectorised.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import prange

from plenopiv.kernels import inlined, kernel, parallel_kernel
from plenopiv.projection.patterns import LEVELS
from plenopiv.projection.pixels import floor_of, plane_of
from plenopiv.projection.simd import row_products

PADDING = 16  # columns of zeros beyond a volume's last: hardly a pattern that begins inside ends outside
TILE = 8  # voxels along x and y that share a flag whether any of them holds light
F, U = np.float32, np.uint64
GAUSS = F(0.28867513)  # of a pixel: the two points at which its lit length is taken


@inlined
def lit_length(geo, base, v):
    """How much of a pixel's line at ``v`` lies inside the rim, which is ``base`` px further out than its middle."""
    edge = sqrt(max(geo.radius * geo.radius - v * v, F(0.01))) - base
    return max(min(edge, F(0.5)), F(-0.5)) + F(0.5)


@inlined
def lit_part(geo, plane, qx, qy):
    """Of a pixel at the rim: whether the rim cuts it along x, the lit length, and the lit part's centre off its own
    (x, y), px."""
    along_x = abs(qx) > abs(qy)
    u, v = abs(qx) if along_x else abs(qy), qy if along_x else qx
    outward = F(1) if (qx if along_x else qy) > F(0) else F(-1)
    base = u + plane.spread * (sqrt(max(geo.radius * geo.radius - v * v, F(0.01))) - u)
    one, two = lit_length(geo, base, v - GAUSS), lit_length(geo, base, v + GAUSS)
    lit = F(0.5) * (one + two)
    du, dv = outward * F(0.5) * (lit - F(1)), GAUSS * (two - one) / max(one + two, F(1e-6))
    return along_x, lit, (du if along_x else dv), (dv if along_x else du)


class Table(NamedTuple):
    """The tables of one plane: size of a pattern, phases a voxel and where they begin, for whole pixels and cut ones;
    from a footprint's centre to its box's side (voxels)."""

    rows: int
    columns: int
    phases: int
    cut_phases: int
    whole: int
    cut: int
    reach_x: np.float32
    reach_y: np.float32


@kernel
def table_of(shape, start, reach, k):
    """The ``Table`` of plane k."""
    return Table(shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3], start[k, 0], start[k, 1], reach[k, 0], reach[k, 1])


@kernel
def pattern_of(geo, plane, table, rim, s, t, qx, qy):
    """A microlens' footprint: first column and row, where its pattern begins in the table, and a factor for it (0:
    dark)."""
    factor, level, phases, at = F(1), 0, table.phases, table.whole
    if rim:
        along_x, lit, dx, dy = lit_part(geo, plane, qx, qy)
        qx, qy = qx + dx, qy + dy
        level = min(max(int(lit * F(LEVELS) + F(0.5)), 1), LEVELS)
        factor = lit * F(LEVELS) / F(level)
        phases = table.cut_phases
        across = along_x == geo.swapped
        at = table.cut + (level - 1 + (LEVELS if across else 0)) * phases * phases * table.rows * table.columns
    left = plane.voxel_s * s + plane.step_x * qx - geo.x0 - table.reach_x
    top = plane.voxel_t * t + plane.step_y * qy - geo.y0 - table.reach_y
    i, j = floor_of(left) + 1, floor_of(top) + 1  # the first voxel inside
    px = min(int((F(i) - left) * F(phases)), phases - 1)
    py = min(int((F(j) - top) * F(phases)), phases - 1)
    return i, j, at + (py * phases + px) * table.rows * table.columns, factor


@inlined
def clipped(i, j, columns, rows, nx, ny):
    """The part of a footprint that begins at column i and row j inside a plane: first and last column, first row and
    number of rows (0: none)."""
    first, last, low, high = max(i, 0), min(i + columns, nx), max(j, 0), min(j + rows, ny)
    return first, last, low, (high - low if last > first else 0)


@kernel
def any_light(tiles, first, last, low, height):
    """Whether any tile (of a plane) that the voxels first <= i < last, low <= j < low + height touch holds light."""
    for tj in range(low // TILE, (low + height - 1) // TILE + 1):
        for ti in range(first // TILE, (last - 1) // TILE + 1):
            if tiles[tj, ti]:
                return True
    return False


@parallel_kernel
def light_of_planes(volume, light, alive):
    """Sum of each plane of ``volume`` and the number of its voxels that hold light."""
    for k in prange(volume.shape[0]):
        total, count = 0.0, 0
        flat = volume[k].reshape(-1)
        for i in range(flat.size):
            total += flat[i]
            count += flat[i] > F(0)
        light[k], alive[k] = total, count


@parallel_kernel
def sweep(volume, faintest, tiles, alive):
    """Empty the voxels of ``volume`` (nz, ny, nx) that hold no more than ``faintest``, flag ``tiles`` (nz, ., .) that
    hold light, and count such voxels by plane (``alive``)."""
    nz, ny, nx = volume.shape
    for k in prange(nz):
        tiles[k] = 0
        count = 0
        for j in range(ny):
            row, flags = volume[k, j], tiles[k, j // TILE]
            for i in range(nx):
                if row[i] > faintest:
                    count += 1
                    flags[i // TILE] = 1
                else:
                    row[i] = F(0)
        alive[k] = count


@kernel
def clipped_products(shares, at, columns, values, begin, nx, count, rows):
    """``row_products`` of the first ``count`` columns of a pattern that a side of the volume cuts."""
    total = F(0)
    for r in range(rows):
        a, b = at + U(r) * columns, begin + U(r) * nx
        for x in range(count):
            total += shares[a + U(x)] * values[b + U(x)]
    return total


@kernel
def add_rows(shares, at, columns, value, values, begin, nx, count, rows):
    """Add ``value`` times shares to values, in the same places."""
    for r in range(rows):
        a, b = at + U(r) * columns, begin + U(r) * nx
        for x in range(count):
            values[b + U(x)] += shares[a + U(x)] * value


@parallel_kernel
def forward(geo, planes, shares, shape, start, reach, rim, m, n, lens_mm, phase, seen, volume, tiles, partial):
    """Light of ``volume`` (nz, ny, nx) in every microlens of one view; unseen pixels get 0. Each row of ``partial``
    (images, lens) takes that of some of the planes."""
    nz, ny, nx = volume.shape
    flat = volume.reshape(-1)
    images = partial.shape[0]
    for c in prange(images):
        image = partial[c]
        image[:] = F(0)
        for k in range(nz * c // images, nz * (c + 1) // images):
            plane, pattern = plane_of(planes, k), table_of(shape, start, reach, k)
            for lens in range(image.size):
                if not seen[lens]:
                    continue
                s, t, qx, qy = lens_mm[lens, 0], lens_mm[lens, 1], m - phase[lens, 0], phase[lens, 1] - n
                i, j, at, factor = pattern_of(geo, plane, pattern, rim, s, t, qx, qy)
                first, last, low, height = clipped(i, j, pattern.columns, pattern.rows, nx, ny)
                if height <= 0 or not any_light(tiles[k], first, last, low, height):
                    continue
                at, begin = at + (low - j) * pattern.columns + first - i, (k * ny + low) * nx + first
                if last - first == pattern.columns:
                    total = row_products(shares, at, pattern.columns, flat, begin, nx, height)
                else:
                    count = U(last - first)
                    total = clipped_products(shares, U(at), U(pattern.columns), flat, U(begin), U(nx), count, height)
                image[lens] += plane.light * factor * total


@kernel
def spread_back(geo, plane, shares, pattern, rim, m, n, lens_mm, phase, seen, image, ny, nx, tiles, out):
    """Add to each voxel of a plane, ``out`` (ny * nx,), the sum of its shares times ``image`` (lens,), where
    ``tiles`` may hold light."""
    for lens in range(image.size):
        if not seen[lens] or image[lens] == F(0):
            continue
        s, t, qx, qy = lens_mm[lens, 0], lens_mm[lens, 1], m - phase[lens, 0], phase[lens, 1] - n
        i, j, at, factor = pattern_of(geo, plane, pattern, rim, s, t, qx, qy)
        first, last, low, height = clipped(i, j, pattern.columns, pattern.rows, nx, ny)
        if height <= 0 or not any_light(tiles, first, last, low, height):
            continue
        at, begin = at + (low - j) * pattern.columns + first - i, low * nx + first
        add_rows(shares, U(at), U(pattern.columns), factor * image[lens], out, U(begin), U(nx), U(last - first), height)


@parallel_kernel
def adjoint(geo, planes, shares, shape, start, reach, rim, m, n, lens_mm, phase, seen, image, out):
    """The transpose of ``forward``: ``out`` (nz, ny, nx) += A' image, but for its columns of padding."""
    nz, ny, nx = out.shape
    view = rim, m, n, lens_mm, phase, seen, image, ny, nx
    for k in prange(nz):
        plane, total = plane_of(planes, k), np.zeros(ny * nx, np.float32)
        everywhere = np.ones((ny // TILE + 1, nx // TILE + 1), np.uint8)
        spread_back(geo, plane, shares, table_of(shape, start, reach, k), *view, everywhere, total)
        for j in range(ny):
            for i in range(nx - PADDING):
                out[k, j, i] += plane.light * total[j * nx + i]


@parallel_kernel
def multiply(geo, planes, shares, shape, start, reach, rim, m, n, lens_mm, phase, seen, image, volume, tiles):
    """MART's correction by one view: each voxel times (1 + sum of share times ``image``), kept >= 0."""
    nz, ny, nx = volume.shape
    view = rim, m, n, lens_mm, phase, seen, image, ny, nx
    for k in prange(nz):
        total = np.zeros(ny * nx, np.float32)
        spread_back(geo, plane_of(planes, k), shares, table_of(shape, start, reach, k), *view, tiles[k], total)
        values = volume[k].reshape(-1)
        for i in range(ny * nx):
            values[i] *= max(F(1) + total[i], F(0))
