"""Standard deviation of every vector, from the scatter of its own particles and from the neighbouring vectors.

It has three parts. Only the threshold of the third, and its share with sub-windows, were chosen by coverage; coverage
as measured is in docs/uncertainty.md.

1. *Scatter.* The sum that makes a correlation peak is split into the contributions of blocks of the window. Each
   block is left out in turn and the peak fitted anew; the delete-one jackknife (Efron & Stein 1981) of those
   displacements is the variance s^2 of one correlation. It holds whatever makes particles disagree: noise, ghosts,
   particles seen once, gradients that deformation has left. Wieneke (2015, Meas. Sci. Technol. 26 074002) takes the
   same contributions a(x) b(x + 1) - a(x + 1) b(x) with a model of their covariance instead. Of a dozen particles the
   delete-one variance is on average 1.1 to 1.4 times too large, which suits a single vector, whose own s^2 scatters.
   For means, with sub-windows, a block therefore counts a thousandth less instead: the infinitesimal jackknife (Jaeckel
   1972; Efron 1982, chapter 6), right on average; and not s^2 but s is averaged over a window, since of a dozen
   particles s^2 scatters widely upward.
2. *Iteration.* Each pass deforms by the vectors of the last one, noise included, and corrects only what a window
   resolves, so noise at short wavelengths is amplified. ``noise_amplification`` computes the factor K of the variance
   (1.63 for three passes). In depth a pass finds less where particles are long, as ``depth_response`` measures: what
   it leaves, the noise of larger windows too, stays, and is alike over several of the finest.
3. *Averaging bias.* Where the flow is curved, its mean over a window differs from the value at the centre by
   q = sum_i n_i^2/24 d''_i, estimated from second differences of the field (``averaging_bias``). Noise alone gives q a
   variance of c K s^2; where q exceeds twice that standard deviation, it counts as flow that the windows do not
   resolve.

    std^2 = K s^2 + (q^2 where q^2 > 4 c K s^2)

With sub-window averaging (``sub_windows``) the noise is that of the mean (``NoiseAmplification.variance_of_mean``), and
a part of the mean q^2 less the mean of its noise, c K s^2, is added. Averaged over a window that difference is
certain enough to need no threshold, above which noise alone would add a fifth to the variance of the mean. The part,
0.30, was chosen by coverage.

Errors common to both frames (light without depth near focus, calibration) are not included.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.displacement.correlation import Gain, Spectra, WindowCorrelator
from plenopiv.displacement.noise_amplification import bias_factor, noise_amplification, strides
from plenopiv.displacement.peaks import gaussian_offset
from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.spectra import as_correlated
from plenopiv.displacement.sub_windows import mean_over, mean_weights, mostly_measured
from plenopiv.displacement.windows import WindowGrid
from plenopiv.kernels import kernel, part

_BLOCKS = 4  # along each axis
_THINNEST = (12, 4, 4)  # along z, y, x, voxels: longer than a particle; fewer blocks where they would be thinner
_NEIGHBOURS = 26  # vectors whose variance a replaced one takes; as many as its value is fitted to
_MEAN_SQUARE_STEPS = 26 / (6 + 12 / 2 + 8 / 3)  # <r^2> of the 26 neighbours weighted by r^-2, in steps^2
_BIAS_OF_MEAN = 0.3  # of the sub-windows' mean q^2 less its noise, in the variance of their mean
_SINGLE, OF_MEANS = 1.0, 1e-3  # by what part less a block counts, in the variance of vectors and for means of them
_SIGNIFICANT = 2.0  # standard deviations of its noise above which q counts as averaging bias


class ScatterCorrelator(WindowCorrelator):
    """A correlator that also estimates the variance of peak positions from the scatter of a window's particles."""

    def variance(
        self,
        spectra: Spectra,
        place: NDArray[np.int64],
        untilt: NDArray[np.float64],
        power: NDArray[np.float64],
        part: float = _SINGLE,
    ) -> NDArray[np.float64]:
        """Jackknife variance (batch, 3), voxel^2, along x, y, z, of the peaks of a batch. ``place``, ``untilt``,
        ``power``: as ``find_peaks`` leaves them; ``part``: of a block that is left out (``part_left_out``)."""
        return jackknife_variance(self.contributions(spectra, place, power), untilt, part)

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Blocks of a window along z, y, x."""
        return np.array([max(1, min(_BLOCKS, n // thin)) for n, thin in zip(self.size, _THINNEST, strict=True)])

    def contributions(
        self, spectra: Spectra, place: NDArray[np.int64], power: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """``block_sums`` (batch, blocks, 7) of the blocks of a batch, corrected for overlap."""
        pairs, blocks = self.filtered(spectra), self.blocks
        sums = np.zeros((len(pairs), int(blocks.prod()), 7))
        block_sums(pairs, self.around, place, blocks, sums)
        return sums * gain_around(spectra.gain, place, power)[:, None]

    def filtered(self, spectra: Spectra) -> NDArray[np.float32]:
        """Both windows after whitening and smoothing, (batch, 2, nz, ny, nx), so that R(d) is their plain circular sum
        of products. ny and nx are rounded up to whole vectors.

        Each is multiplied by the square root of the factor that whitening and smoothing put on the cross spectrum.
        """
        out = np.empty((len(spectra.pairs), 2, self.around[0], self._high, self._wide), np.float32)
        about = self._plans, self._wide, self._high, self.filters, np.float32(self.whitening)
        as_correlated(spectra.pairs, *about, out.reshape(len(out), -1))
        return out


def around_peaks(values: NDArray[np.float32], place: NDArray[np.int64]) -> NDArray[np.float32]:
    """``values`` (batch or 1, nz, ny, nx), of displacements about zero, at the peaks and -x, +x, -y, +y, -z, +z of
    them, (batch, 7). ``place`` (batch, 3) x, y, z: as ``find_peaks`` leaves it."""
    star = np.array([(0, 0, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)])
    middle = np.array(values.shape[1:]) // 2 + place[:, None, ::-1]  # z, y, x
    z, y, x = np.moveaxis(middle + star, -1, 0)  # (batch, 7) each
    window = np.arange(len(place))[:, None] if len(values) > 1 else 0
    return values[window, z, y, x]


def gain_around(gain: Gain, place: NDArray[np.int64], power: NDArray[np.float64]) -> NDArray[np.float64]:
    """The gain at the peaks and their six neighbours, in the order of ``around_peaks``, as ``find_peaks`` applies it,
    raised along x, y, z to ``power`` (batch, 3); over that at the peak itself: (batch, 7)."""
    out = np.ones((len(place), 7))
    for axis, factor in enumerate(gain[::-1]):
        window = np.arange(len(place)) if len(factor) > 1 else 0
        here = factor.shape[1] // 2 + place[:, axis]
        for side, column in ((-1, 1 + 2 * axis), (1, 2 + 2 * axis)):
            out[:, column] = (factor[window, here + side] / factor[window, here].astype(float)) ** power[:, axis]
    return out


@part
def wrapped(window: NDArray[np.float32], shift: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    """``window``, moved by -``shift`` (x, y, z) around its ends, with its first plane, row and column once more."""
    nz, ny, nx = out.shape[0] - 1, out.shape[1] - 1, out.shape[2] - 1
    begin = shift[0] % nx
    for k in range(nz + 1):
        for j in range(ny + 1):
            row = window[(k + shift[2]) % nz, (j + shift[1]) % ny]
            for i in range(nx + 1):
                at = begin + i
                out[k, j, i] = row[at - nx if at >= nx else at]


@kernel
def block_sums(
    pairs: NDArray[np.float32],
    size: tuple[int, int, int],
    place: NDArray[np.int64],
    blocks: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Contribution of each block of a window to the peak and its six neighbours.

    ``pairs``: as ``filtered``, windows of ``size`` (nz, ny, nx) with the peak at ``place`` (batch, 3). Adds to ``out``
    (batch, blocks, 7): sums of a b at 0, -x, +x, -y, +y, -z, +z of the peak. A pair one voxel apart counts where its
    lower voxel is, for either sign: a perfect match then has no asymmetry in any block.
    """
    nz, ny, nx = size
    bz, by, bx = blocks
    a, b = np.empty((nz + 1, ny + 1, nx + 1), np.float32), np.empty((nz + 1, ny + 1, nx + 1), np.float32)
    sums, unmoved = np.zeros((7, nx), np.float32), np.zeros_like(place[:1])
    for w in range(pairs.shape[0]):
        wrapped(pairs[w, 0], unmoved[0], a)
        wrapped(pairs[w, 1], place[w], b)
        for k in range(nz):
            for j in range(ny):
                for n in range(7):
                    one, two = (
                        a[k + (n == 5), j + (n == 3), np.int64(n == 1) :],
                        b[k + (n == 6), j + (n == 4), np.int64(n == 2) :],
                    )
                    row = sums[n]
                    for i in range(nx):
                        row[i] += one[i] * two[i]
                layer = (k * bz // nz * by + j * by // ny) * bx
                if (j + 1) * by // ny > j * by // ny:  # the last row of a block, or of the window
                    for n in range(7):
                        for i in range(nx):
                            out[w, layer + i * bx // nx, n] += sums[n, i]
                            sums[n, i] = np.float32(0)


def part_left_out(settings: CorrelationSettings) -> float:
    """What part of a block the jackknife leaves out: all of it for single vectors, next to none for means."""
    return _SINGLE if settings.sub_window is None else OF_MEANS


def jackknife_variance(sums: NDArray[np.float64], untilt: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """Jackknife variance (batch, 3), x, y, z, of the Gaussian peak fit (``variance_of``).

    ``sums``: (batch, blocks, 7) as of ``block_sums``, normalised by overlap; ``untilt`` (batch, 3, 3), the same for all
    blocks; ``part``: of a block that is left out.
    """
    moments = np.zeros((len(sums), 2, 3))
    add_left_out(sums, sums.sum(1), untilt, part, moments)
    return variance_of(moments, sums.shape[1], part)


@kernel
def add_left_out(
    items: NDArray[np.float64],
    total: NDArray[np.float64],
    untilt: NDArray[np.float64],
    part: float,
    moments: NDArray[np.float64],
) -> None:
    """How far the peak of ``total`` (batch, 7) moves where the ``part`` of each of ``items`` (batch, n, 7), which it is
    made of, is left out: adds the sum over the items, and that of squares, to ``moments`` (batch, 2, 3), x, y, z."""
    off = np.empty(3)
    for w in range(items.shape[0]):
        t = total[w]
        for i in range(items.shape[1]):
            c = part * items[w, i]
            for axis in range(3):
                lo, hi = 1 + 2 * axis, 2 + 2 * axis
                here = gaussian_offset(t[lo], t[0], t[hi])
                off[axis] = gaussian_offset(t[lo] - c[lo], t[0] - c[0], t[hi] - c[hi]) - here
            for axis in range(3):
                d = 0.0
                for other in range(3):
                    d += untilt[w, axis, other] * off[other]
                moments[w, 0, axis] += d
                moments[w, 1, axis] += d * d


def variance_of(moments: NDArray[np.float64], count: int, part: float) -> NDArray[np.float64]:
    """Jackknife variance (..., 3) from the sums of ``add_left_out`` (..., 2, 3). With d_i the displacement where the
    ``part`` h of item i of n = ``count`` is left out,

        n/(n - 1) ((1 - h/n)/h)^2 sum_i (d_i - mean d)^2

    which is the delete-one variance (n - 1)/n sum_i (d_i - mean d)^2 for h = 1, the infinitesimal one for h to 0.
    """
    squares: NDArray[np.float64] = moments[..., 1, :] - moments[..., 0, :] ** 2 / count
    return count / max(count - 1, 1) * ((1 - part / count) / part) ** 2 * squares


def averaging_bias(displacement: NDArray[np.float64], windows: WindowGrid) -> NDArray[np.float64]:
    """q (3, nz, ny, nx) in voxels: mean of ``displacement`` over a window less its value at the centre.

    To second order, from second differences over about half a window along each axis; the outermost vectors take that
    of the next one inside.
    """
    out = np.zeros_like(displacement)
    for axis, (size, step, stride) in enumerate(zip(windows.size, windows.step, strides(windows), strict=True), 1):
        n = displacement.shape[axis]
        if stride:
            at = np.clip(np.arange(n), stride, n - 1 - stride)
            before, here, after = (np.take(displacement, at + s, axis) for s in (-stride, 0, stride))
            out += (before - 2 * here + after) * bias_factor(size, step, stride)
    return out


def standard_deviation(
    displacement: NDArray[np.float64],
    valid: NDArray[np.bool_],
    variance: NDArray[np.float64],
    windows: WindowGrid,
    settings: CorrelationSettings,
    whole: WindowGrid | None = None,
    response: NDArray[np.float64] | None = None,
    between_pairs: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Standard deviation (3, nz, ny, nx) of ``displacement`` (same shape), in voxels; finite everywhere. With
    ``whole``: of its mean over those windows, one for each of them. ``response`` (nz,): what part of a displacement in
    depth a pass finds in each layer (``depth_response``); None for all of it.

    ``between_pairs`` (3, as ``whole``): the variance of means as many pairs tell it, which the noise is at least.
    ``variance``: of one correlation, from ``ScatterCorrelator``. A replaced vector (``valid`` False) has no particles
    of its own. Its variance is the mean of the 26 nearest valid ones, whose linear fit its value is, with q enlarged:
    with neighbours all around, a fit weighted by r^-2 is off by <r^2>/6 = 0.30 squared steps of d''_x + d''_y + d''_z.
    """
    amplified = cache(partial(noise_amplification, windows, settings))
    shows = np.ones(windows.shape[0]) if response is None else np.round(response, 2)
    gain, share = np.empty((2, 3, windows.shape[0], 1, 1))
    gain[:2], share[:2] = amplified(1.0).gain, amplified(1.0).bias_share
    gain[2, :, 0, 0] = [amplified(r).gain for r in shows.tolist()]
    share[2, :, 0, 0] = [amplified(r).bias_share for r in shows.tolist()]
    noise = gain * variance
    bias, of_noise = averaging_bias(displacement, windows) ** 2, share * noise
    bias = np.where(bias > _SIGNIFICANT**2 * of_noise, bias, 0.0) if whole is None else bias - of_noise
    out = np.stack([noise, bias])
    if valid.any() and not valid.all():
        known, missing = np.argwhere(valid), np.argwhere(~valid)
        near = [*range(1, min(_NEIGHBOURS, len(known)) + 1)]
        _, index = cKDTree(known).query(missing, k=near)
        steps = np.mean(np.square(windows.step) / np.square(windows.size))
        off = (1 + 24 * _MEAN_SQUARE_STEPS / 6 * steps) ** 2
        out[:, :, ~valid] = np.stack([noise, off * bias])[:, :, valid][:, :, index].mean(-1)
    if whole is None:
        return np.sqrt(out.sum(0))
    over = averaged_share(settings)
    constant, linear = (mean_weights(whole, windows, extrapolate, over) for extrapolate in (False, True))
    bias = np.maximum(mean_over(out[1], constant), 0.0)
    noise = mean_over(np.sqrt(out[0]), constant) ** 2
    # replaced sub-windows come from the same few neighbours: a mean over them has no less noise
    of_mean = np.stack([amplified(1.0).variance_of_mean(linear)] * 3)
    of_pairs = np.zeros(of_mean.shape) if between_pairs is None else between_pairs.copy()
    for layer, r in enumerate(np.round(constant[0] @ shows, 2).tolist()):
        if r < 1.0:
            of_mean[2, layer] = amplified(r).variance_of_mean((linear[0][layer : layer + 1], *linear[1:]))[0]
            of_pairs[2, layer] *= amplified(r).of_all ** 2
    noise, noise_of_mean = np.maximum(noise, of_pairs), np.maximum(of_mean * noise, of_pairs)
    measured = noise_of_mean + _BIAS_OF_MEAN * bias
    return np.sqrt(np.where(mostly_measured(valid, constant), measured, noise + bias))
