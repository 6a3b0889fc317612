"""Views of listed voxels by rays or polygons, voxel by voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.correction import correct
from plenopiv.projection.plenoptic.blurred import blurred
from plenopiv.projection.plenoptic.by_voxel.kernels import project
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume

CHUNKS = 64  # of rows of voxels, distributed among threads
PARTIAL_IMAGES = 16  # of one view, summed in order
NOTHING, NO_IMAGES = np.empty(1, np.float32), np.empty((1, 1), np.float32)


class ViewsByVoxel:
    """Forward and back between the listed voxels of a grid and the views of a camera (see ``PlenopticProjector``).

    ``rule``: of ``pixel_weights``, how a pixel is weighted.
    """

    def __init__(self, camera: CameraOnGrid, rule: int):
        self.camera, self.layout, self.rule = camera, camera.layout, rule
        self._box = (self.layout.i0, self.layout.j0, self.layout.ni, self.layout.nj)
        self._moved = camera.lenses_moved(0)

    def forward(self, views: NDArray[np.int64], volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in each of ``views``, (views, lens); 0 where the pixel is no equation."""
        images = np.zeros((views.size, self.layout.lenses), np.float32)
        for view, image in zip(views, images, strict=True):
            partial = np.empty((PARTIAL_IMAGES, self.layout.lenses), np.float32)
            self._project(view, volume, PARTIAL_IMAGES, NOTHING, partial, NOTHING, True)
            image[:] = partial.sum(0)
            image[~self.layout.seen[view]] = 0.0
            if self.layout.light is not None:
                image *= self.layout.light[view]
        return images

    def gather(
        self, views: NDArray[np.int64], images: NDArray[np.float32], volume: SparseVolume
    ) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` (views, lens) over the pixels that it lights, by weights."""
        out = np.zeros(volume.values.size, np.float32)
        for view, image in zip(views, images, strict=True):
            seen, part = np.where(self.layout.seen[view], image, 0.0).astype(np.float32), np.empty_like(out)
            if self.layout.light is not None:
                seen *= self.layout.light[view]
            self._project(view, volume, CHUNKS, seen, NO_IMAGES, part, False)
            out += part
        return out

    def multiply(self, views: NDArray[np.int64], corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply the voxels by ``factor_of`` what ``gather`` gives of ``corrections``."""
        correct(volume, self.gather(views, corrections, volume), views.size)

    def _project(
        self,
        view: np.int64,
        volume: SparseVolume,
        chunks: int,
        image: NDArray[np.float32],
        partial: NDArray[np.float32],
        out: NDArray[np.float32],
        scatter: bool,
    ) -> None:
        m, n = self.layout.offsets[view].astype(np.float32)
        moved = self._moved if self.camera.shifts is None else self.camera.lenses_moved(view)
        lenses = self._box, self.layout.phase, *moved
        constants = self.camera.cam, *lenses, self.camera.planes, blurred(self.camera), self.camera.grid.shape[1]
        pixels = self.rule, bool(self.camera.rim[view]), m, n, self.layout.fill[view]
        listed = volume.row_chunks(chunks), volume.row_start, volume.column, volume.values
        in_threads(project, chunks, *constants, *pixels, *listed, image, partial, out, scatter)
