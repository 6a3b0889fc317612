"""Light of cells that lie within the disc of the aperture as a whole, from a table.

Such a cell is an even polygon on the sensor, the same for all microlenses that a point lights. What it gives to the
pixels about it depends on its size, q pixels to a microlens pitch, and on where in a pixel its middle is. The table
holds, for steps of both, each pixel's share F of a cell of density 1, as F / q^2, with its first and second derivatives
by x, y and q: from the integrals along its edges (``edge_integrals``) and from differences of those. Between the steps
stands Taylor's series.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, floor, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part
from plenopiv.threads import in_threads
from plenopiv.tracking.edge_integrals import EDGE, TAIL, at_node, node_of, nodes_of, pixel_profile

STEPS = 5.0  # of a cell's place in a standard deviation of the blur: derivatives are right to a third of a percent
SIZE_STEPS = 2.0  # steps of place in one of size: an edge is half a size from the middle
LARGEST_PX = 3.0  # per pitch: of larger cells few are whole
SHARPEST_PX = 0.1  # standard deviation of the blur below which a table would be too large
ROUNDING = 1e-9  # of a size, by which kernels may know it otherwise: both sizes are made where it is between two
VALUES = 10  # F / q^2, its derivatives by x, y, q, and by xx, xy, yy, xq, yq, qq

Array = NDArray[np.float64]


class WholeCells(NamedTuple):
    """``values``: rows of VALUES; of size k from row ``first[k]`` on (steps, steps, pixels) of them, places row by row
    along y, then a square patch of 2 ``half[k]`` + 1 pixels about the pixel that holds the middle. Size k is (k + 1)
    ``size_step``; no sizes: there is no table. ``far``: pitches from a cell's middle to its farthest corner."""

    steps: int  # in a pixel
    size_step: float
    far: float
    half: NDArray[np.int64]
    first: NDArray[np.int64]
    values: NDArray[np.float32]


class CellTables:
    """The table of a cell with the ``corner``s (n, 2) in pitches, along columns and rows, anticlockwise, up to a size
    of ``largest_px``; each size is tabulated when it is first asked for."""

    def __init__(self, corner: Array, blur_px: float, largest_px: float):
        self.profile = pixel_profile(blur_px)
        self._corner, self._tail_px = corner, 0.5 + TAIL * blur_px
        steps = ceil(STEPS / blur_px)
        size_step = SIZE_STEPS / steps
        count = int(largest_px / size_step)
        most = np.abs(corner).max() * (np.arange(count) + 1.5) * size_step
        half = np.ceil(most + EDGE * blur_px).astype(np.int64)
        first = np.concatenate([[0], np.cumsum(steps**2 * (2 * half + 1) ** 2)]).astype(np.int64)
        values = np.empty((first[-1], VALUES), np.float32)  # takes memory where it is filled
        self.cells = WholeCells(steps, size_step, float(np.hypot(*corner.T).max()), half, first, values)
        self._made = np.zeros(count, bool)

    def make(self, size_px: Array) -> None:
        """Fill in what cells of these sizes (n,) need."""
        cells = self.cells
        around = np.concatenate([size_px * (1.0 - ROUNDING), size_px * (1.0 + ROUNDING)])
        number = np.floor(around / cells.size_step + 0.5) - 1
        for k in np.unique(number[(number >= 0) & (number < len(cells.half))]).astype(np.int64).tolist():
            if not self._made[k]:
                cells.values[cells.first[k] : cells.first[k + 1]] = self._of_size(k).reshape(-1, VALUES)
                self._made[k] = True

    def _of_size(self, k: int) -> NDArray[np.float32]:
        steps, step = self.cells.steps, self.cells.size_step
        half = int(self.cells.half[k])
        around = np.empty((3, steps + 2, steps + 2, (2 * half + 1) ** 2, 4))
        fixed = self._corner, self._tail_px, self.profile, (k + np.arange(3.0)) * step, half, steps
        in_threads(_tabulate, 3 * (steps + 2), *fixed, around)
        middle = around[1, 1:-1, 1:-1]
        by_y, by_x = ((around[1, 2:, 1:-1] - around[1, :-2, 1:-1]), (around[1, 1:-1, 2:] - around[1, 1:-1, :-2]))
        by_size = (around[2] - around[0])[1:-1, 1:-1, :, 3] / (2.0 * step)
        by_y, by_x = 0.5 * steps * by_y, 0.5 * steps * by_x
        second = [by_x[..., 1], 0.5 * (by_x[..., 2] + by_y[..., 1]), by_y[..., 2], by_x[..., 3], by_y[..., 3], by_size]
        return np.concatenate([middle, np.stack(second, -1)], -1).astype(np.float32)


def cell_tables(corner: Array, blur_px: float) -> CellTables:
    """The table of a cell, shared by all that ask for the same; an empty one where it would be too large."""
    return _shared(corner.tobytes(), blur_px) if blur_px >= SHARPEST_PX else CellTables(corner, blur_px, 0.0)


@lru_cache(maxsize=2)
def _shared(corner: bytes, blur_px: float) -> CellTables:
    return CellTables(np.frombuffer(corner).reshape(-1, 2), blur_px, LARGEST_PX)


@kernel
def _tabulate(
    begin: int, end: int, corner: Array, tail_px: float, profile: NDArray[np.float32], sizes: Array,
    half: int, steps: int,
    out: Array,  # (sizes, steps + 2, steps + 2, pixels, 4), filled: F / q^2 and its derivatives
) -> None:  # fmt: skip
    """Fill the rows ``begin`` to ``end`` of places along y, those beside the pixel included, of all sizes."""
    side, places = 2 * half + 1, steps + 2
    column, patch = np.empty(4 * side, np.float32), np.empty((side, 4 * side), np.float32)
    for row in range(begin, end):
        size = max(sizes[row // places], 1e-3)
        y0 = half + (row % places - 0.5) / steps - 0.5
        for place in range(places):
            x0 = half + (place - 0.5) / steps - 0.5
            patch[:] = 0.0
            for c in range(corner.shape[0]):
                other = (c + 1) % corner.shape[0]
                ax, ay = size * corner[c, 0], size * corner[c, 1]
                dx, dy = size * corner[other, 0] - ax, size * corner[other, 1] - ay
                length = sqrt(dx * dx + dy * dy)
                nx, ny = dy / length, -dx / length
                count = nodes_of(length)
                for node in range(count):
                    middle, ds = node_of(node, count, length)
                    x, y = ax + middle * dx, ay + middle * dy
                    grows = (x * nx + y * ny) / size * ds
                    at_node(
                        tail_px, profile, x0 + x, y0 + y, side, side, nx * ds, nx * ds, ny * ds, grows, column, patch
                    )
            area = 1.0 / (size * size)
            here = out[row // places, row % places, place]
            for n in range(side * side):
                r, q = n // side, 4 * (n % side)
                for v in range(4):
                    here[n, v] = patch[r, q + v] * area
                here[n, 3] -= 2.0 * here[n, 0] / size


@part
def number_of(cells: WholeCells, size: float) -> int:
    """The number of the size that is nearest to ``size``; -1: there is none."""
    k = floor(size / cells.size_step + 0.5) - 1
    return k if 0 <= k < cells.half.size else -1


@part
def place_of(cells: WholeCells, k: int, x: float, y: float) -> tuple[int, float, float]:
    """Where the values of a cell of size k begin, whose middle is (x, y) from that of its pixel, and how far it is from
    the place that they are of."""
    i = min(max(int((x + 0.5) * cells.steps), 0), cells.steps - 1)
    j = min(max(int((y + 0.5) * cells.steps), 0), cells.steps - 1)
    side = 2 * cells.half[k] + 1
    first = cells.first[k] + (j * cells.steps + i) * side * side
    return first, x + 0.5 - (i + 0.5) / cells.steps, y + 0.5 - (j + 0.5) / cells.steps


@part
def expanded(
    values: NDArray[np.float32], at: np.uint64, dx: np.float32, dy: np.float32, dq: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """F / q^2 and its derivatives by x, y and q of the pixel whose values are the row ``at``."""
    f, fx, fy, fq = values[at, 0], values[at, 1], values[at, 2], values[at, 3]
    gx = fx + dx * values[at, 4] + dy * values[at, 5] + dq * values[at, 7]
    gy = fy + dx * values[at, 5] + dy * values[at, 6] + dq * values[at, 8]
    gq = fq + dx * values[at, 7] + dy * values[at, 8] + dq * values[at, 9]
    half = np.float32(0.5)
    return f + half * (dx * (fx + gx) + dy * (fy + gy) + dq * (fq + gq)), gx, gy, gq
