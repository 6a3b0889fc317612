"""What a run will take, estimated before it starts: memory, time, and the tiles into which memory forces it."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numba

from plenopiv.chain import Chain
from plenopiv.device.correlation_memory import room
from plenopiv.reconstruction.tiles import cut
from plenopiv.run import duration, memory
from plenopiv.run.duration import TimeEstimate
from plenopiv.run.memory import MemoryEstimate

log = logging.getLogger("plenopiv")
READ = 0.1  # s, a volume of half a million voxels
START = 5.0  # s, calibration, libraries, report without frames


@dataclass(frozen=True)
class Plan:
    """The chain of a run, in tiles where memory is short, and the memory and time that it will take; ``on_device``:
    bytes of a graphics processor's memory, 0 without one."""

    chain: Chain
    needed: MemoryEstimate
    takes: TimeEstimate
    on_device: float = 0.0

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
    return Plan(chain, needed, TimeEstimate(volume, pair, START), correlation_on_device(chain))


def correlation_on_device(chain: Chain) -> float:
    """Bytes of its device's memory that the chain's correlation takes; 0 where this processor correlates.

    Raises:
        PlenoPIVError: it has fewer than the planes of one layer of windows take.
    """
    if chain.device.kind == "cpu":
        return 0.0
    return room(chain.grid.shape, chain.correlation, chain.device.memory).needed


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
    return Plan(chain.with_tiles(tiles), needed, takes, correlation_on_device(chain))
