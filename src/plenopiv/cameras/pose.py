"""How a camera stands around a volume that several cameras see: turned by quarters of a circle.

The first camera's frame is the object frame. Another looks at the same origin from a quarter turn away, so that its
planes of voxels are faces of the same voxels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.volume import Limits, VoxelGrid


@dataclass(frozen=True)
class Pose:
    """Which way of the object a camera's own x, y and z point: 1, 2, 3 for x, y, z, negative for the opposite way.

    z points from the focal plane to the camera, x to the right and y up as the upright image shows them.

    Raises PlenoPIVError for axes that are not those of a right-handed frame.
    """

    axes: tuple[int, int, int] = (1, 2, 3)

    def __post_init__(self) -> None:
        turn = np.zeros((3, 3))
        if sorted(abs(a) for a in self.axes) == [1, 2, 3]:
            turn = self._turn()
        if np.linalg.det(turn) < 0.5:
            raise PlenoPIVError(f"pose: {self.axes} are not the axes of a right-handed frame, as (1, 2, 3) are")

    def _turn(self) -> NDArray[np.float64]:
        return np.eye(3)[[abs(a) - 1 for a in self.axes]] * np.sign(self.axes)[:, None]

    def inverse(self) -> Pose:
        """Which way of the camera the object's x, y and z point."""
        own = {abs(a): (n if a > 0 else -n) for n, a in enumerate(self.axes, 1)}
        return Pose((own[1], own[2], own[3]))

    def in_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Points or displacements (..., 3) of the object in the camera's own frame."""
        return np.asarray(points_mm, float) @ self._turn().T

    def limits(self, limits_mm: Limits) -> tuple[tuple[float, float], ...]:
        """Limits ((x lo, hi), (y lo, hi), (z lo, hi)) of a box of the object, along the camera's own axes."""
        return tuple(tuple(sorted(np.sign(a) * edge for edge in limits_mm[abs(a) - 1])) for a in self.axes)

    def planes(self, values: NDArray) -> NDArray:
        """A view of values of voxels (nz, ny, nx) of the object, along the camera's own axes."""
        turned = np.transpose(values, [3 - abs(a) for a in self.axes[::-1]])
        return np.flip(turned, tuple(n for n, a in enumerate(self.axes[::-1]) if a < 0))

    def grid(self, grid: VoxelGrid) -> VoxelGrid:
        """The same voxels, numbered along the camera's own axes."""
        nz, ny, nx = grid.shape
        counts, last = (nx, ny, nz), [axis[-1] for axis in grid.axes()]
        along = [abs(a) - 1 for a in self.axes]
        first = [-last[n] if a < 0 else grid.first_mm[n] for a, n in zip(self.axes, along, strict=True)]
        voxel = [grid.voxel_mm[n] for n in along]
        x, y, z = (counts[n] for n in along)
        return VoxelGrid((first[0], first[1], first[2]), (voxel[0], voxel[1], voxel[2]), (z, y, x))


FRONT = Pose()
SIDE = Pose((-3, 2, 1))  # on the +x side, looking along -x: turned by 90 degrees about y
