"""Which fitted particles the pixels speak for: those that are not are left out.

A particle of light E whose variance is s^2, the light and places of its neighbours free as well, lowers chi^2 by
E^2 / s^2 against a fit without it. LEAST is what four more parameters reach by chance at one of a million places
(chi^2 of four degrees of freedom: 5e-7). Where the pixels scatter more than their noise, chi^2 is taken relative to
what it is there. Of two particles in the place of one each speaks against the other: of those that are coupled the
weakest goes first, and as long as one has no evidence among those that are left, the next; half of them stay at least,
and are judged again after the next fit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from plenopiv.threads import in_threads
from plenopiv.tracking.areas import areas
from plenopiv.tracking.normal_kernels import mean_misfit
from plenopiv.tracking.refine import Fit

LEAST = 35.0  # by which a particle lowers chi^2
COUPLED = 0.1  # share of information in common above which of two weak particles the weaker goes first
ROUNDING = 1e-5  # of a parameter's information is added: blocks are of single precision

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


def without_evidence(fit: Fit, covariance: Array, misfits: Array) -> NDArray[np.bool_]:
    """Which particles (n,) are to be left out. ``covariance`` (n, 4, 4) in units of the normal equations."""
    misfits = np.maximum(misfits, 1.0)
    weak = 1.0 / np.maximum(covariance[:, 3, 3], 1e-30) / misfits < LEAST
    if not weak.any():
        return weak
    few = np.flatnonzero(weak)
    normal = fit.normal(few)
    row = np.repeat(np.arange(len(few)), np.diff(normal.indptr))
    own = normal.data[np.flatnonzero(row == normal.indices)]
    scale = np.sqrt(np.einsum("nii->ni", own))
    common = (normal.data / scale[row][:, :, None] / scale[normal.indices][:, None, :]) ** 2
    strong = common.sum((1, 2)) > COUPLED
    graph = csr_array((strong[strong], (row[strong], normal.indices[strong])), shape=(len(few), len(few)))
    _, group = connected_components(graph, directed=False)
    order = np.argsort(group, kind="stable")
    whole = normal.tocsr()
    out = weak.copy()
    for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if len(members) > 1:
            unknowns = (4 * members[:, None] + np.arange(4)).ravel()
            dense = whole[unknowns][:, unknowns].toarray().astype(np.float64)
            out[few[members]] = weakest_first(dense, misfits[few[members]])
    return out


def weakest_first(normal: Array, misfits: Array) -> NDArray[np.bool_]:
    """Which of weak particles (m,) that are coupled go: the weakest, and then, as long as one has no evidence among
    those that are left, the next, up to half of them. ``normal`` (4m, 4m): their equations."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    normal = normal * scale[:, None] * scale + ROUNDING * np.eye(len(scale))
    left, of_light = np.arange(len(misfits)), scale[3::4] ** 2
    while len(left):
        unknowns = (4 * left[:, None] + np.arange(4)).ravel()
        variance = np.diag(np.linalg.inv(normal[np.ix_(unknowns, unknowns)]))[3::4] * of_light[left]
        evidence = 1.0 / np.maximum(variance, 1e-30) / misfits[left]
        gone = len(misfits) - len(left)
        if gone >= len(left) or (gone and evidence.min() >= LEAST):
            break
        left = np.delete(left, np.argmin(evidence))
    out = np.ones(len(misfits), bool)
    out[left] = False
    return out
