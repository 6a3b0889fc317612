"""What a run will take, estimated before it starts: memory, time, and the tiles into which memory forces it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numba

from plenopiv.chain import Chain
from plenopiv.reconstruction.reconstruct import SHARED
from plenopiv.reconstruction.tiles import Tile, cut
from plenopiv.run import duration, memory
from plenopiv.run.duration import TimeEstimate
from plenopiv.run.memory import MemoryEstimate

log = logging.getLogger("plenopiv")
READ = 0.1  # s, a volume of half a million voxels
START = 5.0  # s, calibration, libraries, report without frames
COMPILED = 30.0  # s, a device's programs, where none is kept


@dataclass(frozen=True)
class Plan:
    """The chain of a run, in tiles where memory is short, and the memory and time that it will take; ``on_device``:
    bytes of a graphics processor's memory, 0 without one; ``reconstructs``: volumes are not there yet."""

    chain: Chain
    needed: MemoryEstimate
    takes: TimeEstimate
    on_device: float = 0.0
    reconstructs: bool = True

    @property
    def tiles(self) -> int:
        """Number of tiles; 1 for the whole volume at once."""
        return max(len(self.chain.tiles), 1)


def plan_between_volumes(chain: Chain) -> Plan:
    """What to measure between volumes that are there takes; a "frame" is then a volume that is read."""
    settings, threads = (chain.camera, chain.grid, chain.reconstruction, chain.correlation), numba.get_num_threads()
    needed = replace(memory.of_settings(*settings, chain.lens_grid), volumes=0.0)
    if not chain.unusable:
        needed = replace(needed, light_field=0.0)
    pair = duration.correlation_s(chain.grid, chain.correlation.passes) / threads
    volume = READ + duration.resampling_s(chain.grid, chain.lens_grid) / threads  # in an ensemble more than once a pair
    takes = TimeEstimate(volume, pair, START)
    if chain.device.kind == "cpu":
        return Plan(chain, needed, takes, reconstructs=False)
    from plenopiv.device.plan import pair_of  # here: it needs JAX

    on_device = pair_of(chain.grid, chain.correlation, chain.device)
    return Plan(chain, needed, replace(takes, pair=on_device.seconds, start=START + COMPILED), on_device.bytes, False)


def plan(chain: Chain, memory_gb: float | None = None) -> Plan:
    """The plan of a run of one plenoptic camera that shall take no more than ``memory_gb``.

    Raises:
        PlenoPIVError: that does not suffice, in tiles either.
    """
    rows = chain.lens_grid.shape[1]
    settings = chain.camera, chain.grid, chain.reconstruction, chain.correlation
    needed, tiles = memory.of_settings(*settings, chain.lens_grid), cut(rows, 1, 0)
    if memory_gb is not None and needed.peak > 1e9 * memory_gb:
        tiles = memory.tiles_within(needed, 1e9 * memory_gb, rows, chain.projection.passage)
        largest = max(tile.high - tile.low for tile in tiles)
        log.info("the volume is reconstructed in %d tiles, the largest of %d of %d rows", len(tiles), largest, rows)
        needed = needed.in_tiles(largest / rows)
    takes = duration.of_settings(*settings, numba.get_num_threads(), chain.lens_grid)
    takes = replace(takes, frame=takes.frame * sum(tile.high - tile.low for tile in tiles) / rows)
    planned = Plan(chain.with_tiles(tiles), needed, takes)
    if chain.device.kind != "cpu":
        planned = _on_device(planned, tiles)
    again, pair = chain.reconstruction.motion_tracking, planned.takes.pair  # frames again on this processor
    whole = replace(planned.takes, pair=pair + again * (pair + 2 * SHARED * takes.frame))
    return replace(planned, takes=whole)


def _on_device(planned: Plan, tiles: list[Tile]) -> Plan:
    """The same where a device computes: in more ``tiles`` if its memory asks for them.

    Raises:
        PlenoPIVError: no tiles suffice.
    """
    from plenopiv.device.plan import frame_of, pair_of

    chain, takes = planned.chain, planned.takes
    pair = pair_of(chain.grid, chain.correlation, chain.device)
    tiles, frame = frame_of(chain.projection, chain.reconstruction, chain.device, tiles)
    if len(tiles) > planned.tiles:
        log.info("the device's memory takes the volume in %d tiles", len(tiles))
    takes = replace(takes, frame=frame.seconds or takes.frame, pair=pair.seconds, start=takes.start + COMPILED)
    return Plan(chain.with_tiles(tiles), planned.needed, takes, max(frame.bytes, pair.bytes))
