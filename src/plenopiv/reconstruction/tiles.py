"""A volume in tiles, one after the other, where the list of its voxels would take more memory than there is.

Tiles are cut along y. Each is reconstructed with a margin of rows on both sides, which is then left out: half of what
the light of a pixel crosses from the first plane to the last. Pixels that see more than tile and margin are no
equations of it, as part of their light is of other voxels; of a tile's own voxels, those at its border lack them far
from the middle of the depth.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import Projector
from plenopiv.reconstruction.mart import Progress
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, Noise, dark_noise
from plenopiv.reconstruction.reconstruct import Reconstruction, corrected, left_by_tracing, reconstruct, some_left
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import SparseVolume


class Tile(NamedTuple):
    """Rows ``first`` to ``end`` of voxels, reconstructed among rows ``low`` to ``high``."""

    first: int
    end: int
    low: int
    high: int


def cut(rows: int, count: int, passage: int) -> list[Tile]:
    """So many tiles of a volume of so many rows. ``passage``: as ``Projector`` has it, twice the margin."""
    margin = (passage + 1) // 2
    bounds = [rows * k // count for k in range(count + 1)]
    return [Tile(first, end, max(first - margin, 0), min(end + margin, rows)) for first, end in pairwise(bounds)]


class InTile:
    """A projector of a tile, of whose equations only some hold (``Projection``)."""

    def __init__(self, projector: Projector, seen: NDArray[np.bool_]) -> None:
        self.projector, self.seen = projector, seen

    @property
    def views(self) -> int:
        """Number of views."""
        return self.projector.views

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """See ``Projector``."""
        return self.projector.forward(views, volume)

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """See ``Projector``; where there is no equation ``corrections`` are 0."""
        self.projector.multiply(views, corrections, volume)


def reconstruct_in_tiles(
    lightfield: LightField,
    projector: Projector,
    tiles: list[Tile],
    settings: ReconstructionSettings,
    *,
    counts_per_electron: float = NO_WHITE_IMAGE,
    name: str = "frame",
    progress: Progress | None = None,
) -> Reconstruction:
    """``reconstruct`` tile by tile of the grid of ``projector``. Threshold and particle told are means over tiles.

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles.
    """
    if len(tiles) == 1:
        return reconstruct(
            lightfield, projector, settings, counts_per_electron=counts_per_electron, name=name, progress=progress
        )
    noise, grid = Noise(dark_noise(lightfield), counts_per_electron), projector.grid
    rows, parts, told, listed = grid.shape[1], [], [], 0
    squares, equations = np.zeros(settings.iterations), 0
    for number, tile in enumerate(tiles):
        own = Projector(lightfield.layout, grid.rows(tile.low, tile.high), settings.weights)
        volume, *measured = left_by_tracing(lightfield, own, settings, noise, name)
        within = tile.first - tile.low, tile.end - tile.low
        if here := volume.rows(*within).column.size:
            of_all = None if progress is None else partial(_of_all, progress, number, len(tiles))
            seen = own.keeps_within(0 if tile.low else -np.inf, tile.high - tile.low if tile.high < rows else np.inf)
            inside, times = InTile(own, seen), rows / (tile.high - tile.low)
            volume, residuals = corrected(lightfield.values, inside, volume, settings, noise, of_all, times)
            squares += np.square(residuals) * np.count_nonzero(seen)
            equations += int(np.count_nonzero(seen))
        parts.append(volume.rows(*within))
        told.append(measured)
        listed += here
    together = SparseVolume.stacked(grid, parts)
    threshold, particle = (float(value) for value in np.mean(told, axis=0))
    some_left(together, threshold, name)
    found = tuple(np.sqrt(squares / equations).tolist())
    return Reconstruction(together, threshold, particle, noise, listed / grid.size, found)


def _of_all(progress: Progress, number: int, count: int, done: int, total: int) -> None:
    """Tell the progress of one of several tiles as that of all."""
    progress(number * total + done, count * total)
