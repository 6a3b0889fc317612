"""Several plenoptic cameras around a volume, as one projection: their views one after the other.

Each camera has a ``PlenopticProjector`` of its own over the same voxels, numbered along its own axes (``Pose.grid``). A
list of voxels is sorted into each camera's order once; after that only its values are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.pose import FRONT, Pose
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.correction import correct
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.protocol import Projection
from plenopiv.volume import SparseVolume, VoxelGrid


class Turned(NamedTuple):
    """A list of voxels in a camera's order. ``order``: the place of each in the list that it came from, or a slice of
    all where the orders are the same."""

    volume: SparseVolume
    order: NDArray[np.int64] | slice


class SeveralCameras:
    """Between a volume of the object and the views of cameras mounted around it (``projection.protocol.Projection``).

    Views of the first camera come first. Images of a view are float32 (lens,), in counts; where a camera has fewer
    microlenses than the largest, the last are no equations. Cameras are taken as equally bright.

    Raises PlenoPIVError where a projector's voxels are not those of ``grid`` seen from its pose.
    """

    def __init__(self, grid: VoxelGrid, projectors: Sequence[PlenopticProjector], poses: Sequence[Pose]):
        self.grid, self.projectors, self.poses = grid, tuple(projectors), tuple(poses)
        for number, (projector, pose) in enumerate(zip(projectors, poses, strict=True), 1):
            if not projector.grid.agrees_with(pose.grid(grid)):
                raise PlenoPIVError(f"camera {number}: its voxels are not the volume's, turned as it is mounted")
        self._first = np.cumsum([0, *(p.views for p in self.projectors)])
        self._lenses = max(p.layout.lenses for p in self.projectors)
        self._last: tuple[SparseVolume, list[Turned]] | None = None

    @property
    def views(self) -> int:
        """Number of views of all cameras."""
        return int(self._first[-1])

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(view, lens): where a pixel is an equation."""
        return self._stacked([p.seen for p in self.projectors])

    def values_of(self, images: Sequence[NDArray]) -> NDArray[np.float32]:
        """One upright image (rows, columns) of each camera, in counts, as (view, lens) above the black level.

        Raises PlenoPIVError where their number or a shape is not that of the cameras.
        """
        if len(images) != len(self.projectors):
            raise PlenoPIVError(f"{len(images)} images for {len(self.projectors)} cameras; give one of each camera")
        return self._stacked([p.values_of([image]) for p, image in zip(self.projectors, images, strict=True)])

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in several views, (views, lens)."""
        views = np.asarray(views)
        images = np.zeros((views.size, self._lenses), np.float32)
        for projector, turned, mine, own in self._by_camera(views, volume):
            seen = projector.forward(own, turned.volume.with_values(volume.values[turned.order]))
            images[mine, : seen.shape[1]] = seen
        return images

    def gather(self, views: ArrayLike, images: NDArray[np.float32], volume: SparseVolume) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` (views, lens) over the pixels that it lights, by weights."""
        out = np.zeros(volume.values.size, np.float32)
        for projector, turned, mine, own in self._by_camera(np.asarray(views), volume):
            out[turned.order] += projector.gather(own, images[mine, : projector.layout.lenses], turned.volume)
        return out

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the weighted sum of ``corrections``; it becomes 0 where that is negative."""
        correct(volume, self.gather(views, corrections, volume), np.size(views))

    def visible_voxels(self) -> SparseVolume:
        """The voxels that the middle of every camera's aperture sees, each of value 1."""
        return self._in_all([p.visible_voxels() for p in self.projectors])

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> SparseVolume:
        """The voxels that are candidates of every camera (``PlenopticProjector.candidates``); ``particle``: counts in
        each camera, or one number for all."""
        each = self.each_camera(most)
        counts = np.broadcast_to(particle, len(each))
        return self._in_all([p.candidates(own, count) for (p, own), count in zip(each, counts, strict=True)])

    @property
    def passage(self) -> int:
        """Rows of voxels that the light of one pixel of any camera crosses, at the most.

        Raises PlenoPIVError where rows are not rows to one of the cameras.
        """
        self._check_rows()
        return max(p.passage for p in self.projectors)

    def tile(self, low: int, high: int) -> SeveralCameras:
        """The same cameras with rows low <= j < high of the voxels; ``seen`` only where no light comes from others.

        Raises PlenoPIVError where rows are not rows to one of the cameras.
        """
        rows = self.grid.shape[1]
        if (low, high) == (0, rows):
            return self
        self._check_rows()
        own = [(low, high) if pose.axes[1] > 0 else (rows - high, rows - low) for pose in self.poses]
        parts = [p.tile(*limits) for p, limits in zip(self.projectors, own, strict=True)]
        return SeveralCameras(self.grid.y_range(low, high), parts, self.poses)

    def whole(self) -> SeveralCameras:
        """The same, were all pixels usable."""
        return SeveralCameras(self.grid, [p.whole() for p in self.projectors], self.poses)

    @property
    def lost_share(self) -> float:
        """The largest of all cameras (``Layout.lost_share``)."""
        return max(p.lost_share for p in self.projectors)

    def each_camera(self, values: NDArray) -> list[tuple[Projection, NDArray]]:
        """The cameras, with their parts of ``values`` (view, lens)."""
        bounds = zip(self.projectors, self._first[:-1], self._first[1:], strict=True)
        return [(p, values[first:end, : p.layout.lenses]) for p, first, end in bounds]

    def _check_rows(self) -> None:
        for number, pose in enumerate(self.poses, 1):
            if abs(pose.axes[1]) != 2:
                raise PlenoPIVError(
                    f"camera {number}: its y is not the volume's, so that tiles along y do not divide what it sees; "
                    "reconstruct the volume as a whole, or a smaller one"
                )

    def _in_all(self, volumes: Sequence[SparseVolume]) -> SparseVolume:
        """The voxels that are in every one of ``volumes``, a list of each camera in its own order; values are 1."""
        common = np.ones(self.grid.shape, bool)
        for volume, pose in zip(volumes, self.poses, strict=True):
            common &= pose.inverse().planes(volume.mask())
        return SparseVolume.from_mask(self.grid, common)

    def _stacked(self, each: Sequence[NDArray]) -> NDArray:
        out = np.zeros((self.views, self._lenses), each[0].dtype)
        for first, values in zip(self._first[:-1], each, strict=True):
            out[first : first + values.shape[0], : values.shape[1]] = values
        return out

    def _by_camera(
        self, views: NDArray[np.int64], volume: SparseVolume
    ) -> Iterator[tuple[PlenopticProjector, Turned, NDArray[np.int64], NDArray[np.int64]]]:
        """Of each camera that has some of ``views``: its projector, the list in its order, which of the views are its
        own, and their numbers there."""
        if self._last is None or self._last[0] is not volume:
            self._last = volume, [turned(volume, m) for m in self.poses]
        for number, (projector, listed) in enumerate(zip(self.projectors, self._last[1], strict=True)):
            mine = np.flatnonzero((views >= self._first[number]) & (views < self._first[number + 1]))
            if mine.size:
                yield projector, listed, mine, views[mine] - self._first[number]


def places_of(volume: SparseVolume) -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16]]:
    """Where each listed voxel is along x, y and z."""
    row = np.repeat(np.arange(volume.row_start.size - 1), np.diff(volume.row_start))
    plane, line = np.divmod(row, volume.grid.shape[1])
    return volume.column, line.astype(np.uint16), plane.astype(np.uint16)


def turned(volume: SparseVolume, pose: Pose) -> Turned:
    """A list of the object's voxels in the order of a camera with this ``pose``, with their present values."""
    if pose == FRONT:
        return Turned(volume, slice(None))
    grid, own, object_places = pose.grid(volume.grid), list[NDArray[np.uint16]](), places_of(volume)
    for axis, count in zip(pose.axes, grid.shape[::-1], strict=True):
        place = object_places[abs(axis) - 1]
        own.append(np.uint16(count - 1) - place if axis < 0 else place)
    rank = np.ravel_multi_index(own[::-1], grid.shape).astype(np.min_scalar_type(grid.size))
    order = np.argsort(rank)
    row, column = np.divmod(rank[order], grid.shape[2])
    counts = np.bincount(row, minlength=grid.shape[0] * grid.shape[1])
    start = np.concatenate([[0], np.cumsum(counts)])
    return Turned(SparseVolume(grid, start, column.astype(np.uint16), volume.values[order]), order)
