"""Voxels left out of a list of them."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from plenopiv.kernels import parallel_kernel
from plenopiv.volume import SparseVolume


def keeping(volume: SparseVolume, keep: NDArray[np.bool_]) -> SparseVolume:
    """Only the listed voxels where ``keep`` (one entry a listed voxel) is True."""
    start = np.zeros_like(volume.row_start)
    count_kept(volume.row_start, keep, start[1:])
    np.cumsum(start, out=start)
    column, values = np.empty(start[-1], np.uint16), np.empty(start[-1], np.float32)
    copy_kept(volume.row_start, keep, volume.column, volume.values, start, column, values)
    return SparseVolume(volume.grid, start, column, values)


@parallel_kernel
def count_kept(row_start, keep, counts):
    """How many listed voxels of each row are kept, into ``counts`` (rows,)."""
    for row in prange(counts.size):
        kept = 0
        for v in range(row_start[row], row_start[row + 1]):
            kept += keep[v]
        counts[row] = kept


@parallel_kernel
def copy_kept(row_start, keep, column, values, start, kept_column, kept_values):
    """The kept voxels of each row to its place ``start`` (rows + 1,) in a shorter list."""
    for row in prange(start.size - 1):
        to, end = start[row], start[row + 1]
        for v in range(row_start[row], row_start[row + 1]):
            if to < end:
                kept_column[to], kept_values[to] = column[v], values[v]
                to += keep[v]
