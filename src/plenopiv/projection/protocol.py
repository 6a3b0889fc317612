"""What reconstruction needs of a projection between a volume and images, whatever the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.volume import SparseVolume, VoxelGrid


class Projection(Protocol):
    """Between a volume and its views. A view is a portion of one main lens (``PlenopticProjector``), the same of one of
    several cameras (``SeveralCameras``), or all of a pinhole camera (``PinholeProjector``). Each view has as many
    pixels; ``forward`` and ``multiply`` use the same weights.

    Arrays (view, pixel) are float32 counts above the black level, 0 where there is no equation.
    """

    @property
    def grid(self) -> VoxelGrid:
        """The voxels."""

    @property
    def views(self) -> int:
        """Number of views."""

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(view, pixel): where there is an equation."""

    def values_of(self, images: Sequence[NDArray]) -> NDArray[np.float32]:
        """One frame, an upright image (rows, columns) in counts of each camera, as (view, pixel).

        Raises PlenoPIVError where their number or a shape is not that of the cameras, or a pixel is no finite number.
        """

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in several views, (views, pixels), in counts; 0 where there is no equation."""

    def gather(self, views: ArrayLike, images: NDArray[np.float32], volume: SparseVolume) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` (views, pixels) over the pixels that it lights, by weights."""

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the weighted sum of ``corrections`` (views, pixels); it becomes 0 where that is
        negative."""

    def visible_voxels(self) -> SparseVolume:
        """The voxels that the cameras see, each of value 1."""

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> SparseVolume:
        """The visible voxels that may hold a particle of ``particle`` counts (one number, or one for each camera) where
        pixels collected no more than ``most`` (view, pixel) counts, inf where that is not known."""

    @property
    def passage(self) -> int:
        """Rows of voxels over which the light of the pixels that see a voxel spreads between the first plane and the
        last, at the most, where it is in the middle: half of them are a tile's margin on either side."""

    def tile(self, low: int, high: int) -> Projection:
        """The same cameras with rows low <= j < high of the voxels alone; ``seen`` only where a pixel's light comes
        from no other row. The projection itself where these are all rows."""

    def each_camera(self, values: NDArray) -> list[tuple[Projection, NDArray]]:
        """Of each camera that judges voxels by itself: its projection, and its part of ``values`` (view, pixel)."""
