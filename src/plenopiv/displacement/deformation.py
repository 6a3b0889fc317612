"""Symmetric deformation: volume A sampled at x - d/2, volume B at x + d/2 (Astarita & Cardone 2005).

The sampling kernel is the cubic B-spline without prefilter. It neither rings nor depends on the sub-voxel phase, needs
no recursion over the volume, and smooths by a Gaussian of variance 1/3 voxel^2, part of the smoothing that particle
images of one or two voxels need before correlation anyway.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.predictor import SplineField
from plenopiv.kernels import inlined, kernel, part
from plenopiv.threads import in_threads
from plenopiv.volume import Volume

CHUNK = 256  # voxels of a row sampled at once
SPLINE_VARIANCE = 1.0 / 3.0  # voxel^2, of the cubic B-spline


class DeformedPlanes:
    """Planes of a volume, sampled at x + share * d(x); made in ascending order, a few at a time.

    ``share`` is -0.5 for the first volume of a pair and +0.5 for the second. Peak memory: the planes asked for, and
    those of the source that they reach.
    """

    def __init__(self, volume: Volume, predictor: SplineField, share: float) -> None:
        self.volume, self.predictor, self.share = volume, predictor, share
        _, ny, nx = volume.grid.shape
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
        about = source, source_lo, lo, along_x, *self._y, np.float32(self.share), out
        in_threads(_sample, out.shape[0] * out.shape[1], *about)
        return out


@kernel
def _expand_x(planes, first, weights):
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
def _weights(t):
    """Uniform cubic B-spline at the fraction t, float32."""
    u = np.float32(1.0) - t
    sixth = np.float32(1.0 / 6.0)
    w0 = u * u * u * sixth
    w3 = t * t * t * sixth
    w1 = np.float32(2.0 / 3.0) - t * t * (np.float32(1.0) - np.float32(0.5) * t)
    w2 = np.float32(2.0 / 3.0) - u * u * (np.float32(1.0) - np.float32(0.5) * u)
    return w0, w1, w2, w3


@part
def _split(d, count, whole, weights):
    """Displacements ``d`` (count,) as whole voxels and the spline's weights (4 * CHUNK)."""
    for i in range(count):
        # whole and fractional parts apart: a float32 of the position itself would lose digits in large volumes
        f = np.floor(d[i])
        whole[i] = np.int32(f)
        w0, w1, w2, w3 = _weights(d[i] - f)
        weights[i], weights[CHUNK + i], weights[2 * CHUNK + i], weights[3 * CHUNK + i] = w0, w1, w2, w3


@part
def _add_line(line, count, of_x, of_y, out):
    """Add to ``out`` the weighted four neighbours in a line of the source, for voxels of a chunk that moved alike."""
    for i in range(count):
        near = of_x[i] * line[i] + of_x[CHUNK + i] * line[i + 1]
        far = of_x[2 * CHUNK + i] * line[i + 2] + of_x[3 * CHUNK + i] * line[i + 3]
        out[i] += of_y[i] * (near + far)


@part
def _add_plane(lines, count, of_z, out):
    """Add a plane's sum to ``out``, and clear it."""
    for i in range(count):
        out[i] += of_z[i] * lines[i]
        lines[i] = np.float32(0)


@part
def _add_at_face(source, x0, y0, z0, i, weights, out):
    """Voxel i of a chunk, some of whose 64 neighbours lie outside the source."""
    depth, ny, nx = source.shape
    total = np.float32(0.0)
    for a, b, e in np.ndindex(4, 4, 4):
        z, y, x = z0 + a, y0 + b, x0 + e
        if 0 <= z < depth and 0 <= y < ny and 0 <= x < nx:
            w = weights[2, a * CHUNK + i] * weights[1, b * CHUNK + i] * weights[0, e * CHUNK + i]
            total += w * source[z, y, x]
    out[i] = total


@part
def _sample_chunk(source, x, y, z, d, count, whole, weights, lines, out):
    """Sample voxels x to x + count of a row at z, y (of the source), moved by ``d`` (3, count), into ``out``.

    Voxels that moved by the same whole number of voxels along each axis, most of a row, are summed as one vector.
    """
    depth, ny, nx = source.shape
    for c in range(3):
        _split(d[c], count, whole[c], weights[c])
    out[:count] = np.float32(0)
    first = 0
    while first < count:
        dx, dy, dz = whole[0, first], whole[1, first], whole[2, first]
        last = first + 1
        while last < count and whole[0, last] == dx and whole[1, last] == dy and whole[2, last] == dz:
            last += 1
        x0, y0, z0 = x + np.int64(dx) - 1, y + np.int64(dy) - 1, z + np.int64(dz) - 1
        begin, end = first, first  # those of them whose neighbours all lie inside
        if 0 <= y0 < ny - 3 and 0 <= z0 < depth - 3:
            begin = min(max(first, -x0), last)
            end = max(min(last, nx - 3 - x0), begin)
        if begin < end:
            for a in range(4):
                for b in range(4):
                    of_x, of_y = weights[0, begin:], weights[1, b * CHUNK + begin :]
                    _add_line(source[z0 + a, y0 + b, x0 + begin :], end - begin, of_x, of_y, lines)
                _add_plane(lines, end - begin, weights[2, a * CHUNK + begin :], out[begin:])
        if -4 < y0 < ny and -4 < z0 < depth:
            for i in range(first, last):
                if not begin <= i < end and -4 < x0 + i < nx:
                    _add_at_face(source, x0 + i, y0, z0, i, weights, out)
        first = last


@part
def _add_share(line, count, share, out):
    """Add ``share`` of a line to ``out``."""
    for i in range(count):
        out[i] += share * line[i]


@part
def _sample_row(source, lines_of_d, shares, y, z, out):
    """Sample a row at y, z of the source, moved by the sums of lines of displacement (3, 4, nx) times ``shares``."""
    d, lines = np.empty((3, CHUNK), np.float32), np.zeros(CHUNK, np.float32)
    whole, weights = np.empty((3, CHUNK), np.int32), np.empty((3, 4 * CHUNK), np.float32)
    for x in range(0, out.size, CHUNK):
        count = min(CHUNK, out.size - x)
        d[:] = np.float32(0)
        for c in range(3):
            for t in range(4):
                _add_share(lines_of_d[c, t, x:], count, shares[t], d[c])
        _sample_chunk(source, x, y, z, d, count, whole, weights, lines, out[x:])


@kernel
def _sample(begin, end, source, source_lo, lo, along_x, first_y, weights_y, share, out):
    ny = out.shape[1]
    for row in range(begin, end):
        k, j = row // ny, row % ny
        lines_of_d = along_x[k, :, first_y[j] : first_y[j] + 4]
        _sample_row(source, lines_of_d, weights_y[j] * share, j, k + lo - source_lo, out[k, j])
