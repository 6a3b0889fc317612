"""The form in which a volume that is not sparse is worked on: dense planes, and which of their tiles hold light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection import dense
from plenopiv.volume import SparseVolume, VoxelGrid


@dataclass(frozen=True)
class DensePlanes:
    """``values`` float32 (nz, ny, nx + PADDING): columns beyond nx stay 0. ``tiles`` uint8 (nz, ., .): TILE x TILE
    voxels each, 1 where any may hold light."""

    grid: VoxelGrid
    values: NDArray[np.float32]
    tiles: NDArray[np.uint8]

    @classmethod
    def empty(cls, grid: VoxelGrid) -> DensePlanes:
        """No light anywhere."""
        nz, ny, nx = grid.shape
        nx += dense.PADDING
        tiles = np.zeros((nz, -(-ny // dense.TILE), -(-nx // dense.TILE)), np.uint8)
        return cls(grid, np.zeros((nz, ny, nx), np.float32), tiles)

    @classmethod
    def of(cls, volume: SparseVolume) -> DensePlanes:
        """A sparse volume, dense."""
        planes = cls.empty(volume.grid)
        for k in range(volume.grid.shape[0]):
            planes.inside[k] = volume.slab(k, k + 1)[0]
        planes.keep_above(0.0)
        return planes

    @property
    def inside(self) -> NDArray[np.float32]:
        """The voxels of the grid, (nz, ny, nx), a view."""
        return self.values[:, :, : self.grid.shape[2]]

    def mean(self) -> float:
        """Mean of the voxels that hold light."""
        light, alive = np.zeros(self.grid.shape[0]), np.zeros(self.grid.shape[0], np.int64)
        dense.light_of_planes(self.values, light, alive)
        return float(light.sum() / max(int(alive.sum()), 1))

    def keep_above(self, faintest: float) -> int:
        """Empty the voxels that hold no more than ``faintest`` (>= 0); returns how many others there are."""
        alive = np.zeros(self.grid.shape[0], np.int64)
        dense.sweep(self.values, np.float32(faintest), self.tiles, alive)
        return int(alive.sum())

    def listed(self) -> SparseVolume:
        """The voxels that hold light."""
        values = np.concatenate([plane[plane > 0] for plane in self.inside])
        return SparseVolume.from_planes(self.grid, (plane > 0 for plane in self.inside)).with_values(values)
