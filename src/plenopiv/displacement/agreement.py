"""How far two deformed windows show the same particles, place by place.

In the deformed volumes, a particle that both contain lies at the same place in both. Ghost particles, and particles
that one volume lacks, have no partner; near a particle of the other volume they shift the correlation peak. Each place
is therefore weighted by

    q = G[A B] / G[(A^2 + B^2) / 2]        between 0 (light in one window only) and 1 (the same light in both)

where A and B are the windows' intensities summed over cells of about four voxels, and G weights a cell and its
neighbours 1 : 2 : 1 along each axis. The remaining displacement is small against such a cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_CELL = 4  # voxels
FLOOR = np.float32(1e-3)  # of the mean of A^2: keeps q of empty cells near 0


def agreement(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """q for windows ``a``, ``b`` (batch, nz, ny, nx) of light >= 0, in the same shape; linear between cell centres."""
    size = a.shape[1:]
    for axis, n in enumerate(size, 1):
        a, b = (np.add.reduceat(v, starts(n), axis) for v in (a, b))
    common, either = a * b, np.float32(0.5) * (a * a + b * b)
    for axis in (1, 2, 3):
        common, either = _with_neighbours(common, axis), _with_neighbours(either, axis)
    q = np.maximum(common, np.float32(0)) / (either + FLOOR * either.mean((1, 2, 3), keepdims=True) + np.float32(1e-30))
    for axis, n in enumerate(size, 1):
        q = _at_voxels(q, n, axis)
    return q


def starts(n: int) -> NDArray[np.int64]:
    """First voxel of each cell along an axis of ``n`` voxels."""
    count = max(1, round(n / _CELL))
    return np.arange(count) * n // count


def centres(n: int) -> NDArray[np.float64]:
    """Of the cells along an axis of ``n`` voxels."""
    first = starts(n)
    return 0.5 * (first + np.append(first[1:], n) - 1)


def _with_neighbours(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """1 : 2 : 1 along ``axis``; at the ends, as if the outermost cell came twice."""
    v = np.moveaxis(values, axis, 0)
    padded = np.concatenate([v[:1], v, v[-1:]])
    return np.moveaxis(np.float32(0.25) * (padded[:-2] + 2 * v + padded[2:]), 0, axis)


def _at_voxels(cells: NDArray[np.float32], n: int, axis: int) -> NDArray[np.float32]:
    """Values at ``n`` voxels along ``axis``, linear between the centres of the cells, constant beyond them."""
    first = starts(n)
    position = np.interp(np.arange(n), centres(n), np.arange(first.size))
    low = position.astype(np.int64)
    share = (position - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(cells.ndim)])
    high = np.minimum(low + 1, first.size - 1)
    return cells.take(low, axis) * (1 - share) + cells.take(high, axis) * share
