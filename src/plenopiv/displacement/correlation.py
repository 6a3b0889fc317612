"""Cross-correlation of interrogation windows by Fourier transforms, and its normalisation by their overlap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.butterflies import LANES
from plenopiv.displacement.transforms import (
    POINT,
    fast_length,
    forward,
    inverse,
    inverse_near_zero,
    lines,
    rounded_up,
)
from plenopiv.kernels import kernel

EVERYWHERE = np.ones((1, 1, 1, 1), np.float32)


class Windows(NamedTuple):
    """A batch of windows as they lie in memory: ``values`` float32 (flat), the place in it where each begins (batch,),
    and the steps from plane to plane and from row to row."""

    values: NDArray[np.float32]
    begin: NDArray[np.int64]
    plane: int
    row: int

    @classmethod
    def cut(cls, planes: NDArray[np.float32], corners: NDArray[np.int64]) -> Windows:
        """Windows of ``planes`` (nz, ny, nx) whose first rows and columns are ``corners`` (batch, 2)."""
        _, ny, nx = planes.shape
        return cls(planes.reshape(-1), corners @ np.array([nx, 1]), ny * nx, nx)

    @classmethod
    def of(cls, windows: NDArray[np.float32]) -> Windows:
        """Windows that stand one after the other, (batch, nz, ny, nx)."""
        count, nz, ny, nx = windows.shape
        return cls(windows.reshape(-1), np.arange(count) * (nz * ny * nx), ny * nx, nx)


@dataclass(frozen=True)
class Spectra:
    """Transforms of a batch of windows a + i b, each window weighted and of zero mean (batch, floats; ``transforms``).

    ``gain``: what the correlation is multiplied by for the overlap of the weights, 1/C(d): (batch or 1, 2 rz + 3, ...).
    ``lit`` (batch,): whether both windows hold more than one value; rounding of flat ones is no match.
    """

    pairs: NDArray[np.float32]
    gain: NDArray[np.float32]
    lit: NDArray[np.bool_]


class WindowCorrelator:
    """Correlates pairs of windows of one size.

    For windows a and b with weights w, (a - mean) w and (b - mean) w of zero sum, the correlation is

        R(d) = sum_x a(x) b(x + d),    normalised R(d) / prod_axes C(d),    C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2,

    the first sum taken circularly, by Fourier transforms. Only the share C(d) of the pairs of each axis holds the same
    particles (1 - |d|/n for w = 1), the rest wraps around onto strangers whose mean contribution is zero; without
    division every peak is pulled toward zero, by 0.07 voxel for windows of 32^3. The division raises chance peaks far
    out as well, so a peak is looked for without it and then placed with it (``find_peaks``).

    w is one inside and fades as sin^2 over the outermost ``taper`` voxels: particles that the border cuts would put the
    same edge in both windows and pull the peak toward zero, the more the wider they are. Where deformation reaches
    beyond the volume, one of the two windows ends early; such windows are cut for both and fade from there (``cuts``).

    ``size``: window (nz, ny, nx). ``search``: largest displacement (z, y, x) looked for, voxels. ``variance``: of a
    Gaussian that smooths both windows (voxel^2); as a factor of the cross spectrum S it costs nothing. ``whitening``:
    S is divided by |S|^whitening. 0 is plain correlation, 1 keeps phases alone; between them (symmetric phase-only
    filtering, Wernet 2005) particle images blurred in depth make narrow peaks, which chance overlaps move less.
    """

    def __init__(
        self,
        size: tuple[int, int, int],
        search: tuple[int, int, int],
        variance: float = 0.0,
        whitening: float = 0.0,
        taper: float = 0.0,
    ) -> None:
        self.size, self.whitening, self.taper = size, whitening, taper
        self.around = tuple(fast_length(n) for n in size)  # what the sums wrap around: the window, or a little more
        self._plans = tuple(lines(n) for n in self.around)
        self._high, self._wide = (rounded_up(n) for n in self.around[1:])
        waves = [2 * np.pi * np.fft.fftfreq(n) for n in self.around]
        self._filters = tuple(np.exp(-variance * k**2).astype(np.float32) for k in waves)
        self._shifts = [np.arange(-r - 1, r + 2) for r in search]
        self._radius = search
        turn = waves[0][: self.around[0] // 2 + 1] * self._shifts[0][:, None]
        self._turns = np.stack([np.cos(turn), -np.sin(turn)], -1) * _times_seen(self.around[0])[:, None]
        self._turns = (self._turns / np.prod(self.around)).astype(np.float32)
        self._whole = self._fades_and_gain(np.zeros((3, 2)))

    def spectra(
        self,
        a: Windows,
        b: Windows,
        cuts: NDArray[np.float64] | None = None,
        trust: NDArray[np.float32] | None = None,
    ) -> Spectra:
        """Transforms of the windows ``a``, ``b``.

        ``cuts`` (batch, 3, 2): voxels by which each window is shorter at the low and the high end along z, y, x.
        ``trust`` (batch, nz, ny, nx): a further factor of w. C does not count it, as it goes with the particles, not
        with the window.
        """
        each = [self._whole]
        if cuts is not None and cuts.any():
            each = [self._fades_and_gain(c) if c.any() else self._whole for c in cuts]
        z, y, x, gain = (np.stack(v) for v in zip(*each, strict=True))
        count = a.begin.size
        pairs, lit = (
            np.empty((count, 2 * self.around[0] * self.around[2] * self._high), np.float32),
            np.empty(count, bool),
        )
        room = self._plans, self._wide, self._high
        transform_windows(a, b, z, y, x, EVERYWHERE if trust is None else trust, *room, pairs, lit)
        return Spectra(pairs, gain, lit)

    def correlation(self, spectra: Spectra) -> NDArray[np.float32]:
        """R, not normalised, at displacements up to search + 1: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3)."""
        out = np.empty((len(spectra.pairs), *(d.size for d in self._shifts)), np.float32)
        about = self._plans, self._high, self._filters, np.float32(self.whitening)
        correlate(spectra.pairs, *about, self._radius, self._turns, out)
        return out

    def _fades_and_gain(self, cuts: NDArray[np.float64]) -> tuple[NDArray[np.float32], ...]:
        """The factors of w along z, y and x of a window shorter by ``cuts`` (3, 2), and 1 / prod C (2 rz + 3, ...)."""
        fades = [fade(n, self.taper, *cut) for n, cut in zip(self.size, cuts, strict=True)]
        z, y, x = (
            np.correlate(w, w, "full")[w.size - 1 + d] / (w @ w) for w, d in zip(fades, self._shifts, strict=True)
        )
        shared = z[:, None, None] * y[:, None] * x
        return *(f.astype(np.float32) for f in fades), (1 / shared).astype(np.float32)


def fade(n: int, taper: float, low: float = 0.0, high: float = 0.0) -> NDArray[np.float64]:
    """One inside, sin^2 over the outermost ``taper`` voxels of ``n``, zero over the first ``low`` and last ``high``."""
    centre = np.arange(n) + 0.5
    edge = np.minimum(centre - low, n - high - centre)
    return np.sin(np.pi / 2 * np.clip(edge / taper, 0.0, 1.0)) ** 2 if taper > 0 else (edge > 0).astype(float)


def _times_seen(n: int) -> NDArray[np.float64]:
    """For each wave number 0 to n // 2 along an axis: 2 if it also stands for its negative, else 1."""
    k = np.arange(n // 2 + 1)
    return np.where((k == 0) | (2 * k == n), 1.0, 2.0)


@kernel(nogil=True)
def weigh(windows, n, z, y, x, trust, space, to, plane, wide):
    """(window - mean) w of window n into ``space`` from ``to`` on, in planes of ``plane`` and rows of ``wide`` floats;
    whether it holds more than one value."""
    nx, everywhere = x.size, trust.size == 1
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
                    s += x[i] * trust[k, j, i] * line[i]
                    w += x[i] * trust[k, j, i]
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
                    out[i] = (line[i] - mean) * w * x[i] * trust[k, j, i]
    return others > 0


@kernel(nogil=True)
def transform_windows(a, b, z, y, x, trust, plans, wide, high, pairs, lit):
    """Spectra of a + i b, ``Windows`` weighted by ``z``, ``y``, ``x`` (batch or 1, n) and ``trust``."""
    plane = high * wide
    whole, columns = plans[0].points * plane, max(wide, max(plans[0].points, plans[1].points))
    space, rows = np.zeros(2 * whole, np.float32), np.zeros(2 * plane, np.float32)
    work = np.zeros(3 * POINT * columns, np.float32)
    for n in range(a.begin.size):
        own, marked = min(n, z.shape[0] - 1), min(n, trust.shape[0] - 1)
        if n > 0 and plans[0].points * plans[1].points * wide > z.shape[1] * y.shape[1] * x.shape[1]:
            space[:] = np.float32(0)
        one = weigh(a, n, z[own], y[own], x[own], trust[marked], space, 0, plane, wide)
        two = weigh(b, n, z[own], y[own], x[own], trust[marked], space, whole, plane, wide)
        lit[n] = one and two
        forward(plans, wide, high, space, rows, pairs[n], work)


@kernel(nogil=True)
def cross_spectrum(pair, plans, high, half, strength):
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


@kernel(nogil=True)
def whiten(strength, mean, filters, whitening, ny, high):
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


@kernel(nogil=True)
def correlate(pairs, plans, high, filters, whitening, radius, turns, out):
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


@kernel(nogil=True)
def as_correlated(pairs, plans, wide, high, filters, whitening, out):
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
