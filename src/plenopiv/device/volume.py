"""A volume on the device, and the list of its voxels that hold light, as it comes back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.volume import SparseVolume, VoxelGrid

TOGETHER = 1 << 24  # voxels listed at once
LEAST = 1 << 12  # voxels of a list: lists are made as long as powers of two, so that they share programs


@dataclass(frozen=True)
class DeviceVolume:
    """Intensity of every voxel on the device, float32 (nz, ny, nx), 0 where none is listed; and maybe of some rows
    more, which are 0."""

    grid: VoxelGrid
    values: jax.Array

    def listed(self, low: int, high: int) -> int:
        """How many voxels of rows low <= j < high are listed."""
        return int(np.asarray(_listed(self.values))[:, low:high].sum())

    def sparse(self, low: int, high: int) -> SparseVolume:
        """The voxels of rows low <= j < high that are listed, in this processor's memory."""
        counts = np.asarray(_listed(self.values))[:, low:high].astype(np.int64)
        nz, ny, nx = self.grid.shape
        at_once, columns, lights = max(1, TOGETHER // (ny * nx)), list[NDArray](), list[NDArray]()
        for first in range(0, nz, at_once):
            planes = min(at_once, nz - first)
            count = int(counts[first : first + planes].sum())
            size = max(LEAST, 1 << max(count - 1, 0).bit_length())
            column, light = _lit_voxels(self.values, np.int32(first), (planes, low, high), size)
            columns.append(np.asarray(column[:count]))
            lights.append(np.asarray(light[:count]))
        start = np.concatenate([[0], np.cumsum(counts)])
        grid = self.grid if (low, high) == (0, ny) else self.grid.y_range(low, high)
        return SparseVolume(grid, start, np.concatenate(columns), np.concatenate(lights))


@jax.jit
def _listed(values: jax.Array) -> jax.Array:
    """Voxels of each row that hold light."""
    return jnp.sum(values > 0, 2)


@partial(jax.jit, static_argnums=(2, 3))
def _lit_voxels(
    values: jax.Array, first: jax.Array, part: tuple[int, int, int], size: int
) -> tuple[jax.Array, jax.Array]:
    """Columns and intensities of the first ``size`` voxels with light of ``part`` = planes, and rows from one to
    another, from plane ``first`` on."""
    planes, low, high = part
    some = jax.lax.dynamic_slice_in_dim(values, first, planes)[:, low:high].reshape(-1)
    at = jnp.nonzero(some > 0, size=size, fill_value=0)[0]
    return (at % values.shape[2]).astype(jnp.uint16), some[at]
