"""Where the interrogation windows lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.settings import Size
from plenopiv.errors import PlenoPIVError


@dataclass(frozen=True)
class WindowGrid:
    """Whole windows on a regular grid. ``size``, ``step`` and ``starts`` (first voxels) are in the order z, y, x."""

    size: Size
    step: Size
    starts: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of windows along z, y, x."""
        return tuple(s.size for s in self.starts)  # type: ignore[return-value]

    @property
    def centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Window centres along z, y, x as voxel indices; half-integers for even windows."""
        return tuple(s + 0.5 * (n - 1) for s, n in zip(self.starts, self.size, strict=True))  # type: ignore[return-value]

    def rows(self, count: int) -> NDArray[np.bool_]:
        """In which of ``count`` rows of voxels a window lies (count,)."""
        out = np.zeros(count, bool)
        out[self.starts[1][:, None] + np.arange(self.size[1])] = True
        return out


class WindowBatch(NamedTuple):
    """A batch of windows as they lie in memory: ``values`` float32 (flat), the place in it where each begins (batch,),
    and the steps from plane to plane and from row to row."""

    values: NDArray[np.float32]
    begin: NDArray[np.int64]
    plane: int
    row: int

    @classmethod
    def cut(cls, planes: NDArray[np.float32], corners: NDArray[np.int64]) -> WindowBatch:
        """Windows of ``planes`` (nz, ny, nx) whose first rows and columns are ``corners`` (batch, 2)."""
        _, ny, nx = planes.shape
        return cls(planes.reshape(-1), corners @ np.array([nx, 1]), ny * nx, nx)

    @classmethod
    def of(cls, windows: NDArray[np.float32]) -> WindowBatch:
        """Windows that stand one after the other, (batch, nz, ny, nx)."""
        count, nz, ny, nx = windows.shape
        return cls(windows.reshape(-1), np.arange(count) * (nz * ny * nx), ny * nx, nx)


def step_of(size: int, overlap: float) -> int:
    """Voxels from one window of ``size`` voxels to the next along an axis."""
    return max(1, round(size * (1 - overlap)))


def window_grid(shape: tuple[int, int, int], window: Size, overlap: float) -> WindowGrid:
    """Windows of ``window`` = (nx, ny, nz) voxels over a volume of ``shape`` = (nz, ny, nx), centred on the volume.

    What whole windows leave over is left free on both sides alike, to within a voxel, so no edge is favoured.
    Raises ``PlenoPIVError`` when a window is larger than the volume.
    """
    size = window[::-1]
    if any(n > total for n, total in zip(size, shape, strict=True)):
        raise PlenoPIVError(
            f"correlation.windows: {list(window)} is larger than the volume of {list(shape[::-1])} voxels (x, y, z);"
            " use smaller windows or a larger volume"
        )
    steps, starts = [], []
    for n, total in zip(size, shape, strict=True):
        step = step_of(n, overlap)
        count = (total - n) // step + 1
        left_over = total - n - (count - 1) * step
        steps.append(step)
        starts.append(left_over // 2 + step * np.arange(count))
    return WindowGrid(size, tuple(steps), tuple(starts))  # type: ignore[arg-type]
