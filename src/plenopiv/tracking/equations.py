"""The normal equations of particles that share pixels.

Unknowns are x, y, z in ``Lights.unit_mm`` and light in units of each particle's own. With J (pixels, 4n) the
derivatives of pixels' counts by the unknowns, each over its pixel's standard deviation, the equations are J^T J: a
4 x 4 block for each two particles that share pixels, hundreds to a particle where volumes are deep.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from plenopiv.threads import in_threads
from plenopiv.tracking import normal_kernels
from plenopiv.tracking.light import Lights

Array = NDArray[np.float64]
Single = NDArray[np.float32]
TELLING = 0.03  # a third of the entries say less than this much of what one says on the average: .2 % of all


def entries(lights: Lights) -> tuple[NDArray, ...]:
    """What kernels take of lists of pixels."""
    return lights.start, lights.pixel, lights.share, lights.gradient


def own_equations(lights: Lights, light: Array, weight: Single, pull: Single) -> tuple[Array, Array]:
    """Each particle's own block (n, 4, 4) of the normal equations, pixels that two of its microlenses light taken as
    two, and the right side (n, 4)."""
    own, slope = np.empty((len(light), 4, 4)), np.empty((len(light), 4))
    in_threads(
        normal_kernels.own_equations, len(light), *entries(lights), light, lights.unit_mm, weight, pull, own, slope
    )
    return own, slope


def normal_equations(lights: Lights, light: Array, weight: Single, telling: float = TELLING) -> bsr_array:
    """The normal equations (4n, 4n) of particles, in blocks. Entries that say less than ``telling`` of what a
    particle's say on the average are left out, but for lights that overlap: together these would say much."""
    telling = 0.0 if lights.overlap else telling
    n, start = len(light), np.zeros(len(light) + 1, np.int64)
    told, count = np.empty(len(lights.pixel), np.bool_), np.empty(n, np.int64)
    in_threads(normal_kernels.telling_entries, n, *entries(lights), weight, telling, told, count)
    np.cumsum(count, out=start[1:])
    m, entry = int(start[-1]), np.empty(start[-1], np.int32)
    in_threads(normal_kernels.pick, n, lights.start, told, start, entry)
    del told
    pixel, pixel_end = lights.pixel[entry], np.zeros(len(weight), np.int64)
    rank, particle, whitened = np.empty(m, np.int32), np.empty(m, np.int32), np.empty((m, 4), np.float32)
    normal_kernels.by_pixels(start, pixel, pixel_end, rank, particle)
    values = lights.share, lights.gradient, light, lights.unit_mm, weight
    in_threads(normal_kernels.whiten, n, start, pixel, entry, *values, rank, whitened)
    del entry
    shared = start, pixel, pixel_end, rank, particle
    in_threads(normal_kernels.count_later, n, *shared, count)
    later_start = np.concatenate([[0], np.cumsum(count)])
    later, of_later = np.empty(later_start[-1], np.int32), np.zeros((later_start[-1], 4, 4), np.float32)
    in_threads(normal_kernels.sum_later, n, *shared, whitened, later_start, later, of_later)
    both, block_start = 2 * int(later_start[-1]) - n, np.zeros(n + 1, np.int64)
    neighbour, block = np.empty(both, np.int32), np.empty((both, 4, 4), np.float32)
    normal_kernels.both_ways(later_start, later, of_later, block_start, neighbour, block)
    return bsr_array((block, neighbour, block_start), shape=(4 * n, 4 * n))


def own_blocks(normal: bsr_array) -> Array:
    """Each particle's own block (n, 4, 4) of normal equations."""
    return np.asarray(normal.data[diagonal(normal)], np.float64)


def diagonal(normal: bsr_array) -> NDArray[np.int64]:
    """Which of the blocks are the particles' own."""
    row = np.repeat(np.arange(normal.indptr.size - 1), np.diff(normal.indptr))
    return np.flatnonzero(row == normal.indices)


def with_information(normal: bsr_array, information: Array) -> Array:
    """Add ``information`` (n, 3) on x, y, z, in the unknowns' units, to each particle's, in place; their own blocks
    (n, 4, 4)."""
    own = diagonal(normal)
    for axis in range(3):
        normal.data[own, axis, axis] += information[:, axis]
    return own_blocks(normal)
