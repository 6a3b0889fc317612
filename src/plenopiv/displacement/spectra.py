"""Kernels between windows and their correlation: weight, transform, whiten, transform back (``correlation``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.butterflies import LANES
from plenopiv.displacement.transforms import POINT, Lines, forward, inverse, inverse_near_zero
from plenopiv.displacement.windows import WindowBatch
from plenopiv.kernels import kernel, part


@part
def weigh(
    windows: WindowBatch,
    n: int,
    z: NDArray[np.float32],
    y: NDArray[np.float32],
    x: NDArray[np.float32],
    agreement: NDArray[np.float32],
    space: NDArray[np.float32],
    to: int,
    plane: int,
    wide: int,
) -> bool:
    """Write (window - mean) w of window n to ``space`` from ``to`` on, in planes of ``plane`` and rows of ``wide``
    floats. Returns whether the window holds more than one value."""
    nx, everywhere = x.size, agreement.size == 1
    light = weight = 0.0
    first, others = windows.values[windows.begin[n]], 0
    for k in range(z.size):
        for j in range(y.size):
            at = windows.begin[n] + k * windows.plane + j * windows.row
            line, s, w = windows.values[at : at + nx], np.float32(0), np.float32(0)
            if everywhere:
                for i in range(nx):
                    s += x[i] * line[i]
                    w += x[i]
            else:
                for i in range(nx):
                    s += x[i] * agreement[k, j, i] * line[i]
                    w += x[i] * agreement[k, j, i]
            for i in range(nx):
                others += line[i] != first
            light += z[k] * y[j] * s
            weight += z[k] * y[j] * w
    mean = np.float32(light / (weight + 1e-30))
    for k in range(z.size):
        for j in range(y.size):
            at = windows.begin[n] + k * windows.plane + j * windows.row
            line, out, w = windows.values[at : at + nx], space[to + k * plane + j * wide :], z[k] * y[j]
            if everywhere:
                for i in range(nx):
                    out[i] = (line[i] - mean) * w * x[i]
            else:
                for i in range(nx):
                    out[i] = (line[i] - mean) * w * x[i] * agreement[k, j, i]
    return others > 0


@kernel
def transform_windows(
    a: WindowBatch,
    b: WindowBatch,
    z: NDArray[np.float32],
    y: NDArray[np.float32],
    x: NDArray[np.float32],
    agreement: NDArray[np.float32],
    plans: tuple[Lines, Lines, Lines],
    wide: int,
    high: int,
    pairs: NDArray[np.float32],
    lit: NDArray[np.bool_],
) -> None:
    """Spectra of a + i b, both windows weighted by ``z``, ``y``, ``x`` (batch or 1, n) and
    ``agreement`` (batch, nz, ny, nx), or one 1 for all."""
    plane = high * wide
    whole, columns = plans[0].points * plane, max(wide, max(plans[0].points, plans[1].points))
    space, rows = np.zeros(2 * whole, np.float32), np.zeros(2 * plane, np.float32)
    work = np.zeros(3 * POINT * columns, np.float32)
    for n in range(a.begin.size):
        own, marked = min(n, z.shape[0] - 1), min(n, agreement.shape[0] - 1)
        if n > 0 and plans[0].points * plans[1].points * wide > z.shape[1] * y.shape[1] * x.shape[1]:
            space[:] = np.float32(0)
        one = weigh(a, n, z[own], y[own], x[own], agreement[marked], space, np.int64(0), plane, wide)
        two = weigh(b, n, z[own], y[own], x[own], agreement[marked], space, whole, plane, wide)
        lit[n] = one and two
        forward(plans, wide, high, space, rows, pairs[n], work)


@part
def cross_spectrum(
    pair: NDArray[np.float32],
    plans: tuple[Lines, Lines, Lines],
    high: int,
    half: NDArray[np.float32],
    strength: NDArray[np.float32],
) -> np.float32:
    """S = conj(A) B of the transform of a + i b for the planes kz = 0 to nz // 2, and |S|, of which the mean over the
    whole spectrum is returned. A is the even part of the transform, i B the odd one:
    2 A(k) = Z(k) + conj Z(-k), 2 i B(k) = Z(k) - conj Z(-k)."""
    nz, ny, nx = plans[0].points, plans[1].points, plans[2].points
    flat, planes = nz * nx * high, nz // 2 + 1
    apart, quarter = planes * nx * high, np.float32(0.25)
    total = 0.0
    u, v = np.empty(ny, np.float32), np.empty(ny, np.float32)
    for kz in range(planes):
        plane_sum = 0.0
        for kx in range(nx):
            at, mirrored = (kz * nx + kx) * high, (((nz - kz) % nz) * nx + (nx - kx) % nx) * high
            u[0], v[0] = pair[mirrored], pair[flat + mirrored]
            for ky in range(1, ny):
                u[ky], v[ky] = pair[mirrored + ny - ky], pair[flat + mirrored + ny - ky]
            real, imag, modulus = half[at : at + ny], half[apart + at : apart + at + ny], strength[at : at + ny]
            p, q, row_sum = pair[at : at + ny], pair[flat + at : flat + at + ny], np.float32(0)
            for ky in range(ny):
                ar, ai, br, bi = p[ky] + u[ky], q[ky] - v[ky], q[ky] + v[ky], u[ky] - p[ky]
                sr, si = quarter * (ar * br + ai * bi), quarter * (ar * bi - ai * br)
                real[ky], imag[ky] = sr, si
                modulus[ky] = np.sqrt(sr * sr + si * si)
                row_sum += modulus[ky]
            plane_sum += float(row_sum)
        total += plane_sum if kz == 0 or 2 * kz == nz else 2 * plane_sum
    return np.float32(total / (nz * ny * nx))


@part
def whiten(
    strength: NDArray[np.float32],
    mean: np.float32,
    filters: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    whitening: np.float32,
    ny: int,
    high: int,
) -> None:
    """|S|^-whitening times the filter, in place of |S|."""
    of_z, of_y, of_x = filters
    nx = of_x.size
    # a floor far below the mean: what is mere rounding must not be raised to full strength
    floor, one = np.float32(1e-3) * mean + np.float32(1e-30), np.float32(1)
    for line in range(strength.size // high):
        f, row = of_z[line // nx] * of_x[line % nx], strength[line * high : line * high + ny]
        if whitening == np.float32(0):
            for ky in range(ny):
                row[ky] = f * of_y[ky]
        elif whitening == np.float32(0.5):
            for ky in range(ny):
                row[ky] = f * of_y[ky] * np.sqrt(one / (row[ky] + floor))
        else:
            for ky in range(ny):
                row[ky] = f * of_y[ky] * (row[ky] + floor) ** -whitening


@kernel
def correlate(
    pairs: NDArray[np.float32],
    plans: tuple[Lines, Lines, Lines],
    high: int,
    filters: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    whitening: np.float32,
    radius: tuple[int, int, int],
    turns: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """R near zero displacement of each pair of windows of a batch."""
    along_z, along_y, along_x = plans
    planes, nx, wide = along_z.points // 2 + 1, along_x.points, (out.shape[3] + LANES - 1) // LANES * LANES
    half = np.zeros(2 * planes * nx * high, np.float32)
    factor = np.zeros(planes * nx * high, np.float32)
    rows, near = np.zeros(2 * high * wide, np.float32), np.empty(2 * planes * out.shape[2] * wide, np.float32)
    work = np.zeros(3 * POINT * max(LANES, max(nx, max(along_y.points, along_z.points))), np.float32)
    for n in range(pairs.shape[0]):
        mean = cross_spectrum(pairs[n], plans, high, half, factor)
        whiten(factor, mean, filters, whitening, along_y.points, high)
        for i in range(factor.size):
            half[i] *= factor[i]
        other = half[factor.size :]
        for i in range(factor.size):
            other[i] *= factor[i]
        inverse_near_zero(plans, high, half, radius, turns, rows, near, out[n], work)


@kernel
def as_correlated(
    pairs: NDArray[np.float32],
    plans: tuple[Lines, Lines, Lines],
    wide: int,
    high: int,
    filters: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    whitening: np.float32,
    out: NDArray[np.float32],
) -> None:
    """The windows a and b that the correlation multiplies, (batch, 2, nz ny' nx'): each takes the square root of the
    factor that whitening and smoothing put on the cross spectrum."""
    along_z, along_y, along_x = plans
    nz, ny, nx = along_z.points, along_y.points, along_x.points
    planes, flat, plane = nz // 2 + 1, nz * nx * high, high * wide
    half, factor = np.empty(2 * planes * nx * high, np.float32), np.zeros(planes * nx * high, np.float32)
    spectrum, rows = np.zeros(2 * flat, np.float32), np.zeros(2 * plane, np.float32)
    work = np.zeros(3 * POINT * max(wide, max(ny, nz)), np.float32)
    scale = np.float32(1.0 / (nz * ny * nx))
    for n in range(pairs.shape[0]):
        pair = pairs[n]
        mean = cross_spectrum(pair, plans, high, half, factor)
        whiten(factor, mean, filters, whitening, ny, high)
        for i in range(factor.size):
            factor[i] = scale * np.sqrt(factor[i])
        for kz in range(nz):
            for kx in range(nx):
                at = (kz * nx + kx) * high
                if kz < planes:
                    for ky in range(ny):
                        spectrum[at + ky] = factor[at + ky] * pair[at + ky]
                        spectrum[flat + at + ky] = factor[at + ky] * pair[flat + at + ky]
                else:
                    mirrored = ((nz - kz) * nx + (nx - kx) % nx) * high
                    for ky in range(ny):
                        f = factor[mirrored + (ny - ky if ky else 0)]
                        spectrum[at + ky] = f * pair[at + ky]
                        spectrum[flat + at + ky] = f * pair[flat + at + ky]
        inverse(plans, wide, high, spectrum, rows, out[n], work)
