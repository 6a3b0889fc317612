"""Voxels left out of a list of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel
from plenopiv.volume import SparseVolume


def keeping(volume: SparseVolume, keep: NDArray[np.bool_], overwrite: bool = False) -> SparseVolume:
    """Only the listed voxels where ``keep`` (one entry a listed voxel) is True. ``overwrite``: in the memory that
    ``volume`` has, which is of no use afterwards."""
    start, column, values = volume.row_start, volume.column, volume.values
    if not overwrite:
        start, column, values = start.copy(), column.copy(), values.copy()
    kept = compact(keep, start, column, values)
    return SparseVolume(volume.grid, start, column[:kept], values[:kept])


@kernel
def compact(
    keep: NDArray[np.bool_], row_start: NDArray[np.int64], column: NDArray[np.uint16], values: NDArray[np.float32]
) -> int:
    """Move what is kept to the front, row by row; returns its number."""
    to, begin = 0, row_start[0]
    for row in range(row_start.size - 1):
        end = row_start[row + 1]
        for v in range(begin, end):
            column[to], values[to] = column[v], values[v]
            to += keep[v]
        begin = end
        row_start[row + 1] = to
    return to
