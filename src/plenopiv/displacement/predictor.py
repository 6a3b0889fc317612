"""The displacement between window centres: cubic spline through the vectors, linear beyond the outermost ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded


@dataclass(frozen=True)
class SplineField:
    """Tensor-product natural cubic spline of a displacement field (de Boor 1978, ch. 4 and 9).

    ``coefficients``: (3, nz + 2 pad, ny + 2 pad, nx + 2 pad) float32, dx, dy, dz in voxels. A natural spline has no
    curvature at its last knot, so coefficients continued on a straight line extrapolate it linearly and smoothly.
    ``centres``: the knots along z, y, x (voxel indices, evenly spaced). ``pads``: extra coefficients along each axis.
    """

    coefficients: NDArray[np.float32]
    centres: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
    pads: tuple[int, int, int]

    def taps(self, axis: int, at: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """First coefficient (n,) and four weights (n, 4) of positions ``at`` along ``axis`` (0 = z, 1 = y, 2 = x)."""
        knots, pad = self.centres[axis], self.pads[axis]
        position = (np.asarray(at, float) - knots[0]) / _spacing(knots) + pad
        # pad covers the volume; a position beyond it would keep the spline's last piece
        cell = np.clip(np.floor(position).astype(np.int64), 1, knots.size + 2 * pad - 3)
        return cell - 1, cubic_bspline(position - cell).astype(np.float32)

    def at(self, z: NDArray, y: NDArray, x: NDArray) -> NDArray[np.float64]:
        """Displacement (3, len(z), len(y), len(x)) on the tensor grid of the given positions, in voxels."""
        out = self.coefficients.astype(np.float64)
        for axis, where in enumerate((z, y, x)):
            first, weights = self.taps(axis, where)
            four = np.moveaxis(out, axis + 1, 0)[first[:, None] + np.arange(4)]
            out = np.moveaxis(np.einsum("nt,nt...->n...", weights.astype(np.float64), four), 0, axis + 1)
        return out


def cubic_bspline(t: NDArray) -> NDArray[np.float64]:
    """The four weights (n, 4) of the uniform cubic B-spline at the fractions ``t`` between its middle two knots."""
    t = np.asarray(t, float)
    return np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], -1) / 6


def fit_spline(
    displacement: NDArray[np.float64],
    centres: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    shape: tuple[int, int, int],
) -> SplineField:
    """The spline through ``displacement`` (3, nz, ny, nx) at ``centres``, defined over a volume of ``shape`` voxels."""
    c = np.asarray(displacement, float)
    pads = []
    for axis, (knots, total) in enumerate(zip(centres, shape, strict=True)):
        pad = int(np.ceil(max(knots[0], total - 1 - knots[-1]) / _spacing(knots))) + 2
        c = _padded(_natural(c, axis + 1), axis + 1, pad)
        pads.append(pad)
    return SplineField(np.ascontiguousarray(c, np.float32), centres, tuple(pads))  # type: ignore[arg-type]


def _spacing(knots: NDArray[np.float64]) -> float:
    """Between knots; that of a single one has no end, as its value holds everywhere."""
    return float(knots[1] - knots[0]) if knots.size > 1 else np.inf


def _natural(values: NDArray, axis: int) -> NDArray:
    """B-spline coefficients along one axis: (c[i-1] + 4 c[i] + c[i+1]) / 6 = value, ends equal to their values."""
    n = values.shape[axis]
    if n < 3:
        return values
    moved = np.moveaxis(values, axis, 0)
    bands = np.ones((3, n))
    bands[1] = 4.0
    bands[0, 1] = bands[2, n - 2] = 0.0
    bands[1, 0] = bands[1, n - 1] = 6.0
    solved = solve_banded((1, 1), bands, 6.0 * moved.reshape(n, -1)).reshape(moved.shape)
    return np.moveaxis(solved, 0, axis)


def _padded(values: NDArray, axis: int, pad: int) -> NDArray:
    """``pad`` more values on either side of ``axis``, on the straight line through the outermost two."""
    moved = np.moveaxis(values, axis, 0)
    n = moved.shape[0]
    rise_lo = moved[1] - moved[0] if n > 1 else np.zeros_like(moved[0])
    rise_hi = moved[-1] - moved[-2] if n > 1 else np.zeros_like(moved[0])
    steps = np.arange(1, pad + 1).reshape(-1, *(1,) * (moved.ndim - 1))
    return np.moveaxis(
        np.concatenate([(moved[0] - steps * rise_lo)[::-1], moved, moved[-1] + steps * rise_hi]), 0, axis
    )


def smooth_predictor(displacement: NDArray[np.float64], overlap: float) -> NDArray[np.float64]:
    """``displacement`` (3, nz, ny, nx) without waves of about one window and shorter, which windows do not resolve.

    Iterated deformation adds noise at those wavelengths in every pass; a filter between passes keeps it bounded
    (Schrijer & Scarano 2008). Along each axis 1 - sin^4(k s/2), Shapiro's (1970) second order, at strides s of
    one vector, two, four, ... up to half a window. Linear fields pass unchanged, waves of three windows at 94 % for
    50 % ``overlap``.
    """
    out = np.asarray(displacement, float)
    for stride in _strides(overlap):
        for axis in (1, 2, 3):
            n = out.shape[axis]
            if n > 2 * stride:
                p = np.moveaxis(_odd(out, axis, 2 * stride), axis, 0)
                far, near, middle = ([p[k * stride : k * stride + n] for k in pair] for pair in ((0, 4), (1, 3), (2,)))
                out = np.moveaxis((10 * middle[0] + 4 * (near[0] + near[1]) - far[0] - far[1]) / 16, 0, axis)
    return out


def _strides(overlap: float) -> list[int]:
    """Strides of the filter: one vector, two, four, ... up to half a window."""
    strides = [1]
    while 2 * strides[-1] * (1 - overlap) <= 0.5 + 1e-9:
        strides.append(2 * strides[-1])
    return strides


def filter_response(turn: NDArray[np.float64] | float, overlap: float) -> NDArray[np.float64]:
    """What ``smooth_predictor`` leaves of waves along one axis that turn by ``turn`` radians a vector."""
    waves = np.asarray(turn, float)
    return np.prod([1 - np.sin(stride * waves / 2) ** 4 for stride in _strides(overlap)], axis=0)


def spline_aliases(turn: NDArray[np.float64] | float, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Waves (..., 2 ``count`` + 1), in radians a vector, and amplitudes of the spline through vectors of a wave of
    ``turn`` (...) radians a vector: that wave in the middle, and its aliases."""
    waves = np.asarray(turn, float)[..., None] + 2 * np.pi * np.arange(-count, count + 1)
    amplitude = np.sinc(waves / (2 * np.pi)) ** 4
    return waves, amplitude / amplitude.sum(-1, keepdims=True)


def _odd(values: NDArray, axis: int, width: int) -> NDArray:
    """``width`` more values on either side, point-reflected about the outermost ones, which so keep their value."""
    widths = [(width, width) if k == axis else (0, 0) for k in range(values.ndim)]
    return np.pad(values, widths, mode="reflect", reflect_type="odd")
