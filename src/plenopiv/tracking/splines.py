"""Cubic B-splines on a regular grid of nodes, and the equations of their coefficients.

A coefficient's three components stand side by side, nodes along x fastest: the normal equations are then a band, its
lower diagonals row by row as LAPACK has them, factorised by Cholesky's method.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError
from scipy.sparse import block_diag, csr_array, eye_array, hstack, kron

from plenopiv.errors import PlenoPIVError
from plenopiv.kernels import kernel
from plenopiv.tracking import banded

STIFFNESS = 3e4  # of div u against the smoothing's largest eigenvalue
RIDGE = 1e-9  # of the data's information, on every coefficient
UNEVEN = "tracking: tracks in a part of the volume alone make no field of all of it; make the volume smaller"

Array = NDArray[np.float64]
Nodes = tuple[int, int, int]  # along x, y, z


class Equations:
    """Of velocities with standard deviations ``std`` (n, 3) where splines have the values ``values`` (n, nodes).

    Their coefficients minimise  sum |u - u_i|^2 / s_i^2  +  smoothing * unit * penalty;  ``unit`` is the data's mean
    information on a coefficient.
    """

    def __init__(self, values: csr_array, std: Array, nodes: Nodes, divergence_free: bool):
        self._values, self._weight = values, 1.0 / std**2
        self._penalty = _penalty(nodes, divergence_free)
        self._band = np.zeros(self._penalty.shape)
        n = len(std)
        add_data(values.indices.reshape(n, -1), values.data.reshape(n, -1), self._weight, self._band)
        self.unit = information(values, std)
        self._band[0] += RIDGE * self.unit

    def solution(self, velocity: Array, smoothing: float) -> Array:
        """Coefficients (k, 3, nodes) of velocities (k, n, 3).

        Raises:
            PlenoPIVError: where tracks are not, nodes are known less well than rounding tells.
        """
        form = self._penalty * (smoothing * self.unit)
        form += self._band
        try:
            factor = banded.factor(form)
        except LinAlgError as error:
            raise PlenoPIVError(UNEVEN) from error
        right = np.stack([self._values.T @ (self._weight[:, axis] * velocity[:, :, axis]).T for axis in range(3)], 1)
        found = banded.solution(factor, right.reshape(form.shape[1], -1))
        return np.ascontiguousarray(found.reshape(-1, 3, len(velocity)).T)


def information(values: csr_array, std: Array) -> float:
    """The mean information on a coefficient of velocities with standard deviations ``std`` (n, 3) where splines have
    the values ``values`` (n, nodes)."""
    return float(values.multiply(values).sum(1) @ (1.0 / std**2).mean(1)) / values.shape[1]


@kernel
def add_data(
    index: NDArray[np.int32], value: Array,  # (n, k): nodes that have a part in a point, in order, and how much
    weight: Array,  # (n, 3)
    band: Array,  # (reach + 1, 3 nodes), added to
) -> None:  # fmt: skip
    """Add the information of the points to the band."""
    for n in range(index.shape[0]):
        for i in range(index.shape[1]):
            for j in range(i + 1):
                both = value[n, i] * value[n, j]
                below, first = 3 * (index[n, i] - index[n, j]), 3 * index[n, j]
                for axis in range(3):
                    band[below, first + axis] += weight[n, axis] * both


def values_at(points: Array, low: Array, step: float, nodes: Nodes, derivative: int | None = None) -> csr_array:
    """Values (n, nodes) of all splines at points (n, 3) in mm, or derivatives (1/mm) along an axis; ``low`` (3,): where
    the grid begins."""
    if not len(points):  # SciPy makes no matrix without rows
        return csr_array((0, int(np.prod(nodes))))
    each = []
    for axis in range(3):
        knots = low[axis] + step * (np.arange(nodes[axis] + 4) - 3.0)
        at = np.clip(points[:, axis], knots[3] + 1e-9, knots[-4] - 1e-9)
        if derivative == axis:
            fewer = csr_array(BSpline.design_matrix(at, knots[1:-1], 2))
            before = csr_array(eye_array(nodes[axis] - 1, nodes[axis], k=1) - eye_array(nodes[axis] - 1, nodes[axis]))
            each.append(csr_array(fewer @ before) / step)
        else:
            each.append(csr_array(BSpline.design_matrix(at, knots, 3)))
    x, y, z = each
    return _rows_times(z, _rows_times(y, x))


def _rows_times(a: csr_array, b: csr_array) -> csr_array:
    """Products of all entries of each row of a with all of the same row of b: (n, columns of a * columns of b)."""
    a, b = a.tocsr(), b.tocsr()
    per_a, per_b = np.diff(a.indptr), np.diff(b.indptr)
    if len(set(per_a)) > 1 or len(set(per_b)) > 1:
        raise AssertionError("design matrices have as many entries in each row")
    n = a.shape[0]
    i, j = a.indices.reshape(n, -1), b.indices.reshape(n, -1)
    index = (i[:, :, None].astype(np.int64) * b.shape[1] + j[:, None, :]).reshape(n, -1)
    values = (a.data.reshape(n, -1)[:, :, None] * b.data.reshape(n, -1)[:, None, :]).reshape(n, -1)
    start = np.arange(n + 1) * index.shape[1]
    return csr_array((values.ravel(), index.ravel(), start), shape=(n, a.shape[1] * b.shape[1]))


@lru_cache(maxsize=2)
def _penalty(nodes: Nodes, divergence_free: bool) -> Array:
    """The band (reach + 1, 3 nodes) of squared third differences, and of the divergence between the nodes."""
    nx, ny, nz = nodes
    unit = [eye_array(count) for count in (nz, ny, nx)]
    form = None
    for axis, count in enumerate((nz, ny, nx)):
        if count < 4:
            continue
        third = csr_array(np.diff(np.eye(count), 3, axis=0))
        parts = [third if a == axis else unit[a] for a in range(3)]
        each = kron(kron(parts[0], parts[1]), parts[2])
        own = each.T @ each
        form = own if form is None else form + own
    smooth = block_diag([form] * 3)
    if divergence_free:
        middles = [(np.arange(2 * (count - 3)) + 0.5) / 2 for count in nodes]
        z, y, x = np.meshgrid(middles[2], middles[1], middles[0], indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], -1)
        divergence = hstack([values_at(points, np.zeros(3), 1.0, nodes, axis) for axis in range(3)])
        smooth = smooth + STIFFNESS * (divergence.T @ divergence)
    entries, count = smooth.tocoo(), nx * ny * nz
    row, column = (3 * (place % count) + place // count for place in (entries.row, entries.col))
    lower = row >= column
    row, column = row[lower], column[lower]
    reach = 3 * (min(3, nz - 1) * nx * ny + min(3, ny - 1) * nx + min(3, nx - 1)) + 2  # of the data, too
    out = np.zeros((reach + 1, 3 * count))
    out[row - column, column] = entries.data[lower]
    return out
