"""Tabulated footprints: the share that each voxel around a microlens gives its pixel, for dense planes of voxels.

In a plane every microlens sees the same footprint; only where it lies between the voxels differs, and at the aperture's
rim how much of the pixel is lit. So shares are computed once per plane and camera, for the footprint's place to within
a fraction of a voxel (``phases``, 8 to 32 a voxel) and, along either axis, for LEVELS lit lengths of a pixel at the
rim, whose lit part here is the rectangle of the same area and centre. All views use the same tables.
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from plenopiv.kernels import kernel, parallel_kernel
from plenopiv.projection.pixels import EXACT, patch_area, plane_of, reach_of

F = np.float32
LEVELS = 8  # lit lengths of a pixel cut by the rim, 1/8 to 8/8, along and across the lattice's rows
WIDTH = 8  # columns of a pattern are a multiple of it: a vector of float32
TABLE = 1 << 16  # shares in a plane's table of whole pixels, about: it stays in the second-level cache


class Patterns(NamedTuple):
    """Tables of all planes. ``shares``: flat float32. ``shape`` (nz, 4): rows, columns, phases of whole pixels and of
    cut ones; ``start`` (nz, 2): where the table of whole pixels and the first of the 2 LEVELS of cut ones begin.
    ``reach`` (nz, 2): from a footprint's centre to its first column and row, voxels."""

    shares: NDArray[np.float32]
    shape: NDArray[np.int64]
    start: NDArray[np.int64]
    reach: NDArray[np.float32]

    @property
    def nbytes(self) -> int:
        """Memory of the tables."""
        return self.shares.nbytes


def patterns(geo, table: NDArray[np.float32]) -> Patterns:
    """The tables for the planes of ``table`` (``geometry.planes``) of a camera ``geo`` (``geometry.rows``)."""
    nz = table.shape[0]
    shape, start = np.zeros((nz, 4), np.int64), np.zeros((nz, 2), np.int64)
    reach = np.empty((nz, 2), np.float32)
    footprint_reach(geo, table, reach)
    total = 0
    for k in range(nz):
        columns, rows = (ceil(2 * r) for r in reach[k].tolist())
        columns = WIDTH * ceil(columns / WIDTH)
        phases = 32
        while phases > 8 and phases**2 * rows * columns > TABLE:
            phases //= 2
        shape[k] = rows, columns, phases, phases // 2
        start[k] = total, total + phases**2 * rows * columns
        total = int(start[k, 1]) + 2 * LEVELS * (phases // 2) ** 2 * rows * columns
    shares = np.empty(total, np.float32)
    tabulate(geo, table, shape, start, reach, shares)
    return Patterns(shares, shape, start, reach)


@kernel
def footprint_reach(geo, table, reach):
    """Half widths in voxels of the box around a footprint, (nz, 2)."""
    for k in range(table.shape[0]):
        plane = plane_of(table, k)
        wide, high = reach_of(geo, plane, EXACT)
        c, s = abs(geo.cos), abs(geo.sin)
        reach[k, 0] = (c * wide + s * high) / abs(plane.cell_x)
        reach[k, 1] = (c * high + s * wide) / abs(plane.cell_y)


@kernel
def fill_pattern(geo, plane, half_x, half_y, left, top, rows, columns, out):
    """Shares of a pixel for ``rows`` x ``columns`` voxels, the first one (left, top) voxels off the footprint's
    centre."""
    scale = F(0.25) / (plane.half * plane.half)
    for j in range(rows):
        oy = plane.cell_y * (top + F(j))
        for i in range(columns):
            ox = plane.cell_x * (left + F(i))
            x, y = geo.cos * ox + geo.sin * oy, geo.cos * oy - geo.sin * ox
            out[j * columns + i] = scale * patch_area(geo, x, y, half_x, half_y)


@parallel_kernel
def tabulate(geo, table, shape, start, reach, shares):
    """Fill ``shares``."""
    for k in prange(table.shape[0]):
        plane = plane_of(table, k)
        rows, columns = shape[k, 0], shape[k, 1]
        size = rows * columns
        for level in range(2 * LEVELS + 1):
            phases = shape[k, 2] if level == 0 else shape[k, 3]
            lit = F(1) if level == 0 else F((level - 1) % LEVELS + 1) / F(LEVELS)
            along = level <= LEVELS
            half_x, half_y = (lit if along else F(1)) * plane.half, (F(1) if along else lit) * plane.half
            at = start[k, 0] if level == 0 else start[k, 1] + (level - 1) * phases * phases * size
            for py in range(phases):
                for px in range(phases):
                    left = (F(px) + F(0.5)) / F(phases) - reach[k, 0]
                    top = (F(py) + F(0.5)) / F(phases) - reach[k, 1]
                    fill_pattern(geo, plane, half_x, half_y, left, top, rows, columns, shares[at : at + size])
                    at += size
