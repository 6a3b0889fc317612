"""What a chain takes of its device: bytes of memory, tiles, and seconds, before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numba

from plenopiv.device import work
from plenopiv.device.backend import Device
from plenopiv.device.correlation_memory import room
from plenopiv.device.mart import exponents
from plenopiv.device.memory import frame_bytes
from plenopiv.device.plenoptic import PlenopticOnDevice
from plenopiv.device.projection import on_device
from plenopiv.device.rates import bare
from plenopiv.device.work import Work
from plenopiv.device.work_of_frames import LISTED, groups_of, reconstruction
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile, cut
from plenopiv.volume import VoxelGrid

MOST_TILES = 64
SHRINKS = 0.97  # of its bytes that a frame in more tiles may take; else more of them are of no use


@dataclass(frozen=True)
class FrameWork:
    """Of a frame: ``stages``, and of how many corrections of the volume (``groups``) two of them are the sum."""

    stages: Mapping[str, Work]
    groups: int


@dataclass(frozen=True)
class Taken:
    """``bytes`` of the device's memory, and ``seconds``, 0 where they are not known."""

    bytes: float
    seconds: float


def frame_of(
    projection: Projection, settings: ReconstructionSettings, device: Device, tiles: list[Tile]
) -> tuple[list[Tile], Taken]:
    """As few tiles as keep a frame within the device's memory, ``tiles`` at the least, and what it takes then. The time
    is known of one plenoptic camera. Programs are compiled for what is tried, some seconds each.

    Raises:
        PlenoPIVError: no tiles do.
    """
    with device.in_use():
        tiles, needed = _tiles(projection, settings, device, tiles)
        seconds = 0.0
        if isinstance(projection, PlenopticProjector):
            stages = frame_work(projection, settings).stages
            rows = sum(tile.high - tile.low for tile in tiles)
            seconds = sum(bare(device).seconds(stages).values()) * rows / projection.grid.shape[1]
    return tiles, Taken(needed, seconds)


def _tiles(
    projection: Projection, settings: ReconstructionSettings, device: Device, tiles: list[Tile]
) -> tuple[list[Tile], float]:
    def taken(tiles: list[Tile]) -> float:
        return float(frame_bytes(projection, settings, [max(tiles, key=lambda tile: tile.high - tile.low)]))

    needed = least = taken(tiles)
    rows = projection.grid.shape[1]
    while device.memory is not None and least > device.memory:
        # in proportion at the least; margins, and what does not shrink with the volume, call for more
        count, before = max(len(tiles) + 1, ceil(len(tiles) * least / device.memory)), least
        if count <= min(MOST_TILES, rows):
            tiles = cut(rows, count, projection.passage)
            least = taken(tiles)
        if least > SHRINKS * before:
            raise PlenoPIVError(
                f"compute.device_memory_gb: a frame takes {needed / 1e9:.2g} GB of the device's memory, and in tiles "
                f"hardly less than {least / 1e9:.2g} GB; there are {device.memory / 1e9:.2g} GB: use larger voxels "
                '(volume.voxel_mm), or compute.device = "cpu"'
            )
    return tiles, least


def pair_of(grid: VoxelGrid, settings: CorrelationSettings, device: Device) -> Taken:
    """A pair's correlation, with what the host does for each vector.

    Raises:
        PlenoPIVError: the device's memory does not suffice for the planes of one layer of windows.
    """
    with device.in_use():
        plan = room(grid.shape, settings, device.memory)
        stages = bare(device).seconds(work.correlation(grid.shape, settings, plan.voxels))
    on_host = work.ON_HOST * work.vectors(grid.shape, settings) / numba.get_num_threads()
    return Taken(plan.needed, sum(stages.values()) + on_host)


def frame_work(projection: PlenopticProjector, settings: ReconstructionSettings) -> FrameWork:
    """What a frame of one plenoptic camera takes, on the device in use."""
    device = on_device(projection)
    assert isinstance(device, PlenopticOnDevice)
    groups = groups_of(exponents(settings.iterations, settings.relaxation, projection.views), projection.views)
    _, ny, nx = projection.grid.shape
    judged, judging = [], 0
    if settings.method != "mart":
        judged = [(found.number.size, window[0] * window[1]) for window, found in device.judges.planes]
        judging = device.judges.order.size
    planes = device.form.buckets if max(groups) == 1 else device.form.twos
    about = planes, device.form.asking, device.form.pixels, groups, judged, judging
    listed = 1.0 if settings.method == "mart" else LISTED
    return FrameWork(reconstruction((ny, nx), *about, listed), len(groups))


def one_group(found: FrameWork) -> dict[str, Work]:
    """The same of one correction of the volume alone, and of all of dense ray tracing."""
    share = {name: 1.0 if name == "candidates" else 1.0 / found.groups for name in found.stages}
    return {name: stage.times(share[name]) for name, stage in found.stages.items()}
