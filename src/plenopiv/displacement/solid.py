"""Interrogation windows in a solid body, where no particles are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.settings import CorrelationSettings, Size
from plenopiv.displacement.sub_windows import mean_over
from plenopiv.displacement.windows import WindowGrid, window_grid

BLOCKS = 8  # along each side of the smallest window


@dataclass(frozen=True)
class Solid:
    """Which parts of a volume a body fills: ``inside`` (nz, ny, nx), of blocks of ``block`` voxels along z, y, x from
    the first voxel on, each judged by its centre."""

    inside: NDArray[np.bool_]
    block: Size

    def share(self, windows: WindowGrid) -> NDArray[np.float64]:
        """Share of each window (nz, ny, nx) that lies in the body."""
        along = zip(windows.starts, windows.size, self.block, self.inside.shape, strict=True)
        weights = tuple(_overlap(starts, size, block, count) for starts, size, block, count in along)
        return mean_over(self.inside.astype(np.float64), weights)  # type: ignore[arg-type]

    def filled(self, windows: WindowGrid, last: Size) -> NDArray[np.bool_]:
        """Windows (nz, ny, nx) that are not to be measured: more than half in the body, or, where they are larger than
        the ``last`` ones (x, y, z), with less room outside it than half of these have."""
        room = float(np.prod(last)) / float(np.prod(windows.size))
        return self.share(windows) > max(0.5, 1 - 0.5 * room) + 1e-9


def block_of(settings: CorrelationSettings) -> Size:
    """Voxels along z, y, x of the blocks by which windows are judged."""
    smallest = np.min([window for window, _ in settings.passes], axis=0)
    return tuple(max(1, int(side) // BLOCKS) for side in smallest[::-1])  # type: ignore[return-value]


def vectors_in(solid: Solid, shape: tuple[int, int, int], settings: CorrelationSettings) -> NDArray[np.bool_]:
    """The vectors (nz, ny, nx) that are not measured in a volume of ``shape`` voxels (nz, ny, nx)."""
    last = settings.windows[-1]
    return solid.filled(window_grid(shape, last, settings.overlap), last)


def _overlap(starts: NDArray[np.int64], size: int, block: int, count: int) -> NDArray[np.float64]:
    """Share of each window along one axis that lies in each of ``count`` blocks; (windows, blocks)."""
    low = block * np.arange(count)
    shared = np.minimum(starts[:, None] + size, low + block) - np.maximum(starts[:, None], low)
    return np.maximum(shared, 0) / size
