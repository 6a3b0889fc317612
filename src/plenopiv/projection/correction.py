"""The factor by which a voxel is multiplied once the corrections of a few views are summed
(``reconstruction.mart``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, kernel
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume

F = np.float32


@inlined
def factor_of(total: np.float32, views: int) -> np.float32:
    """The factor for corrections of so many ``views`` that sum to ``total``, >= 0: 1 + total where they add light, and
    where they remove it (1 + total / views)^views, which the product of the views' own factors never exceeds."""
    if total >= F(0):
        return F(1) + total
    each = max(F(1) + total / F(views), F(0))
    factor = each
    for _ in range(views - 1):
        factor *= each
    return factor


@kernel
def multiply_by(begin: int, end: int, total: NDArray[np.float32], views: int, values: NDArray[np.float32]) -> None:
    """Multiply the voxels ``begin`` to ``end`` by ``factor_of`` their ``total``."""
    for v in range(begin, end):
        values[v] *= factor_of(total[v], views)


def correct(volume: SparseVolume, total: NDArray[np.float32], views: int) -> None:
    """Multiply the voxels by ``factor_of`` their ``total`` (voxel,), the sums of the corrections of so many
    ``views``."""
    in_threads(multiply_by, total.size, total, views, volume.values)
