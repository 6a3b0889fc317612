"""Discrete window offset: the displacements of the first pass refined without deformation.

Once a displacement is known to the voxel, the two windows are cut where the same particles are (Westerweel, Dabiri &
Gharib 1997, Exp. Fluids 23 20). Then only the correlation at zero residual displacement and one voxel away, along
each axis and along two, is needed. Summed directly, that costs a fraction of the transforms. Each value is normalised
by the spread of the second window,

    C(d) = sum_x (a(x) - <a>) b(x + d) / sqrt(sum_x (b(x + d) - <b>)^2),

which by the Cauchy-Schwarz inequality is highest where b is a shifted. Particles cut by the windows' ends, which bias a
plain sum toward zero, cause no bias here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numba
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.offset_kernels import BESIDE, MOVES, add_to, refine, settle
from plenopiv.displacement.windows import WindowGrid
from plenopiv.volume import Volume

Slabs = tuple[NDArray[np.float32], NDArray[np.float32]]
Work = Callable[[int, NDArray[np.int64], NDArray[np.int64], Slabs], None]


def discrete_offset(
    a: Volume, b: Volume, windows: WindowGrid, first: NDArray[np.float64], depth: DepthWeights | None = None
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Displacements (3, nz, ny, nx) from ``a`` to ``b`` in voxels, measured between windows offset by the whole voxels
    of ``first`` (same shape), and where (nz, ny, nx) one was found.

    ``first`` is kept where no maximum is found within MOVES voxels, and where a window with a margin of one voxel does
    not fit into the volume (never, if windows fill an axis). At the volume's faces both windows are shifted inward by
    up to an eighth of their size; the vector is then that of the shifted place. ``depth``: what light counts by its
    depth, here where it is in each volume.
    """
    offsets = Offsets(windows, first, depth)

    def work(layer: int, part: NDArray, places: NDArray, both: Slabs) -> None:
        vectors, again = offsets.vectors[layer, part], offsets.again[layer, part]
        refine(*both, places, np.array(windows.size), vectors, again)
        offsets.vectors[layer, part], offsets.again[layer, part] = vectors, again

    offsets.each_part(a, b, work, np.ones(offsets.again.shape, bool))
    return offsets.result()


def summed_offset(
    pairs: Iterable[tuple[Volume, Volume]],
    windows: WindowGrid,
    first: NDArray[np.float64],
    depth: DepthWeights | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """``discrete_offset`` of the sum over ``pairs``, which are gone through once for each step of a voxel that a window
    moves, ``MOVES`` + 1 times at most.

    Numerators and squared denominators are summed apart: by Cauchy-Schwarz their quotient, too, is highest where b is a
    shifted.
    """
    offsets = Offsets(windows, first, depth)
    whole = np.rint(offsets.vectors[..., ::-1]).astype(np.int64)
    moving, size = np.ones(offsets.again.shape, bool), np.array(windows.size)
    for _ in range(MOVES + 1):
        if not moving.any():
            break
        sums = np.zeros((*moving.shape, 2, BESIDE))

        def work(layer: int, part: NDArray, places: NDArray, both: Slabs, sums: NDArray = sums) -> None:
            own = sums[layer, part]
            add_to(*both, places, size, whole[layer, part], own)
            sums[layer, part] = own

        for pair in pairs:
            offsets.each_part(*pair, work, moving)
            del pair  # before the next one is loaded
        here = np.nonzero(moving)
        some = whole[here], offsets.vectors[here], offsets.again[here], moving[here]
        settle(sums[here], *some)
        whole[here], offsets.vectors[here], offsets.again[here], moving[here] = some
    return offsets.result()


class Offsets:
    """Vectors that are measured by offset windows: ``vectors`` (layers, windows of a layer, 3) x, y, z, ``again``.
    ``corners`` (windows of a layer, 2): first row and column of each."""

    def __init__(self, windows: WindowGrid, first: NDArray[np.float64], depth: DepthWeights | None = None) -> None:
        nz, ny, nx = windows.shape
        self.windows, self.depth = windows, depth
        self.vectors = np.moveaxis(first, 0, -1).reshape(nz, ny * nx, 3).copy()
        self.again = np.zeros((nz, ny * nx), bool)
        self.corners = np.array(list(product(windows.starts[1].tolist(), windows.starts[2].tolist())))
        self._reach = np.ceil(np.abs(self.vectors[..., 2]).max(1) / 2).astype(int)

    def slabs(self, planes: int) -> list[tuple[int, int]]:
        """First plane of each layer's slab, and the one behind its last, in a volume of so many planes."""
        depth, out = self.windows.size[0], []
        for start, reach in zip(self.windows.starts[0].tolist(), self._reach.tolist(), strict=True):
            further = min(reach, depth // 4) + MOVES
            out.append((max(start - further, 0), min(start + depth + further, planes)))
        return out

    def each_part(self, a: Volume, b: Volume, work: Work, chosen: NDArray[np.bool_]) -> None:
        """Call ``work(layer, part, places, slabs)`` for the ``chosen`` windows (layers, windows of a layer), some of a
        layer at a time, on several threads; ``places`` are their first voxels (z, y, x) in the ``slabs``."""
        count = 4 * numba.get_num_threads()
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            for layer, (lo, hi) in enumerate(self.slabs(a.grid.shape[0])):
                some = np.flatnonzero(chosen[layer])
                if not some.size:
                    continue
                both, start = (self._planes(a, lo, hi), self._planes(b, lo, hi)), int(self.windows.starts[0][layer])

                def some_of(part: NDArray, layer: int = layer, both: Slabs = both, begin: int = start - lo) -> None:
                    work(layer, part, np.column_stack([np.full(len(part), begin), self.corners[part]]), both)

                list(pool.map(some_of, np.array_split(some, min(count, some.size))))
                del both, some_of  # before the next layer's planes are made

    def _planes(self, volume: Volume, lo: int, hi: int) -> NDArray[np.float32]:
        planes = volume.slab(lo, hi)
        return planes if self.depth is None else self.depth.weighed(planes, lo)

    def result(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Displacements (3, nz, ny, nx), and which were found."""
        shape = self.windows.shape
        return np.moveaxis(self.vectors.reshape(*shape, 3), -1, 0), self.again.reshape(shape)
