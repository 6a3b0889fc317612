"""How much a pair of frames moves and computes on a device: bytes through its memory, operations, programs started.

Counted from the programs as they are written, an array that a fused loop reads or writes once for each voxel. Time
follows from them by a device's ``rates``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log2, prod

from plenopiv.displacement.depth_response import sample_of
from plenopiv.displacement.offset_kernels import BESIDE, MOVES
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.transforms import fast_length
from plenopiv.displacement.windows import window_grid

Shape = tuple[int, int, int]  # along z, y, x

FLOAT = 4.0  # bytes
ON_HOST = 2.4e-5  # s of one core, a vector of one pass: fit of its peak, median test, spline
WINDOW = 42.0  # floats that a voxel of a window reads and writes: cut, weighted, three transforms, whitened, searched
SCATTER = 52.0  # the same for what its blocks add to the peak: two transforms, seven products and their sums
SAMPLE = 64 * 5.0 + 100  # operations of a voxel sampled by the spline: 64 products, sums and places; weights
DEFORMED = 40.0  # floats that it reads and writes: displacement, places and weights; neighbours come from a cache
OFFSET = 4.3  # floats that a voxel of a window reads and writes for a second window beside the first of discrete offset
OFFSET_OPERATIONS = 7.0  # the same, operations
TRIED = 1.5  # steps of MOVES + 1 that an average window takes


@dataclass(frozen=True)
class Work:
    """Of a stage: ``moved`` bytes, ``operations``, and how often a program is started (``calls``)."""

    moved: float = 0.0
    operations: float = 0.0
    calls: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(self.moved + other.moved, self.operations + other.operations, self.calls + other.calls)

    def times(self, factor: float) -> Work:
        """As often."""
        return Work(factor * self.moved, factor * self.operations, factor * self.calls)


def correlation(shape: Shape, settings: CorrelationSettings, voxels: int) -> Mapping[str, Work]:
    """By stage, of a pair of volumes of ``shape``; ``voxels``: of the windows of a batch."""
    stages = {name: Work() for name in ("deformation", "windows", "last windows", "offset")}
    passes = settings.passes
    for number, each in enumerate(passes, 1):
        grid = window_grid(shape, *each)
        layers, rows, columns = grid.shape
        count = layers * rows * columns
        stages["deformation"] += deformation(shape, grid.size[0], grid.step[0], layers, deformed=number > 1)
        last = number == len(passes)
        stages["last windows" if last else "windows"] += windows(grid.size, count, layers, voxels, last)
        if number == 1:
            stages["offset"] += offset(grid.size, count, layers)
        if last and number > 1:
            sample = sample_of(grid)
            stages["deformation"] += deformation(shape, sample.size[0], sample.step[0], sample.shape[0])
            stages["windows"] += windows(sample.size, prod(sample.shape), sample.shape[0], voxels, scatter=False)
    return stages


def vectors(shape: Shape, settings: CorrelationSettings) -> int:
    """Of all passes, which the host validates."""
    return sum(prod(window_grid(shape, *each).shape) for each in settings.passes)


def deformation(shape: Shape, depth: int, step: int, layers: int, deformed: bool = True) -> Work:
    """Both volumes' planes of all layers of windows, each made once, and held planes moved on."""
    plane, made = shape[1] * shape[2], (layers - 1) * step + -(-depth // step) * step
    held = 2 * depth * made / step
    source = 2.0 * (1 + 16 / step)  # planes read beyond those made
    floats = plane * (held + made * (source + (DEFORMED if deformed else 1.0)))
    return Work(2 * FLOAT * floats, 2 * plane * made * (SAMPLE if deformed else 1.0), 4.0 * made / step)


def windows(size: Shape, count: int, layers: int, voxels: int, scatter: bool) -> Work:
    """So many windows of ``size`` correlated, and their peaks searched; with ``scatter``, their blocks summed too."""
    around = prod(fast_length(n) for n in size)
    batches = layers * max(1.0, count / layers * around / voxels)
    one = Work(FLOAT * WINDOW * count * around, count * around * (60 + 7.5 * log2(around)), batches)
    return one + Work(FLOAT * SCATTER * count * around, count * around * (100 + 5 * log2(around))) if scatter else one


def offset(size: Shape, count: int, layers: int) -> Work:
    """Discrete offset of so many windows."""
    sums = TRIED * BESIDE * count * prod(size)
    return Work(FLOAT * OFFSET * sums, OFFSET_OPERATIONS * sums, layers * MOVES)
