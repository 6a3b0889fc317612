"""Cross-correlation of interrogation windows by Fourier transforms, and its normalisation by their overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.overlap import fade, overlaps, powers
from plenopiv.displacement.spectra import correlate, transform_windows
from plenopiv.displacement.transforms import fast_length, lines, rounded_up
from plenopiv.displacement.windows import WindowBatch

Gain = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
ONES = np.ones((1, 1, 1, 1), np.float32)


@dataclass(frozen=True)
class Spectra:
    """Transforms of a batch of windows a + i b, each window weighted and of zero mean (batch, floats; ``transforms``).

    ``gain``: 1/C(d) along z, y, x, (batch or 1, 2 r + 3) each: powers of it correct the correlation for the overlap of
    the weights.
    ``lit`` (batch,): whether both windows hold more than one value; of uniform windows only rounding would correlate.
    """

    pairs: NDArray[np.float32]
    gain: Gain
    lit: NDArray[np.bool_]


class WindowCorrelator:
    """Correlates pairs of windows of one size.

    For windows a and b with weights w, (a - mean) w and (b - mean) w of zero sum, the correlation is

        R(d) = sum_x a(x) b(x + d),    normalised R(d) / prod_axes C(d),    C(d) = sum_x w(x) w(x + d) / sum_x w(x)^2,

    the first sum taken circularly, by Fourier transforms. Of the pairs of voxels along each axis only the fraction C(d)
    overlaps (1 - |d|/n for w = 1); the others wrap around to unrelated particles, whose mean contribution is zero.
    Without the division all peaks are biased toward zero, by 0.07 voxel for windows of 32^3. After whitening and
    smoothing it is a power of C that corrects them (``overlap``). The division also raises chance peaks at large d. So
    the highest peak is searched without it, and its position fitted with it (``find_peaks``).

    w is one inside and falls to zero as sin^2 over the outermost ``taper`` voxels. Without the taper, particles cut by
    the border put the same edge in both windows and bias the peak toward zero, the more the wider they are. Where
    deformation reaches beyond the volume, one of the two windows ends early; w of both then ends there (``cuts``).

    ``size``: window (nz, ny, nx). ``search``: largest displacement (z, y, x) that is searched, voxels. ``variance``:
    along z, y, x, of a Gaussian that smooths both windows (voxel^2), a factor of the cross spectrum S. ``whitening``: S
    is divided by |S|^whitening. 0 is plain correlation, 1 keeps the phase alone; between them (symmetric phase-only
    filtering, Wernet 2005) particle images that are long in depth give narrow peaks, which chance overlaps shift less.

    ``around``: period of the transforms; ``filters``: the Gaussian's factors, both along z, y, x; ``powers`` (3,
    knots): of the gain along x, y, z (``overlap.powers``).
    """

    def __init__(
        self,
        size: tuple[int, int, int],
        search: tuple[int, int, int],
        variance: Sequence[float] = (0.0, 0.0, 0.0),
        whitening: float = 0.0,
        taper: float = 0.0,
    ) -> None:
        self.size, self.whitening, self.taper = size, whitening, taper
        self.around = tuple(fast_length(n) for n in size)  # period of the circular sums: the window, or a little more
        self._plans = tuple(lines(n) for n in self.around)
        self._high, self._wide = (rounded_up(n) for n in self.around[1:])
        waves = [2 * np.pi * np.fft.fftfreq(n) for n in self.around]
        self.filters = tuple(np.exp(-v * k**2).astype(np.float32) for v, k in zip(variance, waves, strict=True))
        about = zip(size[::-1], self.around[::-1], variance[::-1], strict=True)
        self.powers = np.stack([powers(n, around, taper, v, whitening) for n, around, v in about])
        self._shifts = [np.arange(-r - 1, r + 2) for r in search]
        self._radius = search
        turn = waves[0][: self.around[0] // 2 + 1] * self._shifts[0][:, None]
        self._turns = np.stack([np.cos(turn), -np.sin(turn)], -1) * _times_seen(self.around[0])[:, None]
        self._turns = (self._turns / np.prod(self.around)).astype(np.float32)
        self._whole = self._of_cut(np.zeros((1, 3, 2)))

    def spectra(
        self,
        a: WindowBatch,
        b: WindowBatch,
        cuts: NDArray[np.float64] | None = None,
        agreement: NDArray[np.float32] | None = None,
        depth: NDArray[np.float32] | None = None,
    ) -> Spectra:
        """Transforms of the windows ``a``, ``b``.

        ``cuts`` (batch, 3, 2): voxels by which each window is shorter at the low and the high end along z, y, x.
        ``agreement`` (batch, nz, ny, nx): a further factor of w (``displacement.agreement``). It moves with the
        particles, not with the window, so C leaves it out. ``depth`` (batch, nz): another one, along z
        (``depth_weights``); C with it multiplies the noise of displacements near focus by 1.5.
        """
        ((z, y, x), gain), count = self._fades_and_gain(cuts), a.begin.size
        z = z if depth is None else z * depth
        if len({len(z), len(y), len(x)}) > 1:
            z, y, x = (v if len(v) == count else np.repeat(v, count, 0) for v in (z, y, x))
        pairs, lit = (
            np.empty((count, 2 * self.around[0] * self.around[2] * self._high), np.float32),
            np.empty(count, bool),
        )
        plans = self._plans, self._wide, self._high
        transform_windows(a, b, z, y, x, ONES if agreement is None else agreement, *plans, pairs, lit)
        return Spectra(pairs, gain, lit)

    def correlation(self, spectra: Spectra) -> NDArray[np.float32]:
        """R, not normalised, at displacements up to search + 1: (batch, 2 rz + 3, 2 ry + 3, 2 rx + 3)."""
        out = np.empty((len(spectra.pairs), *(d.size for d in self._shifts)), np.float32)
        about = self._plans, self._high, self.filters, np.float32(self.whitening)
        correlate(spectra.pairs, *about, self._radius, self._turns, out)
        return out

    def gain(self, cuts: NDArray[np.float64] | None) -> Gain:
        """``Spectra.gain`` of windows with these ``cuts``."""
        return self._fades_and_gain(cuts)[1]

    def _fades_and_gain(self, cuts: NDArray[np.float64] | None) -> tuple[Gain, Gain]:
        """The factors of w along z, y and x, (batch, n) each, and the gain; of one window where none is cut."""
        return self._whole if cuts is None or not cuts.any() else self._of_cut(cuts)

    def _of_cut(self, cuts: NDArray[np.float64]) -> tuple[Gain, Gain]:
        """``_fades_and_gain`` of each window, made anew."""
        z, y, x = (
            fade(n, self.taper, of_axis[:, :1], of_axis[:, 1:]).astype(np.float32)
            for n, of_axis in zip(self.size, np.moveaxis(cuts, 1, 0), strict=True)
        )
        of_z, of_y, of_x = (
            (1 / overlaps(each, shifts)).astype(np.float32)
            for each, shifts in zip((z, y, x), self._shifts, strict=True)
        )
        return (z, y, x), (of_z, of_y, of_x)


def _times_seen(n: int) -> NDArray[np.float64]:
    """For each wave number 0 to n // 2 along an axis: 2 if it also stands for its negative, else 1."""
    k = np.arange(n // 2 + 1)
    return np.where((k == 0) | (2 * k == n), 1.0, 2.0)
