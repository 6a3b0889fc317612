"""Views of listed voxels by exact areas, through the maps of their planes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.geometry import CameraOnGrid, column_of
from plenopiv.projection.plenoptic.plane_maps import kernels
from plenopiv.projection.plenoptic.plane_maps.maps import in_twos, maps, single_planes, widest
from plenopiv.projection.plenoptic.plane_maps.view_pixels import Views, look, meeting
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume

KEPT = 1 << 22  # numbers of lenses that views meet, in all: few beside the rest of a run's memory
LITTLE = 200_000  # pixels times planes, a quarter of a millisecond
PRODUCTS = 20  # of a listed voxel and its map, that take the time of a pixel of a plane


class MappedViews:
    """Forward and back between the listed voxels of a grid and the views of a camera (see ``PlenopticProjector``).

    ``across``: points of a map across a footprint.
    """

    def __init__(self, camera: CameraOnGrid, across: float):
        self.layout, self.grid, self.rim = camera.layout, camera.grid, camera.rim
        self.cam, self.planes, self.lens_mm = camera.cam, camera.planes, camera.lens_mm
        self.maps = maps(self.cam, self.planes, self.grid.shape, across)
        self.workspace = kernels.workspace_of(self.maps.shape, kernels.STRIP)
        self.alone = single_planes(self.planes)
        self.in_twos = [in_twos(self.cam, self.maps, self.planes, first) for first in (0, 1)]
        downwards = camera.column("voxel_t")[0]
        self._by_row = np.argsort(np.sign(downwards) * self.lens_mm[:, 1], kind="stable")
        (_, ny, nx), self._ends = self.grid.shape, self.planes[[0, -1]]
        self._size = np.array([nx, ny, *widest(self.maps)], np.float32)
        self._voxel = float(self.maps.shape[:, 2:4].prod(1).mean()) / PRODUCTS
        self._met: dict[int, NDArray[np.int32]] = {}
        self._kept = 0
        self._last: tuple[tuple[int, ...], NDArray[np.int64], Views] | None = None

    def forward(self, views: NDArray[np.int64], volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in each of ``views``, (views, lens); 0 where the pixel is no equation."""
        lenses, pixels = self.look(views)
        partial = np.empty((kernels.RUNS, lenses.size), np.float32)
        arguments = *self._kernel_arguments(views, volume, pixels), volume.values, partial
        in_threads(kernels.forward, kernels.RUNS, *arguments, little=self._little(volume, pixels))
        images = np.zeros((len(views), self.layout.lenses), np.float32)
        images[_of_view(pixels), lenses] = partial.sum(0)
        return images

    def gather(
        self, views: NDArray[np.int64], images: NDArray[np.float32], volume: SparseVolume
    ) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` (views, lens) over the pixels that it lights, by weights."""
        out = np.zeros(volume.values.size, np.float32)
        self._gather(views, images, volume, 0, out)
        return out

    def multiply(self, views: NDArray[np.int64], corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply the voxels by ``factor_of`` what ``gather`` gives of ``corrections``."""
        self._gather(views, corrections, volume, len(views), volume.values)

    def look(self, views: NDArray[np.int64]) -> tuple[NDArray[np.int64], Views]:
        """The lenses whose pixels in views are equations and may meet a voxel, view by view, and those pixels."""
        last_seen = self._last  # of this caller, should there be several
        if last_seen is None or last_seen[0] != tuple(views):
            first, last = column_of(self.planes, "spread")[[0, -1]]
            lenses = [self._meeting(view) for view in views]
            start = np.cumsum([0, *(found.size for found in lenses)])
            pixels = np.empty((8, start[-1]), np.float32)
            for k, (view, found) in enumerate(zip(views, lenses, strict=True)):
                (m, n), rim, part = self.layout.offsets[view].astype(np.float32), bool(self.rim[view]), start[k : k + 2]
                look(self.cam, found, m, n, rim, self.lens_mm, self.layout.phase, first, last, *part, pixels)
            middle = -self.layout.offsets[views, 1].astype(np.float32)
            last_seen = tuple(views), np.concatenate(lenses), Views(pixels, start, first, middle, self.rim[views])
            self._last = last_seen
        return last_seen[1:]

    def _meeting(self, view: int) -> NDArray[np.int32]:
        """The lenses whose pixel in a view is an equation and may meet a voxel, sorted by row."""
        if view in self._met:
            return self._met[view]
        (m, n), found = self.layout.offsets[view].astype(np.float32), np.empty(self._by_row.size, np.int32)
        where = self.layout.seen[view], self._by_row, self.lens_mm, self.layout.phase
        found = found[: meeting(self.cam, self._ends, *where, m, n, self._size, found)].copy()
        if self._kept < KEPT:
            self._met[view], self._kept = found, self._kept + found.size
        return found

    def _kernel_arguments(self, views: NDArray[np.int64], volume: SparseVolume, pixels: Views) -> tuple[Any, ...]:
        about = self.maps, self.workspace, pixels, self.grid.shape[1]
        read = self.in_twos[views[0] % 2] if len(views) > 1 else self.alone  # either two, at random
        return self.cam, *read, *about, volume.row_start, volume.column

    def _gather(
        self,
        views: NDArray[np.int64],
        images: NDArray[np.float32],
        volume: SparseVolume,
        multiply: int,
        out: NDArray[np.float32],
    ) -> None:
        lenses, pixels = self.look(views)
        corrections = images[_of_view(pixels), lenses].astype(np.float32)
        arguments = *self._kernel_arguments(views, volume, pixels), corrections, multiply, out
        in_threads(kernels.gather, kernels.RUNS, *arguments, little=self._little(volume, pixels))

    def _little(self, volume: SparseVolume, pixels: Views) -> bool:
        """Whether a kernel's work, pixels read in each plane and voxels spread, takes less than handing it over."""
        return pixels.pixels.shape[1] * self.maps.rank.size + self._voxel * volume.values.size < LITTLE


def _of_view(pixels: Views) -> NDArray[np.int64]:
    """The number of the view of each pixel."""
    return np.repeat(np.arange(pixels.middle.size), np.diff(pixels.start))
