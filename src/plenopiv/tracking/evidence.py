"""Which fitted particles the pixels speak for: those that are not are left out.

A particle of light E whose variance is s^2, the light and places of its neighbours free as well, lowers chi^2 by
E^2 / s^2 against a fit without it. LEAST is what four more parameters reach by chance at one of a million places
(chi^2 of four degrees of freedom: 5e-7). Where the pixels scatter more than their noise, chi^2 is taken relative to
what it is there. Of two particles in the place of one each speaks against the other: the weakest goes first, and those
that it is coupled with are judged again after the next fit. Those that would have no evidence were all others known go
at once: swarms of them grow where light comes from what is in no model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.tracking.alone import lowers, misfits
from plenopiv.tracking.areas import areas
from plenopiv.tracking.covariance import NEIGHBOURS, covariance_among, with_those_about
from plenopiv.tracking.equations import own_equations
from plenopiv.tracking.pixels import SAMPLE, Pixels, with_noise
from plenopiv.tracking.refine import Fit, chi2_of, pixel_weights, residual_of

LEAST = 35.0  # by which a particle lowers chi^2
PRESENT = 0.4  # of its expected light that a particle's pixels must hold
BEYOND_DOUBT = 2000.0  # by which a particle lowers chi^2, all others known, that others cannot explain ...
APART = 10.0  # ... if they are so many units from it, or farther
COUPLED = 0.1  # share of information in common above which of two weak particles only the weaker goes

Array = NDArray[np.float64]


def errors_of(
    fit: Fit, usable: NDArray[np.bool_], neighbours: int = NEIGHBOURS, which: NDArray[np.int64] | None = None
) -> tuple[Array, Array]:
    """Of the particles ``which`` (m,), ascending, of a fit, or of all: the covariance (m, 4, 4) of their parameters, in
    the units of the normal equations, and their misfit (m,), the mean of chi^2 of a particle's pixels weighed with its
    light in them, about 1 where the model holds. The parameters of ``neighbours`` among them that share most
    information with a particle are free as well; all others are taken as known."""
    which = np.arange(len(fit.light)) if which is None else which
    chi2 = chi2_of(usable, fit.residual, fit.variance)
    covariance, off = np.empty((len(which), 4, 4)), np.empty(len(which))
    for area, near, own, lights in with_those_about(fit, which):
        covariance[area] = covariance_among(fit.normal(near, lights), own, neighbours)
        off[area] = misfits(lights, chi2)[own]
    return covariance, off


def doubtful(fit: Fit, which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """For which of the particles ``which`` (m,) of a fit there may be no evidence: those that lower chi^2 by less than
    BEYOND_DOUBT, all others known, or are within APART units of another. Of 15,000 that no other was so near to, none
    lacked it that lowers chi^2 by 900 or more. The fit has ``told``."""
    place = fit.position_mm / fit.unit_mm
    apart, _ = cKDTree(place).query(place[which], 2)
    return np.asarray((fit.told[which, 1] < BEYOND_DOUBT) | (apart[:, 1] < APART))


def without_evidence(
    fit: Fit, covariance: Array, misfits: Array, swarms: bool = True, which: NDArray[np.int64] | None = None
) -> NDArray[np.bool_]:
    """Which of the particles ``which`` (m,), ascending, or of all, are to be left out. ``covariance`` (m, 4, 4) in
    units of the normal equations; ``swarms``: those without evidence alone go at once, as another fit follows that
    gives their light to one."""
    evidence = lowers(covariance, misfits)
    weak = evidence < LEAST
    if not weak.any():
        return weak
    few = np.flatnonzero(weak)
    numbers, out, gone = few if which is None else which[few], weak.copy(), np.zeros(len(weak), bool)
    for _, near, own, lights in with_those_about(fit, numbers):
        normal, at = fit.normal(near, lights), few[np.searchsorted(numbers, near)]
        row = np.repeat(np.arange(len(near)), np.diff(normal.indptr))
        others, diagonal = row != normal.indices, np.flatnonzero(row == normal.indices)
        both = np.flatnonzero(others & np.isin(row, own))
        i, j = row[both], normal.indices[both]
        of_each = np.einsum("nii->ni", normal.data[diagonal])  # 0 of a light in no usable pixel
        blocks, scale = normal.data[both], np.sqrt(np.maximum(of_each, np.finfo(np.float32).tiny))
        common = (blocks / scale[i][:, :, None] / scale[j][:, None, :]) ** 2
        strong = common.sum((1, 2)) > COUPLED
        i, j = at[i[strong]], at[j[strong]]
        stays = (evidence[i] > evidence[j]) | ((evidence[i] == evidence[j]) & (i > j))
        out[i[stays]] = False
        if swarms:
            alone, mine = covariance_among(normal, own, 0), at[own]
            gone[mine[lowers(alone, misfits[mine]) < LEAST]] = True
    out |= gone
    return out


def present(fit: Fit, pixels: Pixels, sample: int = SAMPLE) -> tuple[Pixels, Array, NDArray[np.bool_]]:
    """The pixels with their noise, the light with the factor of this frame, and which particles are there, of those
    where a ``fit`` begins; noise is measured on a ``sample`` of pixels."""
    image, light, ratio = fit.image, fit.light, np.ones(len(fit.light))
    for turn in range(2):
        if turn == 0:
            pixels = with_noise(pixels, image, sample)
        else:
            brighter = max(float(np.median(ratio)), 0.1)
            image, light = brighter * image, brighter * light
        weight, pull = pixel_weights(pixels.usable, *residual_of(image, pixels))
        for area in areas(fit.position_mm[:, :2]):
            own, slope = own_equations(fit.lights_of(area), light[area], weight, pull)
            ratio[area] = 1.0 + slope[:, 3] / np.maximum(own[:, 3, 3], 1e-30)
    return pixels, light, ratio > PRESENT
