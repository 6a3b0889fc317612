"""Symmetric deformation: volume A sampled at x - d/2, volume B at x + d/2 (Astarita & Cardone 2005).

The sampling kernel is the cubic B-spline without prefilter. It neither rings nor depends on the sub-voxel phase, needs
no recursion over the volume, and smooths by a Gaussian of variance 1/3 voxel^2, part of the smoothing that particle
images of one or two voxels need before correlation anyway.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.butterflies import LANES
from plenopiv.displacement.predictor import SplineField
from plenopiv.displacement.splines import sample_sixteen
from plenopiv.kernels import borrowed, inlined, kernel, part
from plenopiv.threads import in_threads
from plenopiv.volume import Volume

CHUNK = 256  # voxels of a row whose displacements are found at once
BLOCK = LANES  # of them, sampled at once, or left out where no particle is
STRIDE = np.int64(CHUNK + BLOCK)  # from one component of them to the next; a block may begin in any voxel
SPLINE_VARIANCE = 1.0 / 3.0  # voxel^2, of the cubic B-spline


class DeformedPlanes:
    """Planes of a volume, sampled at x + share * d(x); made in ascending order, a few at a time.

    ``share`` is -0.5 for the first volume of a pair and +0.5 for the second. ``rows`` (ny,): of which samples are
    asked for, by default all; the others are zero. Peak memory: the planes asked for, and those of the source that they
    reach.
    """

    def __init__(
        self, volume: Volume, predictor: SplineField, share: float, rows: NDArray[np.bool_] | None = None
    ) -> None:
        self.volume, self.predictor, self.share = volume, predictor, share
        _, ny, nx = volume.grid.shape
        self._rows = np.ones(ny, bool) if rows is None else rows
        self._y = predictor.taps(1, np.arange(ny))
        self._x = predictor.taps(2, np.arange(nx))

    def slab(self, lo: int, hi: int) -> NDArray[np.float32]:
        """Deformed planes lo <= k < hi, float32 (hi - lo, ny, nx); zero where they come from outside the volume."""
        first, weights = self.predictor.taps(0, np.arange(lo, hi))
        c = self.predictor.coefficients
        # along z first: (planes, 3, rows of coefficients, columns of coefficients)
        planes = np.einsum("kt,cktyx->kcyx", weights, c[:, first[:, None] + np.arange(4)])
        along_x = _expand_x(np.ascontiguousarray(planes), *self._x)
        # a spline stays within its coefficients, so this many source planes are enough
        reach = ceil(abs(self.share) * float(np.abs(planes[:, 2]).max())) + 3
        nz = self.volume.grid.shape[0]
        source_lo, source_hi = max(lo - reach, -2), min(hi + reach, nz + 2)
        source = self.volume.slab(source_lo, source_hi)
        out = np.empty((hi - lo, *source.shape[1:]), np.float32)
        marks = np.empty((*source.shape[:2], -(-source.shape[2] // BLOCK)), np.uint8)
        in_threads(_mark, source.shape[0] * source.shape[1], source, marks)
        about = source, marks, source_lo, lo, along_x, self._rows, *self._y, np.float32(self.share), out
        in_threads(_sample, out.shape[0] * out.shape[1], *about)
        return out


@kernel
def _expand_x(
    planes: NDArray[np.float32], first: NDArray[np.int64], weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Coefficients (planes, 3, rows, columns) to values along x: (planes, 3, rows, nx)."""
    count, _, rows, _ = planes.shape
    nx = first.size
    out = np.empty((count, 3, rows, nx), np.float32)
    for k in range(count):
        for c in range(3):
            for r in range(rows):
                for i in range(nx):
                    f = first[i]
                    out[k, c, r, i] = (
                        weights[i, 0] * planes[k, c, r, f]
                        + weights[i, 1] * planes[k, c, r, f + 1]
                        + weights[i, 2] * planes[k, c, r, f + 2]
                        + weights[i, 3] * planes[k, c, r, f + 3]
                    )
    return out


@inlined
def _weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Uniform cubic B-spline at the fraction t, float32."""
    u = np.float32(1.0) - t
    sixth = np.float32(1.0 / 6.0)
    w0 = u * u * u * sixth
    w3 = t * t * t * sixth
    w1 = np.float32(2.0 / 3.0) - t * t * (np.float32(1.0) - np.float32(0.5) * t)
    w2 = np.float32(2.0 / 3.0) - u * u * (np.float32(1.0) - np.float32(0.5) * u)
    return w0, w1, w2, w3


@kernel
def _mark(begin: int, end: int, source: NDArray[np.float32], marks: NDArray[np.uint8]) -> None:
    """Of rows begin to end of the source, whether a line holds anything: ``marks`` (planes, ny, blocks), one for all
    that a block of samples may reach whose first neighbour is among BLOCK voxels."""
    _, ny, nx = source.shape
    for row in range(begin, end):
        line, own = source[row // ny, row % ny], marks[row // ny, row % ny]
        for m in range(own.size):
            own[m] = _held(line[m * BLOCK :], min(2 * BLOCK + 2, nx - m * BLOCK))


@part
def _held(line: NDArray[np.float32], count: int) -> np.int32:
    """Whether any of ``count`` voxels is not zero."""
    found = np.int32(0)
    for i in range(count):
        found |= np.int32(line[i] != np.float32(0))
    return found


@part
def _any_marked(marks: NDArray[np.uint8], x0: int, y0: int, z0: int) -> bool:
    """Whether a block of samples may reach a particle."""
    found, m = False, x0 // BLOCK
    for a in range(4):
        for b in range(4):
            found |= marks[z0 + a, y0 + b, m] != 0
    return found


@part
def _at_face(
    source: NDArray[np.float32], marks: NDArray[np.uint8], x0: int, y0: int, z0: int, d: NDArray[np.float32], i: int
) -> np.float32:
    """Voxel i of a chunk, some of whose 64 neighbours, from x0, y0, z0 on, lie outside the source."""
    depth, ny, nx = source.shape
    total = np.float32(0.0)
    of_x = _weights(d[0, i] - np.floor(d[0, i]))
    of_y = _weights(d[1, i] - np.floor(d[1, i]))
    of_z = _weights(d[2, i] - np.floor(d[2, i]))
    m = max(x0, 0) // BLOCK
    for a in range(max(-z0, 0), min(depth - z0, 4)):
        for b in range(max(-y0, 0), min(ny - y0, 4)):
            if marks[z0 + a, y0 + b, m]:
                for e in range(max(-x0, 0), min(nx - x0, 4)):
                    total += of_z[a] * of_y[b] * of_x[e] * source[z0 + a, y0 + b, x0 + e]
    return total


@part
def _alike(whole: NDArray[np.int32], first: int, last: int) -> bool:
    """Whether voxels ``first`` to ``last`` moved by the same whole number of voxels along each axis."""
    differ = np.int32(0)
    for c in range(3):
        of_axis = whole[c, first:]
        for i in range(last - first):
            differ |= of_axis[i] ^ of_axis[0]
    return differ == 0


@part
def _displacements(
    line_0: NDArray[np.float32],
    line_1: NDArray[np.float32],
    line_2: NDArray[np.float32],
    line_3: NDArray[np.float32],
    shares: NDArray[np.float32],
    share: np.float32,
    count: int,
    d: NDArray[np.float32],
) -> None:
    """The sum of four lines times their shares."""
    s0, s1, s2, s3 = shares[0] * share, shares[1] * share, shares[2] * share, shares[3] * share
    for i in range(count):
        d[i] = (s0 * line_0[i] + s1 * line_1[i]) + (s2 * line_2[i] + s3 * line_3[i])


@part
def _whole(d: NDArray[np.float32], count: int, whole: NDArray[np.int32]) -> None:
    """Displacements rounded down (in one function with their sum, neither loop would become vectors)."""
    for i in range(count):
        whole[i] = np.int32(np.floor(d[i]))


@part
def _sample_rows(
    begin: int,
    end: int,
    source: NDArray[np.float32],
    marks: NDArray[np.uint8],
    source_lo: int,
    lo: int,
    along_x: NDArray[np.float32],
    rows: NDArray[np.bool_],
    first_y: NDArray[np.int64],
    weights_y: NDArray[np.float32],
    share: np.float32,
    out: NDArray[np.float32],
    room: tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]],
) -> None:
    """See ``_sample``; ``room`` are work arrays."""
    source, marks, along_x, weights_y, out = borrowed((source, marks, along_x, weights_y, out))
    d, whole, sixteen = borrowed(room)
    depth, ny, nx = source.shape
    blocks = marks.shape[2]
    flat, flat_marks, flat_d = source.reshape(-1), marks.reshape(-1), d.reshape(-1)
    for row in range(begin, end):
        k, j = row // ny, row % ny
        z, f, here = k + lo - source_lo, first_y[j], out[k, j]
        here[:] = np.float32(0)
        if not rows[j]:
            continue
        for x in range(0, nx, CHUNK):
            count = min(CHUNK, nx - x)
            for c in range(3):
                four = (
                    along_x[k, c, f, x:],
                    along_x[k, c, f + 1, x:],
                    along_x[k, c, f + 2, x:],
                    along_x[k, c, f + 3, x:],
                )
                _displacements(*four, weights_y[j], share, count, d[c])
                _whole(d[c], count, whole[c])
            first = 0
            while first < count:
                last = min(first + BLOCK, count)
                while not _alike(whole, first, last):
                    last -= 1
                # from ``inner`` to ``outer`` all 64 neighbours lie in the source
                x0, y0 = x + np.int64(whole[0, first]) - 1, j + np.int64(whole[1, first]) - 1
                z0, inner, outer = z + np.int64(whole[2, first]) - 1, first, first
                if 0 <= y0 < ny - 3 and 0 <= z0 < depth - 3:
                    inner = min(max(first, -x0), last)
                    outer = max(min(last, nx - 3 - x0), inner)
                at = (z0 * ny + y0) * nx + x0 + inner
                if at + 3 * ny * nx + 3 * nx + BLOCK + 3 > flat.size:
                    outer = inner  # a whole block would read beyond the source's end
                if inner < outer and _any_marked(marks, x0 + inner, y0, z0):
                    mark = (z0 * ny + y0) * blocks + (x0 + inner) // BLOCK
                    about = flat_marks, mark, blocks, ny * blocks, flat_d, inner, STRIDE
                    sample_sixteen(flat, at, nx, ny * nx, *about, sixteen)
                    for i in range(outer - inner):
                        here[x + inner + i] = sixteen[i]
                if outer - inner < last - first and -4 < y0 < ny and -4 < z0 < depth:
                    for i in range(first, last):
                        if not inner <= i < outer and -4 < x0 + i < nx:
                            here[x + i] = _at_face(source, marks, x0 + i, y0, z0, d, i)
                first = last


@kernel
def _sample(
    begin: int,
    end: int,
    source: NDArray[np.float32],
    marks: NDArray[np.uint8],
    source_lo: int,
    lo: int,
    along_x: NDArray[np.float32],
    rows: NDArray[np.bool_],
    first_y: NDArray[np.int64],
    weights_y: NDArray[np.float32],
    share: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Rows begin to end of ``out``, if asked for: voxels of the source, moved by the sum of four lines of ``along_x``.
    Those that moved by the same whole number of voxels along each axis, most of a row, are sampled sixteen at a
    time."""
    room = np.zeros((3, STRIDE), np.float32), np.zeros((3, CHUNK), np.int32), np.zeros(BLOCK, np.float32)
    _sample_rows(begin, end, source, marks, source_lo, lo, along_x, rows, first_y, weights_y, share, out, room)
