"""Symmetric deformation: volume A sampled at x - d/2, volume B at x + d/2 (Astarita & Cardone 2005).

The sampling kernel is the cubic B-spline without prefilter. It neither rings nor depends on the sub-voxel phase, needs
no recursion over the volume, and smooths by a Gaussian of variance 1/3 voxel^2, part of the smoothing that particle
images of one or two voxels need before correlation anyway.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numba import prange
from numpy.typing import NDArray

from plenopiv.displacement.predictor import SplineField
from plenopiv.kernels import inlined, parallel_kernel
from plenopiv.volume import Volume

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
        return _sample(source, source_lo, lo, along_x, *self._y, np.float32(self.share))


@parallel_kernel
def _expand_x(planes, first, weights):
    """Coefficients (planes, 3, rows, columns) to values along x: (planes, 3, rows, nx)."""
    count, _, rows, _ = planes.shape
    nx = first.size
    out = np.empty((count, 3, rows, nx), np.float32)
    for k in prange(count):
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


@parallel_kernel
def _sample(source, source_lo, lo, along_x, first_y, weights_y, share):
    count = along_x.shape[0]
    depth, ny, nx = source.shape
    out = np.empty((count, ny, nx), np.float32)
    for row in prange(count * ny):
        k, j = row // ny, row % ny
        d = np.zeros((3, nx), np.float32)
        for c in range(3):
            for t in range(4):
                w = weights_y[j, t] * share
                line = along_x[k, c, first_y[j] + t]
                for i in range(nx):
                    d[c, i] += w * line[i]
        for i in range(nx):
            # whole and fractional parts apart: a float32 of the position itself would lose digits in large volumes
            fx, fy, fz = np.floor(d[0, i]), np.floor(d[1, i]), np.floor(d[2, i])
            x0 = i + np.int64(fx) - 1
            y0 = j + np.int64(fy) - 1
            z0 = k + lo - source_lo + np.int64(fz) - 1
            wx0, wx1, wx2, wx3 = _weights(d[0, i] - fx)
            wy = _weights(d[1, i] - fy)
            wz = _weights(d[2, i] - fz)
            total = np.float32(0.0)
            if x0 >= 0 and y0 >= 0 and z0 >= 0 and x0 + 3 < nx and y0 + 3 < ny and z0 + 3 < depth:
                for a in range(4):
                    part = np.float32(0.0)
                    for b in range(4):
                        s = source[z0 + a, y0 + b]
                        part += wy[b] * (wx0 * s[x0] + wx1 * s[x0 + 1] + wx2 * s[x0 + 2] + wx3 * s[x0 + 3])
                    total += wz[a] * part
            elif x0 > -4 and y0 > -4 and z0 > -4 and x0 < nx and y0 < ny and z0 < depth:
                wx = (wx0, wx1, wx2, wx3)
                for a, b, e in np.ndindex(4, 4, 4):
                    z, y, x = z0 + a, y0 + b, x0 + e
                    if 0 <= z < depth and 0 <= y < ny and 0 <= x < nx:
                        total += wz[a] * wy[b] * wx[e] * source[z, y, x]
            out[k, j, i] = total
    return out
