"""How much memory a run will take, estimated before it starts."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from math import ceil, floor, pi

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.resampling import TOGETHER
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile, cut
from plenopiv.volume import VoxelGrid

KIB = 1024
IMAGE = 10.0  # bytes of a pixel: its count, what is known of it, and what is being read
LISTED = 0.36  # share of the voxels that dense ray tracing leaves, in a deep and densely seeded volume
BASE = 355e6  # interpreter, libraries and compiled kernels, bytes
REPORT = 500e6  # the same with all that draws the report, and what is known of a thousand pairs
KEPT = 0.1  # of a volume's memory, once MART has left voxels out
SPREAD = 4.4  # voxels of the laboratory that share the light of one of lens space, where they lie close together
MEASURED = 0.12, 6  # share of the voxels that both volumes hold while they are correlated, and bytes of each
MOST_TILES = 64
LAYER = 4.0  # planes for each plane of the deepest windows: of two volumes those in use, the next, and their sources
# With a first guess of both frames: times what volumes take, bytes, and bytes for each voxel of a plane (20 planes).
GUESSED = 1.25, 25e6, 80.0
HELD = 0.3, 100e6  # share of it, and most of it, that the C library keeps once it is free: large arrays are returned
DEEPEST = max(window[2] for window in CorrelationSettings().windows)


def peak_so_far() -> float | None:
    """Largest memory, bytes, that this process has taken; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * KIB)


@dataclass(frozen=True)
class MemoryEstimate:
    """Bytes by what needs them, those of the first three all alive while the second frame is reconstructed. ``peak`` is
    their sum, or what correlation and report take if that is more: memory that ``layers`` of planes took is hardly used
    again. ``measured``: both volumes, thinned by MART, as they are correlated."""

    images: float
    light_field: float
    volumes: float
    layers: float = 0.0
    measured: float = 0.0

    @property
    def peak(self) -> float:
        """Bytes in all."""
        return max(BASE + self.light_field + self.volumes, self._after) + self.images

    @property
    def _after(self) -> float:
        return REPORT + self.layers + self.measured

    def in_tiles(self, share: float) -> MemoryEstimate:
        """The same where a share of the volume is reconstructed at once; the rest is kept as it came out."""
        return replace(self, volumes=(min(share + KEPT, 1.0)) * self.volumes)

    def keep_within(self, limit: float) -> None:
        """Raise PlenoPIVError, which states what would fit, where ``peak`` is more than ``limit`` bytes."""
        if self.peak <= limit:
            return
        least = max(BASE + self.light_field, self._after) + self.images
        available = limit - BASE - self.light_field - self.images
        takes = f"this run takes about {self.peak / 1e9:.2f} GB, more than the {limit / 1e9:.2f} GB allowed"
        if limit < least or self.volumes <= 0:
            raise PlenoPIVError(f"memory: {takes}; {least / 1e9:.2f} GB of it for anything but voxels")
        larger = ceil(100 * (self.volumes / available) ** (1 / 3)) / 100
        raise PlenoPIVError(
            f"memory: {takes}; voxels {larger:.2f} times as large along each axis (volume.voxel_mm), "
            f"or {floor(1000 * available / self.volumes) / 10:.1f} % of the volume (volume.z_mm, x_mm, y_mm), would fit"
        )


def estimate(
    camera: PlenopticCamera,
    grid: VoxelGrid,
    *,
    deepest: int = DEEPEST,
    every_voxel: bool = False,
    lens: VoxelGrid | None = None,
) -> MemoryEstimate:
    """Estimate the peak memory of a run on one pair of frames. ``deepest``: planes of its deepest windows;
    ``every_voxel``: without dense ray tracing; ``lens``: the grid of lens space, where vectors are measured on another
    ``grid``."""
    sensor = camera.sensor
    pixels = sensor.columns * sensor.rows
    lenses = 1.1 * camera.microlenses
    views = pi * (camera.aperture_radius_px + 0.6) ** 2
    layout = lenses * views * 5  # share (float32) and seen (bool)
    frame = lenses * views * 9  # values, their floor-lifted copy and masks
    listed = (1.0 if every_voxel else LISTED) * (lens or grid).size
    nz, ny, nx = grid.shape
    layers = LAYER * min(deepest, nz) * 4.0 * ny * nx
    layers += min(HELD[0] * layers, HELD[1])
    measured = 2.0 * MEASURED[0] * MEASURED[1] * (lens or grid).size
    if lens is not None and lens != grid:
        layers += 2 * SPREAD * KEPT * 8.0 * listed + 4.0 * min(nz, TOGETHER) * ny * nx
    return MemoryEstimate(IMAGE * pixels, layout + frame, 8.0 * listed, layers, measured)  # 8 bytes as they are listed


def of_settings(
    camera: PlenopticCamera,
    grid: VoxelGrid,
    reconstruction: ReconstructionSettings,
    correlation: CorrelationSettings,
    lens: VoxelGrid | None = None,
) -> MemoryEstimate:
    """``estimate`` of a run with these settings."""
    deepest = max(window[2] for window in correlation.windows)
    found = estimate(camera, grid, deepest=deepest, every_voxel=reconstruction.method == "mart", lens=lens)
    if not reconstruction.motion_tracking:
        return found
    _, ny, nx = (lens or grid).shape
    return replace(found, volumes=GUESSED[0] * found.volumes + GUESSED[1] + GUESSED[2] * ny * nx)


def tiles_within(needed: MemoryEstimate, limit: float, rows: int, passage: int) -> list[Tile]:
    """As few tiles of a volume of so many rows of voxels as keep within ``limit`` bytes (``tiles.cut``).

    Raises:
        PlenoPIVError: no tiles do.
    """
    for count in range(1, min(MOST_TILES, rows) + 1):
        tiles = cut(rows, count, passage)
        share = max(tile.high - tile.low for tile in tiles) / rows
        if (needed if count == 1 else needed.in_tiles(share)).peak <= limit:
            return tiles
    needed.keep_within(limit)
    raise AssertionError("one tile is the whole volume")
