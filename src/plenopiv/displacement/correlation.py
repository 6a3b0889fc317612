"""FFT cross-correlation of interrogation windows, normalised by their overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft


class WindowCorrelator:
    """Correlates pairs of windows of one size.

    For windows a and b (zero mean, multiplied by w) the result is

        R(d) = sum_x a(x) b(x + d) / prod_axes C(d),    C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2,

    the first sum taken circularly by FFT. Only the share C(d) of the pairs of each axis holds the same particles
    (1 - |d|/n for w = 1), the rest wraps around onto strangers whose mean contribution is zero; without the division
    every peak is pulled toward zero, by 0.07 voxel for windows of 32^3.

    w is one inside and fades as sin^2 over the outermost ``taper`` voxels: particles that the border cuts would put the
    same edge in both windows and pull the peak toward zero, the more the wider they are.

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
        self.size, self.whitening = size, whitening
        kz, ky, kx = (
            2 * np.pi * f for f in (np.fft.fftfreq(size[0]), np.fft.fftfreq(size[1]), np.fft.rfftfreq(size[2]))
        )
        square = kz[:, None, None] ** 2 + ky[:, None] ** 2 + kx**2
        self._filter = np.exp(-variance * square).astype(np.float32)
        fades = [fade(n, taper) for n in size]
        self._weight = _outer(fades)
        shifts = [np.arange(-r - 1, r + 2) for r in search]
        self._index = np.ix_(*(d % n for d, n in zip(shifts, size, strict=True)))
        shared = [np.correlate(w, w, "full")[w.size - 1 + d] / (w @ w) for w, d in zip(fades, shifts, strict=True)]
        self._gain = 1 / _outer(shared)

    def __call__(self, a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
        """R for windows ``a``, ``b`` (batch, nz, ny, nx) at displacements up to search + 1: (batch, 2 rz + 3, ...)."""
        axes = (1, 2, 3)
        spectrum = fft.rfftn(self._faded(a), axes=axes, workers=1)
        np.conjugate(spectrum, out=spectrum)
        spectrum *= fft.rfftn(self._faded(b), axes=axes, workers=1)
        if self.whitening:
            strength = np.abs(spectrum)
            # a floor far below the mean: what is mere rounding must not be raised to full strength
            strength += np.float32(1e-3) * strength.mean(axes, keepdims=True) + np.float32(1e-30)
            spectrum *= np.sqrt(1 / strength) if self.whitening == 0.5 else strength ** np.float32(-self.whitening)
        spectrum *= self._filter
        circular = fft.irfftn(spectrum, self.size, axes=axes, workers=1, overwrite_x=True)
        return circular[:, *self._index] * self._gain

    def _faded(self, windows: NDArray[np.float32]) -> NDArray[np.float32]:
        return (windows - windows.mean((1, 2, 3), keepdims=True)) * self._weight


def fade(n: int, taper: float) -> NDArray[np.float64]:
    """One inside, sin^2 over the outermost ``taper`` voxels of ``n``, symmetric."""
    edge = np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n))
    return np.sin(np.pi / 2 * np.minimum(edge / taper, 1.0)) ** 2 if taper > 0 else np.ones(n)


def _outer(axes: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Product of three one-dimensional factors along z, y, x."""
    z, y, x = axes
    return (z[:, None, None] * y[:, None] * x).astype(np.float32)
