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

from plenopiv.threads import in_threads
from plenopiv.tracking.areas import areas
from plenopiv.tracking.covariance import covariance_among
from plenopiv.tracking.normal_kernels import mean_misfit
from plenopiv.tracking.refine import Fit

LEAST = 35.0  # by which a particle lowers chi^2
COUPLED = 0.1  # share of information in common above which of two weak particles only the weaker goes

Array = NDArray[np.float64]


def misfit(fit: Fit, usable: NDArray[np.bool_]) -> Array:
    """Of each particle (n,) the mean of chi^2 of its pixels, weighed with its light in them; about 1 where the model
    holds."""
    chi2 = np.where(usable, fit.residual**2 / fit.variance, np.nan)
    out = np.empty(len(fit.light))
    for area in areas(fit.position_mm[:, :2]):
        lights, of_area = fit.lights_of(area), np.empty(len(area))
        in_threads(mean_misfit, len(area), lights.start, lights.pixel, lights.share, chi2, of_area)
        out[area] = of_area
    return out


def without_evidence(fit: Fit, covariance: Array, misfits: Array, swarms: bool = True) -> NDArray[np.bool_]:
    """Which particles (n,) are to be left out. ``covariance`` (n, 4, 4) in units of the normal equations; ``swarms``:
    those without evidence alone go at once, as another fit follows that gives their light to one."""
    evidence = lowers(covariance, misfits)
    weak = evidence < LEAST
    if not weak.any():
        return weak
    few = np.flatnonzero(weak)
    normal = fit.normal(few)
    row = np.repeat(np.arange(len(few)), np.diff(normal.indptr))
    both, own = np.flatnonzero(row != normal.indices), np.flatnonzero(row == normal.indices)
    i, j = row[both], normal.indices[both]
    blocks, scale = normal.data[both], np.sqrt(np.einsum("nii->ni", normal.data[own]))
    common = (blocks / scale[i][:, :, None] / scale[j][:, None, :]) ** 2
    strong = common.sum((1, 2)) > COUPLED
    out = weak.copy()
    i, j = few[i[strong]], few[j[strong]]
    stays = (evidence[i] > evidence[j]) | ((evidence[i] == evidence[j]) & (i > j))
    out[i[stays]] = False
    if swarms:
        alone = covariance_among(normal, np.arange(len(few)), 0)
        out[few[lowers(alone, misfits[few]) < LEAST]] = True
    return out


def lowers(covariance: Array, misfits: Array) -> Array:
    """By how much the light of each particle (n,) lowers chi^2, of its ``covariance`` (n, 4, 4)."""
    return np.asarray(1.0 / np.maximum(covariance[:, 3, 3], 1e-30) / np.maximum(misfits, 1.0))
