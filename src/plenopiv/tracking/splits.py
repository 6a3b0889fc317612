"""Particles that are two: what a fit leaves in the pixels of one says where the two are.

Two particles within a few voxels of each other, most often one behind the other, are fitted as one in their midst, of
the light of both. In the pixels remains what the second derivatives of its light make of a pair: with d from the midst
to either of two equal particles,

    E/2 (w(x + d) + w(x - d)) - E w(x) = E/2 sum over j, k of  d_j d_k  d^2w/dx_j dx_k + ...

so that a linear fit of the residual by the six second derivatives, light, place and stray light free, gives d d^T/2,
whose largest eigenvector is the direction. How much of chi^2 the six explain says whether it is worth while to fit two.
Whether there are two is decided after that (``evidence``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.threads import in_threads
from plenopiv.tracking.equations import entries
from plenopiv.tracking.refine import Fit
from plenopiv.tracking.split_kernels import FREE, PLACES, TERMS, derivative_equations

CROWDED, BRIGHT = 1.1, 1.25  # times the median's misfit, or light, from which on a particle is looked at
LEAST = 20.0  # by which the second derivatives must lower chi^2: they show but a part of what two particles explain
STEP = 0.15  # units, between which derivatives are taken
LEAST_HALF = 0.1  # units from the midst: nearer than that there is no pair, but light that is spread less
NEAREST, FARTHEST = 0.5, 4.0  # units from the midst at which both are begun
TOGETHER = 2000  # particles looked at at a time
RIDGE, NOTHING = 1e-6, 1e-12  # of each parameter's own information, and of one without any
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

Array = NDArray[np.float64]


def splits(fit: Fit, misfits: Array, asked: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
    """Which particles (m,) of a fit may be two, of those ``asked`` (n,), and where from there (m, 3) mm either of the
    two is. ``misfits`` (n,): of ``evidence.errors_of``."""
    which, unit = np.flatnonzero(asked), fit.unit_mm
    found, half = [np.empty(0, np.int64)], [np.empty((0, 3))]
    for first in range(0, len(which), TOGETHER):
        some = which[first : first + TOGETHER]
        gain, offset = pairs(*equations(fit, some))
        two = (gain > LEAST * np.maximum(misfits[some], 1.0)) & np.isfinite(offset).all(1)
        found.append(some[two])
        half.append(offset[two] * unit)
    return np.concatenate(found), np.concatenate(half)


def equations(fit: Fit, which: NDArray[np.int64]) -> tuple[Array, Array]:
    """The normal equations (m, 11, 11) and right sides (m, 11) of the particles ``which`` (m,) of a fit: of stray
    light, light, place and the second derivatives by xx, yy, zz, xy, xz, yz, in units."""
    places = fit.position_mm[which, None] + STEP * np.eye(PLACES, 3, -1) * fit.unit_mm
    lights = fit.of_points(places.reshape(-1, 3))
    normal, right = np.empty((len(which), TERMS, TERMS)), np.empty((len(which), TERMS))
    in_threads(
        derivative_equations, len(which), *entries(lights), STEP, fit.unit_mm, fit.light[which], fit.weight,
        fit.residual, normal, right,
    )  # fmt: skip
    return normal, right


def pairs(normal: Array, right: Array) -> tuple[Array, Array]:
    """By how much the second derivatives lower chi^2 (m,), all terms free; and where from the midst either of a pair is
    (m, 3), in units, NaN where they show none. Equations as of ``equations``."""
    known = normal.copy()
    diagonal = np.einsum("nii->ni", known)
    diagonal *= 1.0 + RIDGE
    diagonal += NOTHING
    whole = np.linalg.solve(known, right[:, :, None])[:, :, 0]
    alone = np.linalg.solve(known[:, :FREE, :FREE], right[:, :FREE, None])[:, :, 0]
    gain = np.einsum("ni,ni->n", right, whole) - np.einsum("ni,ni->n", right[:, :FREE], alone)
    matrix = np.empty((len(right), 3, 3))
    for k, (i, j) in enumerate(PAIRS):
        matrix[:, i, j] = matrix[:, j, i] = whole[:, FREE + k]
    values, vectors = np.linalg.eigh(matrix)
    half = np.sqrt(2.0 * np.maximum(values[:, -1], 0.0))
    half = np.where(half > LEAST_HALF, np.clip(half, NEAREST, FARTHEST), np.nan)
    return gain, vectors[:, :, -1] * half[:, None]


def crowded(fit: Fit, misfits: Array) -> NDArray[np.bool_]:
    """Which particles (n,) of a fit are worth asking: their pixels are explained worse, or they are brighter, than
    most."""
    return np.asarray((misfits > CROWDED * np.median(misfits)) | (fit.light > BRIGHT * np.median(fit.light)))


def near_any(position_mm: Array, others_mm: Array, unit_mm: Array) -> NDArray[np.bool_]:
    """Which of the positions (n, 3) are within a unit (3,) of any of the others (m, 3)."""
    if not len(others_mm):
        return np.zeros(len(position_mm), bool)
    return np.asarray(cKDTree(others_mm / unit_mm).query(position_mm / unit_mm)[0] < 1.0)
