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

from plenopiv.tracking.light import LightOfPoints, Lights
from plenopiv.tracking.refine import Fit

CROWDED, BRIGHT = 1.1, 1.25  # times the median's misfit, or light, from which on a particle is looked at
LEAST = 20.0  # by which the second derivatives must lower chi^2: they show but a part of what two particles explain
STEP = 0.5  # units of ``Lights.unit_mm``, of the differences that second derivatives are taken from
LEAST_HALF = 0.1  # units from the midst: nearer than that there is no pair, but light that is spread less
NEAREST, FARTHEST = 0.5, 4.0  # units from the midst at which both are begun
FREE = 5  # parameters of one particle: stray light, light, place
TOGETHER = 2000  # particles looked at at a time
RIDGE, NOTHING = 1e-6, 1e-12  # of each parameter's own information, and of one without any
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

Array = NDArray[np.float64]


def splits(
    of_points: LightOfPoints, fit: Fit, misfits: Array, asked: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array]:
    """Which particles (m,) of a fit may be two, of those ``asked`` (n,), and where from there (m, 3) mm either of the
    two is. ``misfits`` (n,): of ``evidence.misfit``."""
    which, unit = np.flatnonzero(asked), fit.lights.unit_mm
    steps = STEP * np.concatenate([np.diag(unit), -np.diag(unit)])
    found, half = list[int](), list[Array]()
    for first in range(0, len(which), TOGETHER):
        some = which[first : first + TOGETHER]
        moved = of_points((fit.position_mm[some, None] + steps).reshape(-1, 3))
        for n, particle in enumerate(some.tolist()):
            pixel, terms = _derivatives(fit.lights, particle, moved, len(steps) * n)
            terms *= fit.light[particle]
            weight = fit.weight[pixel].astype(np.float64)
            gain, offset = _pair(terms * weight[:, None], fit.residual[pixel] * weight)
            if gain > LEAST * max(misfits[particle], 1.0) and offset is not None:
                found.append(particle)
                half.append(offset * unit)
    return np.array(found, np.int64), np.array(half).reshape(-1, 3)


def crowded(fit: Fit, misfits: Array) -> NDArray[np.bool_]:
    """Which particles (n,) of a fit are worth asking: their pixels are explained worse, or they are brighter, than
    most."""
    return np.asarray((misfits > CROWDED * np.median(misfits)) | (fit.light > BRIGHT * np.median(fit.light)))


def near_any(position_mm: Array, others_mm: Array, unit_mm: Array) -> NDArray[np.bool_]:
    """Which of the positions (n, 3) are within a unit (3,) of any of the others (m, 3)."""
    if not len(others_mm):
        return np.zeros(len(position_mm), bool)
    return np.asarray(cKDTree(others_mm / unit_mm).query(position_mm / unit_mm)[0] < 1.0)


def _derivatives(lights: Lights, particle: int, moved: Lights, first: int) -> tuple[NDArray[np.int32], Array]:
    """The pixels (p,) of a particle and its light in them (p, 11): the same in all, share, derivatives by place, and
    the six second ones, from the six points from ``first`` on of ``moved``; lengths in units."""
    unit = lights.unit_mm
    own, around = slice(*lights.start[[particle, particle + 1]]), slice(*moved.start[[first, first + 6]])
    pixel, at = np.unique(np.concatenate([lights.pixel[own], moved.pixel[around]]), return_inverse=True)
    here, there = at[: own.stop - own.start], at[own.stop - own.start :]
    terms = np.empty((len(pixel), FREE + len(PAIRS)))
    terms[:, 0] = 1.0 / len(pixel)
    terms[:, 1] = np.bincount(here, lights.share[own], len(pixel))
    for axis in range(3):
        terms[:, 2 + axis] = np.bincount(here, lights.gradient[own, axis] * unit[axis], len(pixel))
    step = np.repeat(np.arange(6), np.diff(moved.start[first : first + 7]))
    change = moved.gradient[around] * (unit * np.where(step < 3, 0.5, -0.5)[:, None] / STEP)
    place = (9 * there + 3 * (step % 3))[:, None] + np.arange(3)
    second = np.bincount(place.ravel(), change.ravel(), 9 * len(pixel)).reshape(-1, 3, 3)
    for k, (i, j) in enumerate(PAIRS):
        terms[:, FREE + k] = second[:, i, i] if i == j else second[:, i, j] + second[:, j, i]
    return pixel, terms


def _pair(terms: Array, left: Array) -> tuple[float, Array | None]:
    """By how much the second derivatives, the last ``terms`` (n, 11), lower chi^2 of what is ``left`` (n,), all terms
    free; and where from the midst either of a pair is, in units, or None where they show no pair."""
    normal, right = terms.T @ terms, terms.T @ left
    diagonal = np.diag_indices(len(normal))
    normal[diagonal] = (1.0 + RIDGE) * normal[diagonal] + NOTHING
    whole, alone = np.linalg.solve(normal, right), np.linalg.solve(normal[:FREE, :FREE], right[:FREE])
    gain = float(right @ whole - right[:FREE] @ alone)
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(whole[FREE:], PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    values, vectors = np.linalg.eigh(matrix)
    half = (2.0 * max(values[-1], 0.0)) ** 0.5
    return gain, vectors[:, -1] * float(np.clip(half, NEAREST, FARTHEST)) if half > LEAST_HALF else None
