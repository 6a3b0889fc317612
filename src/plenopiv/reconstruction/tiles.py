"""A volume in tiles, one after the other, where the list of its voxels would take more memory than there is.

Tiles are cut along y. Each is reconstructed with a margin of rows on both sides, which is then left out: half of what
the light of a plenoptic camera's pixel crosses from the first plane to the last, all that a line of sight of a pinhole
camera crosses. Pixels that see more than tile and margin are no equations of it, as part of their light is of other
voxels; of a tile's own voxels, those at its border lack some of a plenoptic camera far from the middle of the depth.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from plenopiv.volume import SparseVolume


class Tile(NamedTuple):
    """Rows ``first`` to ``end`` of voxels, reconstructed among rows ``low`` to ``high``."""

    first: int
    end: int
    low: int
    high: int

    def own_rows(self, volume: SparseVolume) -> SparseVolume:
        """Of a volume of rows ``low`` to ``high`` the rows ``first`` to ``end``."""
        if (self.first, self.end) == (self.low, self.high):
            return volume
        return volume.y_range(self.first - self.low, self.end - self.low)

    def listed(self, volume: SparseVolume) -> int:
        """How many voxels of such a volume are listed in rows ``first`` to ``end``."""
        return self.own_rows(volume).column.size


def cut(rows: int, count: int, passage: int) -> list[Tile]:
    """So many tiles of a volume of so many rows. ``passage``: of the projection, twice the margin."""
    margin = (passage + 1) // 2
    bounds = [rows * k // count for k in range(count + 1)]
    return [Tile(first, end, max(first - margin, 0), min(end + margin, rows)) for first, end in pairwise(bounds)]
