"""FFT cross-correlation of interrogation windows, and its normalisation by their overlap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft


@dataclass(frozen=True)
class Spectra:
    """Transforms of a batch of windows a and b, (batch, nz, ny, nx / 2 + 1), each window weighted and of zero mean.

    ``gain``: what the correlation is multiplied by for the overlap of the weights, 1/C(d): (batch or 1, 2 rz + 3, ...).
    """

    first: NDArray[np.complex64]
    second: NDArray[np.complex64]
    gain: NDArray[np.float32]


class WindowCorrelator:
    """Correlates pairs of windows of one size.

    For windows a and b with weights w, (a - mean) w and (b - mean) w of zero sum, the correlation is

        R(d) = sum_x a(x) b(x + d),    normalised R(d) / prod_axes C(d),    C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2,

    the first sum taken circularly by FFT. Only the share C(d) of the pairs of each axis holds the same particles
    (1 - |d|/n for w = 1), the rest wraps around onto strangers whose mean contribution is zero; without division
    every peak is pulled toward zero, by 0.07 voxel for windows of 32^3. The division raises chance peaks far out
    as well, so a peak is looked for without it and then placed with it (``find_peaks``).

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
        kz, ky, kx = (
            2 * np.pi * f for f in (np.fft.fftfreq(size[0]), np.fft.fftfreq(size[1]), np.fft.rfftfreq(size[2]))
        )
        square = kz[:, None, None] ** 2 + ky[:, None] ** 2 + kx**2
        self._filter = np.exp(-variance * square).astype(np.float32)
        self._shifts = [np.arange(-r - 1, r + 2) for r in search]
        self._index = np.ix_(*(d % n for d, n in zip(self._shifts, size, strict=True)))
        self._whole = self._weight_and_gain(np.zeros((3, 2)))

    def spectra(
        self,
        a: NDArray[np.float32],
        b: NDArray[np.float32],
        cuts: NDArray[np.float64] | None = None,
        trust: NDArray[np.float32] | None = None,
    ) -> Spectra:
        """Transforms of the windows ``a``, ``b`` (batch, nz, ny, nx).

        ``cuts`` (batch, 3, 2): voxels by which each window is shorter at the low and the high end along z, y, x.
        ``trust`` (batch, nz, ny, nx): a further factor of w. C does not count it, as it goes with the particles, not
        with the window.
        """
        if cuts is None or not cuts.any():
            weight, gain = (v[None] for v in self._whole)
        else:
            each = [self._weight_and_gain(c) if c.any() else self._whole for c in cuts]
            weight, gain = (np.stack(v) for v in zip(*each, strict=True))
        if trust is not None:
            weight = weight * trust
        axes = (1, 2, 3)
        share = weight / (weight.sum(axes, keepdims=True) + np.float32(1e-30))
        first, second = (
            fft.rfftn((w - np.sum(w * share, axes, keepdims=True)) * weight, axes=axes, workers=1) for w in (a, b)
        )
        return Spectra(first, second, gain)

    def correlation(self, spectra: Spectra) -> NDArray[np.float32]:
        """R, not normalised, at displacements up to search + 1: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3)."""
        cross = np.conjugate(spectra.first)
        cross *= spectra.second
        if self.whitening:
            cross *= self._whitened(np.abs(cross))
        cross *= self._filter
        circular = fft.irfftn(cross, self.size, axes=(1, 2, 3), workers=1, overwrite_x=True)
        return circular[:, *self._index]

    def _whitened(self, strength: NDArray[np.float32]) -> NDArray[np.float32]:
        """|S|^-whitening for the moduli |S| of a batch of cross spectra; ``strength`` is overwritten."""
        # a floor far below the mean: what is mere rounding must not be raised to full strength
        strength += np.float32(1e-3) * strength.mean((1, 2, 3), keepdims=True) + np.float32(1e-30)
        return np.sqrt(1 / strength) if self.whitening == 0.5 else strength ** np.float32(-self.whitening)

    def _weight_and_gain(self, cuts: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """w (nz, ny, nx) of a window shorter by ``cuts`` (3, 2), and 1 / prod C (2 rz + 3, 2 ry + 3, 2 rx + 3)."""
        fades = [fade(n, self.taper, *cut) for n, cut in zip(self.size, cuts, strict=True)]
        shared = [
            np.correlate(w, w, "full")[w.size - 1 + d] / (w @ w) for w, d in zip(fades, self._shifts, strict=True)
        ]
        return _outer(fades), np.float32(1) / _outer(shared)


def fade(n: int, taper: float, low: float = 0.0, high: float = 0.0) -> NDArray[np.float64]:
    """One inside, sin^2 over the outermost ``taper`` voxels of ``n``, zero over the first ``low`` and last ``high``."""
    centre = np.arange(n) + 0.5
    edge = np.minimum(centre - low, n - high - centre)
    return np.sin(np.pi / 2 * np.clip(edge / taper, 0.0, 1.0)) ** 2 if taper > 0 else (edge > 0).astype(float)


def _outer(axes: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Product of three one-dimensional factors along z, y, x."""
    z, y, x = axes
    return (z[:, None, None] * y[:, None] * x).astype(np.float32)
