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
from plenopiv.tracking.covariance import covariance_among, with_those_about
from plenopiv.tracking.light import Lights
from plenopiv.tracking.normal_kernels import mean_misfit
from plenopiv.tracking.refine import Fit

LEAST = 35.0  # by which a particle lowers chi^2
COUPLED = 0.1  # share of information in common above which of two weak particles only the weaker goes

Array = NDArray[np.float64]


def misfit(fit: Fit, usable: NDArray[np.bool_]) -> Array:
    """Of each particle (n,) the mean of chi^2 of its pixels, weighed with its light in them; about 1 where the model
    holds."""
    chi2, out = _chi2(fit, usable), np.empty(len(fit.light))
    for area in areas(fit.position_mm[:, :2]):
        out[area] = _mean(fit.lights_of(area), chi2)
    return out


def errors_of(
    fit: Fit, usable: NDArray[np.bool_], neighbours: int, which: NDArray[np.int64] | None = None
) -> tuple[Array, Array]:
    """``covariance_of`` and ``misfit`` of the particles ``which`` (m,), ascending, or of all: those that are not among
    ``which`` are taken as known."""
    which = np.arange(len(fit.light)) if which is None else which
    chi2, off, covariance = _chi2(fit, usable), np.empty(len(which)), np.empty((len(which), 4, 4))
    for area, near, own, lights in with_those_about(fit, which):
        off[area] = _mean(lights, chi2)[own]
        covariance[area] = covariance_among(fit.normal(near, lights), own, neighbours)
    return covariance, off


def _chi2(fit: Fit, usable: NDArray[np.bool_]) -> Array:
    return np.where(usable, fit.residual**2 / fit.variance, np.nan)


def _mean(lights: Lights, chi2: Array) -> Array:
    """The mean of chi^2 of the pixels of each of some particles (n,)."""
    out = np.empty(len(lights.start) - 1)
    in_threads(mean_misfit, len(out), lights.start, lights.pixel, lights.share, chi2, out)
    return out


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
    normal = fit.normal(few if which is None else which[few])
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
