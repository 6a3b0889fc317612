"""From one frame to a volume: candidates, MART, and the voxels that hold light. The same for all cameras.

What differs between plenoptic cameras, several of them and pinhole cameras is the projection, and which voxels MART
starts from (``candidates``). MLOS-MART of pinhole cameras is after Atkinson & Soria (2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.candidates import find_candidates, saturated_pixels
from plenopiv.reconstruction.mart import Progress, mart
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, Noise, noise_of
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile
from plenopiv.volume import SparseVolume

Guess = Callable[[SparseVolume], NDArray[np.float32]]

SMALLEST_FLOOR = 0.5  # counts: digitisation alone leaves 0.3
SHARED = 0.6  # of the iterations, from a first guess that both frames share
THIN = 0.15  # of the mean voxel of a plenoptic camera: fainter ones are left out


@dataclass(frozen=True)
class Reconstruction:
    """A reconstructed volume and how it was reached.

    ``threshold`` counts, ``particle`` counts of a typical particle in a pixel that it lights wholly in focus (0 where
    it was not measured), ``noise`` of the pixels; ``candidates`` the share of voxels that MART started from;
    ``residuals`` RMS in counts before each iteration. Means over cameras and tiles.
    """

    volume: SparseVolume
    threshold: float
    particle: float
    noise: Noise
    candidates: float
    residuals: tuple[float, ...]

    def __repr__(self) -> str:
        left = f"{self.residuals[-1]:.3g}" if self.residuals else "unknown"
        return f"<Reconstruction {self.volume!r}, {len(self.residuals)} iterations, residual {left} counts RMS>"


class Steps(NamedTuple):
    """How a tile is reconstructed: ``find`` its candidates, the rows of a tile that are ``listed``, the volume
    ``corrected`` by MART, and a tile's ``own_rows`` of it. The volume between these steps is theirs alone."""

    find: Callable[..., Any]
    listed: Callable[[Tile, Any], int]
    corrected: Callable[..., tuple[Any, list[float]]]
    own_rows: Callable[[Tile, Any], SparseVolume]


def reconstruct(
    values: NDArray[np.float32],
    projection: Projection,
    settings: ReconstructionSettings,
    *,
    counts_per_electron: float = NO_WHITE_IMAGE,
    background: NDArray[np.float32] | None = None,
    tiles: Sequence[Tile] = (),
    name: str = "frame",
    progress: Progress | None = None,
    steps: Steps | None = None,
    guess: Guess | None = None,
) -> Reconstruction:
    """Reconstruct one frame ``values`` (view, pixel), in counts above the black level (``Projection.values_of``).

    ``counts_per_electron``: of its shot noise (``noise.counts_per_electron``). ``background`` (view, pixel): counts of
    static light that were taken off, whose shot noise is left. ``tiles``: rows of voxels to be reconstructed one after
    the other (``tiles.cut``); none: the whole volume at once. ``steps``: those of a device, None for this processor's.
    ``guess``: the light that listed voxels begin with, of any total, where it is known; then fewer iterations do.

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles, or none that all cameras see in the same place.
    """
    grid, rows, steps = projection.grid, projection.grid.shape[1], steps or HERE
    if guess is not None:
        settings = replace(settings, iterations=max(round(SHARED * settings.iterations), 1))
        steps = HERE._replace(corrected=partial(_corrected, guess=guess))
    each = projection.each_camera(values)
    behind = [None] * len(each) if background is None else [own for _, own in projection.each_camera(background)]
    noises = [
        noise_of(own, one.seen, counts_per_electron, static) for (one, own), static in zip(each, behind, strict=True)
    ]
    noise = Noise(float(np.mean([found.dark for found in noises])), counts_per_electron, background)
    floor = noise.floor(SMALLEST_FLOOR)
    full = np.zeros(values.shape, bool)
    for (camera, pixels), (_, mark) in zip(each, projection.each_camera(full), strict=True):
        mark[:] = saturated_pixels(pixels, camera)
    saturated = full if full.any() else None
    tiles = tiles or [Tile(0, rows, 0, rows)]
    parts, measured, listed = list[SparseVolume](), list[tuple[float, float]](), 0
    squares, equations = np.zeros(settings.iterations), 0
    for number, tile in enumerate(tiles):
        own = projection.tile(tile.low, tile.high)
        found = steps.find(values, own, settings, noises, name)
        volume = found.volume
        if here := steps.listed(tile, volume):
            of_all = None if progress is None else partial(_of_all, progress, number, len(tiles))
            times = len(noises) * rows / (tile.high - tile.low)
            volume, residuals = steps.corrected(values, own, volume, settings, floor, saturated, times, of_all)
            count = int(np.count_nonzero(own.seen))
            squares, equations = squares + np.square(residuals) * count, equations + count
        parts.append(steps.own_rows(tile, volume))
        measured.append((found.threshold, found.particle))
        listed += here
    together = SparseVolume.stacked(grid, parts) if len(parts) > 1 else parts[0]
    threshold, particle = (float(value) for value in np.mean(measured, axis=0))
    if listed == 0:
        raise PlenoPIVError(_no_candidates(settings, len(noises), threshold, name))
    found_residuals = tuple(np.sqrt(squares / equations).tolist())
    return Reconstruction(together, threshold, particle, noise, listed / grid.size, found_residuals)


def _corrected(
    values: NDArray[np.float32],
    projection: Projection,
    volume: SparseVolume,
    settings: ReconstructionSettings,
    floor: float | NDArray[np.float32],
    saturated: NDArray[np.bool_] | None,
    times: float,
    progress: Progress | None,
    guess: Guess | None = None,
) -> tuple[SparseVolume, list[float]]:
    """MART on the listed voxels, and the residual of each iteration. Without a first guess they all start with the same
    light; ``values`` hold the volume's light so many ``times``, as of several cameras."""
    if guess is not None:
        light, first = _light(values, times), guess(volume)
        total = float(first.sum(dtype=np.float64))
        if total > 0:
            np.multiply(first, np.float32(light / total), out=volume.values)
        else:  # nothing of either frame, as in a tile's margin
            volume.values[:] = light / first.size
        del first
    elif (even := even_light(values, settings, times)) is not None:
        volume.values[:] = even / volume.column.size
    return mart(
        values,
        projection,
        volume,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        floor=floor,
        thin=thinning(settings),
        saturated=saturated,
        seed=settings.seed,
        overwrite=True,
        progress=progress,
    )


HERE = Steps(find_candidates, Tile.listed, _corrected, Tile.own_rows)


def even_light(values: NDArray[np.float32], settings: ReconstructionSettings, times: float) -> float | None:
    """Counts that all candidates together start with, each as many; None where there is a first guess of each."""
    return None if settings.method == "mlos-mart" else _light(values, times)


def _light(values: NDArray[np.float32], times: float) -> float:
    """Counts of a volume that ``values`` hold so many times."""
    return max(float(values.sum(dtype=np.float64)) / times, 1.0)


def thinning(settings: ReconstructionSettings) -> float:
    """``thin`` of ``mart``."""
    return 0.0 if settings.method == "mlos-mart" else THIN


def _no_candidates(settings: ReconstructionSettings, cameras: int, threshold: float, name: str) -> str:
    """Why nothing is left, and the way out."""
    if settings.method == "mlos-mart":
        return (
            f"{name}: no particles: nowhere do lines of sight above {threshold:.3g} counts of all cameras cross; check "
            "the calibration, the images' order and orientation, and the threshold"
        )
    if cameras > 1:
        return (
            f"{name}: no voxel is a candidate of all cameras; check how they are mounted, that the frames belong "
            f"together, and reconstruction.threshold ({threshold:.0f} counts)"
        )
    return (
        f"{name}: dense ray tracing leaves no voxel; lower reconstruction.threshold ({threshold:.0f} counts) "
        'or use reconstruction.method = "mart"'
    )


def _of_all(progress: Progress, number: int, count: int, done: int, total: int) -> None:
    """Report the progress of one of several tiles as that of all."""
    progress(number * total + done, count * total)
