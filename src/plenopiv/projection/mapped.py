"""Views of listed voxels by exact areas, through the maps of their planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import Layout
from plenopiv.projection import geometry, strips
from plenopiv.projection.maps import maps, widest
from plenopiv.projection.views import View, look
from plenopiv.volume import SparseVolume, VoxelGrid

RUNS = 16  # of planes, shared out among threads; forward, as many partial images are summed in order


class MappedViews:
    """Forward and back between the listed voxels of ``grid`` and the views of a camera (see ``Projector``).

    ``rows``, ``planes``, ``lens_mm``: the camera and the grid as ``geometry`` has them; ``rim``: the views (view,) with
    pixels that the aperture's rim cuts; ``across``: points of a map across a footprint.
    """

    def __init__(
        self,
        layout: Layout,
        grid: VoxelGrid,
        rows: geometry.Rows,
        planes: NDArray[np.float32],
        lens_mm: NDArray[np.float32],
        rim: NDArray[np.bool_],
        across: float,
    ):
        self.layout, self.grid, self.rim = layout, grid, rim
        self.rows, self.planes, self.lens_mm = rows, planes, lens_mm
        self.maps = maps(self.rows, self.planes, grid.shape, across)
        self.strip = strips.STRIP
        downwards = self.planes[0, geometry.Plane._fields.index("voxel_t")]
        self._by_row = np.argsort(np.sign(downwards) * self.lens_mm[:, 1], kind="stable")
        self._last: tuple[int, NDArray[np.int64], View] | None = None

    def forward(self, view: int, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in one view, (lens,); 0 where the pixel is no equation."""
        lenses, pixels = self.look(view)
        partial = np.empty((RUNS, lenses.size), np.float32)
        strips.forward(*self._kernel_arguments(volume, pixels), volume.values, partial)
        image = np.zeros(self.layout.lenses, np.float32)
        image[lenses] = partial.sum(0)
        return image

    def gather(self, view: int, image: NDArray[np.float32], volume: SparseVolume, out: NDArray[np.float32]) -> None:
        """For each listed voxel the sum of ``image`` (lens,) over the pixels that it lights, each by its lit share of
        the pixel, into ``out``."""
        self._gather(view, image, volume, False, out)

    def multiply(self, view: int, correction: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply the voxels by 1 plus what ``gather`` gives of ``correction``, at least 0."""
        self._gather(view, correction, volume, True, volume.values)

    def look(self, view: int) -> tuple[NDArray[np.int64], View]:
        """The lenses whose pixel in a view is an equation and may meet a voxel, and those pixels."""
        if self._last is None or self._last[0] != view:
            where, (m, n) = self.layout, self.layout.offsets[view].astype(np.float32)
            column, row = geometry.ends(where, self.rows, self.planes, self.lens_mm, view)
            (_, ny, nx), (wide, high) = self.grid.shape, widest(self.maps)
            meets = where.seen[view] & (column.min(0) < nx + wide) & (column.max(0) > -wide - 1)
            meets &= (row.min(0) < ny + high) & (row.max(0) > -high - 1)
            lenses = self._by_row[meets[self._by_row]]
            found = np.empty((8, lenses.size), np.float32)
            first, last = self.planes[[0, -1], geometry.Plane._fields.index("spread")]
            look(self.rows, lenses, m, n, bool(self.rim[view]), self.lens_mm, where.phase, first, last, found)
            self._last = view, lenses, View(found, first, -n)
        return self._last[1:]

    def _kernel_arguments(self, volume: SparseVolume, pixels: View):
        table = self.maps
        about = table.shape, table.border, table.shares, table.start, self.strip, pixels, self.grid.shape[1]
        return self.rows, self.planes, *about, volume.row_start, volume.column

    def _gather(self, view: int, image, volume: SparseVolume, multiply: bool, out: NDArray[np.float32]) -> None:
        lenses, pixels = self.look(view)
        corrections = image[lenses].astype(np.float32)
        strips.gather(*self._kernel_arguments(volume, pixels), corrections, multiply, RUNS, out)
