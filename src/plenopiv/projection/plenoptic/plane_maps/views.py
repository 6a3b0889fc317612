"""Views of listed voxels by exact areas, through the maps of their planes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.blurred import blurred
from plenopiv.projection.plenoptic.geometry import CameraOnGrid, column_of
from plenopiv.projection.plenoptic.plane_maps import kernels
from plenopiv.projection.plenoptic.plane_maps.maps import (
    PlaneGroups,
    plane_maps,
    plane_pairs,
    single_planes,
    widest_footprint,
)
from plenopiv.projection.plenoptic.plane_maps.view_pixels import ViewPixels, fill_view_pixels, lenses_seeing_grid
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume

CACHED = 1 << 22  # numbers of lenses kept for all views together: little beside the rest of a run's memory
LITTLE = 200_000  # pixels times planes: a quarter of a millisecond, less than threads are worth
PRODUCTS = 20  # of a voxel with the weights around it take the time of one pixel in one plane


class MappedViews:
    """Forward and back between the listed voxels of a grid and the views of a camera (see ``PlenopticProjector``).

    ``across``: points of a map across a footprint.
    """

    def __init__(self, camera: CameraOnGrid, across: float):
        self.layout, self.grid, self.rim = camera.layout, camera.grid, camera.rim
        self.cam, self.planes, self.camera = camera.cam, camera.planes, camera
        self.maps = plane_maps(self.cam, self.planes, blurred(camera), self.grid.shape, across)
        self.workspace = kernels.workspace_size(self.maps.shape, kernels.STRIP)
        self.singles = single_planes(self.planes)
        self.pairs = [plane_pairs(self.cam, self.maps, self.planes, first) for first in (0, 1)]
        self._downwards = np.sign(camera.column("voxel_t")[0])
        self._by_row = np.argsort(self._downwards * camera.lens_mm[:, 1], kind="stable")
        (_, ny, nx), self._ends = self.grid.shape, self.planes[[0, -1]]
        self._size = np.array([nx, ny, *widest_footprint(self.maps)], np.float32)
        self._voxel = float(self.maps.shape[:, 2:4].prod(1).mean()) / PRODUCTS
        self._lenses: dict[int, NDArray[np.int32]] = {}
        self._cached = 0
        self._last: tuple[tuple[int, ...], NDArray[np.int64], ViewPixels] | None = None

    def forward(self, views: NDArray[np.int64], volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in each of ``views``, (views, lens); 0 where the pixel is no equation."""
        lenses, pixels = self.view_pixels(views)
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

    def view_pixels(self, views: NDArray[np.int64]) -> tuple[NDArray[np.int64], ViewPixels]:
        """The pixels of ``views`` that are equations and may see a voxel, and the lens of each. Those of the last views
        asked for are kept, as a forward projection and its correction ask for the same."""
        kept = self._last  # another thread may replace it meanwhile
        if kept is None or kept[0] != tuple(views):
            first, last = column_of(self.planes, "spread")[[0, -1]]
            lenses = [self._lenses_seeing_grid(view) for view in views]
            start = np.cumsum([0, *(found.size for found in lenses)])
            pixels = np.empty((8, start[-1]), np.float32)
            for k, (view, found) in enumerate(zip(views, lenses, strict=True)):
                (m, n), rim, part = self.layout.offsets[view].astype(np.float32), bool(self.rim[view]), start[k : k + 2]
                places = self.camera.places_mm(view)
                fill_view_pixels(self.cam, found, m, n, rim, places, self.layout.phase, first, last, *part, pixels)
                if self.layout.light is not None:
                    light = self.layout.light[view, found]
                    pixels[4, part[0] : part[1]] *= light
                    pixels[7, part[0] : part[1]] *= light
            middle = -self.layout.offsets[views, 1].astype(np.float32)
            # the lit shares of pixels are read where a rim cuts some of them
            rims = self.rim[views] if self.layout.light is None else np.ones(len(views), bool)
            kept = tuple(views), np.concatenate(lenses), ViewPixels(pixels, start, first, middle, rims)
            self._last = kept
        return kept[1:]

    def _lenses_seeing_grid(self, view: int) -> NDArray[np.int32]:
        """The lenses whose pixel in a view is an equation and may see a voxel, sorted by row."""
        if view in self._lenses:
            return self._lenses[view]
        (m, n), found = self.layout.offsets[view].astype(np.float32), np.empty(self._by_row.size, np.int32)
        places = self.camera.places_mm(view)
        where = self.layout.seen[view], self._by_row, places, self.layout.phase
        found = found[: lenses_seeing_grid(self.cam, self._ends, *where, m, n, self._size, found)].copy()
        if self.camera.shifts is not None:  # which may change the order of lenses side by side
            found = found[np.argsort(self._downwards * places[found, 1], kind="stable")]
        if self._cached < CACHED:
            self._lenses[view], self._cached = found, self._cached + found.size
        return found

    def _kernel_arguments(self, views: NDArray[np.int64], volume: SparseVolume, pixels: ViewPixels) -> tuple[Any, ...]:
        about = self.maps, self.workspace, pixels, self.grid.shape[1]
        groups: PlaneGroups = self.pairs[views[0] % 2] if len(views) > 1 else self.singles  # either pairs, at random
        return self.cam, *groups, *about, volume.row_start, volume.column

    def _gather(
        self,
        views: NDArray[np.int64],
        images: NDArray[np.float32],
        volume: SparseVolume,
        multiply: int,
        out: NDArray[np.float32],
    ) -> None:
        lenses, pixels = self.view_pixels(views)
        corrections = images[_of_view(pixels), lenses].astype(np.float32)
        arguments = *self._kernel_arguments(views, volume, pixels), corrections, multiply, out
        in_threads(kernels.gather, kernels.RUNS, *arguments, little=self._little(volume, pixels))

    def _little(self, volume: SparseVolume, pixels: ViewPixels) -> bool:
        """Whether a kernel's work, pixels read in each plane and voxels spread, takes less time than handing it to
        other threads."""
        return pixels.pixels.shape[1] * self.maps.rank.size + self._voxel * volume.values.size < LITTLE


def _of_view(pixels: ViewPixels) -> NDArray[np.int64]:
    """The number of the view of each pixel."""
    return np.repeat(np.arange(pixels.middle.size), np.diff(pixels.start))
