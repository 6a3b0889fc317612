"""Covariance of particles among their neighbours.

Particles are taken an area at a time (``areas``), with those about it.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from plenopiv.kernels import plain_kernel, plain_part
from plenopiv.threads import in_threads
from plenopiv.tracking.areas import ABOUT, Numbers, about, areas
from plenopiv.tracking.equations import diagonal
from plenopiv.tracking.light import Lights
from plenopiv.tracking.refine import Fit

NEIGHBOURS = 31  # that share most information with a particle; the rest are taken as known
TOGETHER = 5000  # particles of an area, whose equations are made with those about it: more than are fitted together
LEAST = 1e-5  # of a parameter's information is left, whatever its neighbours do: above the rounding of single precision

Array = NDArray[np.float64]


@plain_part
def _schur_of_last(matrix: NDArray[np.float64], size: int) -> None:
    """Cholesky's factor of a matrix (size, size) of unit diagonal and LEAST on top in its upper triangle, but for its
    last four rows and columns: these become the Schur complement, upper triangle."""
    for j in range(size):
        matrix[j, j] += LEAST  # particles at one place leave pivots of rounding, which would grow without end
    for j in range(size - 4):
        root = sqrt(max(matrix[j, j], LEAST))
        for i in range(j, size):
            matrix[j, i] /= root
        for k in range(j + 1, size):
            factor = matrix[j, k]
            if factor != 0.0:
                for i in range(k, size):
                    matrix[k, i] -= matrix[j, i] * factor


@plain_kernel
def _of_particles(
    begin: int, end: int,
    start: NDArray[np.int64], neighbour: NDArray[np.int64], block: NDArray,  # the normal equations' blocks
    own: NDArray[np.int64],  # (n,): which block is a particle's own
    which: NDArray[np.int64],  # (m,): particles that are asked for
    most: int,
    information: NDArray[np.float64],  # (m, 4, 4), filled
) -> None:  # fmt: skip
    """Information on the particles ``which[begin:end]``: the Schur complement in which the parameters of
    ``most`` neighbours, those that are coupled most strongly, are free."""
    size = 4 * (most + 1)
    matrix, scale = np.empty((size, size)), np.empty(size)
    chosen, place = np.empty(most + 1, np.int64), np.full(own.size, -1, np.int64)
    for rank in range(begin, end):
        n = which[rank]
        count = start[n + 1] - start[n]
        coupling = np.zeros(count)
        for e in range(count):
            j, b = neighbour[start[n] + e], block[start[n] + e]
            if j != n:
                for p in range(4):
                    for q in range(4):
                        both = block[own[n], p, p] * block[own[j], q, q]
                        if both > 0.0:  # of a light in no usable pixel nothing is known, nor that of any other with it
                            coupling[e] += b[p, q] * b[p, q] / both
        order = np.argsort(-coupling)
        m = 0
        for e in order:
            if m < most and neighbour[start[n] + e] != n:
                chosen[m] = neighbour[start[n] + e]
                m += 1
        chosen[m] = n  # last, so that its Schur complement is left where the elimination ends
        m += 1
        for a in range(m):
            place[chosen[a]] = a
        matrix[: 4 * m, : 4 * m] = 0.0
        for a in range(m):
            j = chosen[a]
            for e in range(start[j], start[j + 1]):
                c = place[neighbour[e]]
                if c >= 0:
                    for p in range(4):
                        for q in range(4):
                            matrix[4 * a + p, 4 * c + q] = block[e, p, q]
        for a in range(m):
            place[chosen[a]] = -1
        for p in range(4 * m):
            scale[p] = 1.0 / sqrt(max(matrix[p, p], 1e-300))
        for p in range(4 * m):
            for q in range(4 * m):
                matrix[p, q] *= scale[p] * scale[q]
        _schur_of_last(matrix, 4 * m)
        for p in range(4):
            for q in range(4):
                a, b = 4 * m - 4 + min(p, q), 4 * m - 4 + max(p, q)
                information[rank, p, q] = matrix[a, b] / (scale[a] * scale[b])


def with_those_about(fit: Fit, which: Numbers) -> Iterator[tuple[Numbers, Numbers, Numbers, Lights]]:
    """The particles ``which`` (m,), ascending, of a fit in areas. Of each area: their numbers among ``which``; the
    numbers in the fit of these and of those of ``which`` about them, which are coupled with them; the area's own among
    these; and where the light of these goes."""
    place = fit.position_mm[which, :2]
    for area in areas(place, most=TOGETHER):
        near = about(place, area, ABOUT * fit.unit_mm[:2])
        yield area, which[near], np.searchsorted(near, area), fit.lights_of(which[near])


def covariance_among(normal: bsr_array, which: NDArray[np.int64], neighbours: int = NEIGHBOURS) -> Array:
    """Covariance (m, 4, 4) of the particles ``which`` (m,) of those of the normal equations ``normal`` (4n, 4n, in
    blocks, with sorted indices)."""
    information = np.empty((len(which), 4, 4))
    blocks = normal.indptr.astype(np.int64), normal.indices.astype(np.int64), normal.data
    in_threads(_of_particles, len(which), *blocks, diagonal(normal), which, neighbours, information)
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", information), 1e-300))
    values, vectors = np.linalg.eigh(information / scale[:, :, None] / scale[:, None, :])
    inverse = (vectors / np.maximum(values, LEAST)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(inverse / scale[:, :, None] / scale[:, None, :])
