"""Cubic B-splines on a regular grid of nodes, and the equations of their coefficients.

A coefficient's three components stand side by side, nodes along x fastest: the normal equations are then a band, its
lower diagonals row by row as LAPACK has them, factorised by Cholesky's method.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError
from scipy.sparse import csr_array, eye_array

from plenopiv.errors import PlenoPIVError
from plenopiv.kernels import kernel
from plenopiv.tracking import banded

STIFFNESS = 3e4  # of div u against the smoothing's largest eigenvalue
RIDGE = 1e-9  # of the data's information, on every coefficient
UNEVEN = "tracking: tracks in a part of the volume alone make no field of all of it; make the volume smaller"

Array = NDArray[np.float64]
Nodes = tuple[int, int, int]  # along x, y, z


class Equations:
    """Of velocities with standard deviations ``std`` (n, 3), infinite for those that do not count, where splines have
    the values ``values`` (n, nodes).

    Their coefficients minimise  sum |u - u_i|^2 / s_i^2  +  smoothing * unit * penalty;  ``unit`` is the data's mean
    information on a coefficient, ``weight`` (n, 3) is 1 / s_i^2.
    """

    def __init__(self, values: csr_array, std: Array, nodes: Nodes, divergence_free: bool):
        self.values, self.weight = values, 1.0 / std**2
        self.unit = information(values, std)
        self._nodes, self._stiffness = nodes, STIFFNESS if divergence_free else 0.0

    def solution(self, velocity: Array, smoothing: float) -> Array:
        """Coefficients (k, 3, nodes) of velocities (k, n, 3).

        Raises:
            PlenoPIVError: as ``factor``.
        """
        return coefficients(banded.solution(self.factor(smoothing), self.right(velocity)))

    def factor(self, smoothing: float) -> Array:
        """Cholesky's factor of the equations, as ``banded.factor`` has it.

        Raises:
            PlenoPIVError: where tracks are not, nodes are known less well than rounding tells.
        """
        reach = 3 * sum(min(3, n - 1) * each for n, each in zip(self._nodes, _strides(self._nodes), strict=True)) + 2
        columns = np.zeros((3 * int(np.prod(self._nodes)), reach + 1))
        add_penalty(np.array(self._nodes), _forms(self._nodes), self._stiffness, smoothing * self.unit, columns)
        index, value = (each.reshape(len(self.weight), -1) for each in (self.values.indices, self.values.data))
        near = np.argsort(index[:, 0], kind="stable")  # neighbours one after the other, for caches
        add_data(index[near], value[near], self.weight[near], columns)
        columns[:, 0] += RIDGE * self.unit
        try:
            return banded.factor(columns.T, in_place=True)
        except LinAlgError as error:
            raise PlenoPIVError(UNEVEN) from error

    def right(self, velocity: Array) -> Array:
        """Right sides (3 nodes, k) of velocities (k, n, 3)."""
        each = [self.values.T @ (self.weight[:, axis] * velocity[:, :, axis]).T for axis in range(3)]
        return np.stack(each, 1).reshape(-1, len(velocity))

    def less(self, share: float, other: Equations) -> Callable[[Array], Array]:
        """What multiplies (3 nodes,) by the data's part of these equations less a ``share`` of that of others, of the
        same ``values``."""
        weight, ridge = self.weight - share * other.weight, RIDGE * (self.unit - share * other.unit)

        def times(x: Array) -> Array:
            of_data = self.values.T @ (weight * (self.values @ x.reshape(-1, 3)))
            return of_data.ravel() + ridge * x

        return times


def coefficients(unknowns: Array) -> Array:
    """Coefficients (k, 3, nodes) of the ``unknowns`` (3 nodes, k) of equations."""
    return np.ascontiguousarray(unknowns.reshape(-1, 3, unknowns.shape[1]).T)


def information(values: csr_array, std: Array) -> float:
    """The mean information on a coefficient of velocities with standard deviations ``std`` (n, 3) where splines have
    the values ``values`` (n, nodes)."""
    return float(values.multiply(values).sum(1) @ (1.0 / std**2).mean(1)) / values.shape[1]


@kernel
def add_data(
    index: NDArray[np.int32], value: Array,  # (n, k): nodes that have a part in a point, in order, and how much
    weight: Array,  # (n, 3)
    columns: Array,  # (3 nodes, reach + 1), added to: columns of the matrix from its main diagonal down
) -> None:  # fmt: skip
    """Add the information of the points to the band."""
    for n in range(index.shape[0]):
        if weight[n, 0] == 0.0 and weight[n, 1] == 0.0 and weight[n, 2] == 0.0:
            continue
        for j in range(index.shape[1]):
            first = 3 * index[n, j]
            for i in range(j, index.shape[1]):
                both = value[n, i] * value[n, j]
                below = 3 * (index[n, i] - index[n, j])
                for axis in range(3):
                    columns[first + axis, below] += weight[n, axis] * both


@kernel
def add_penalty(
    nodes: NDArray[np.int64],  # (3,): along x, y, z
    forms: Array,  # (3, 5, n, n), n at least as many as nodes along an axis: as ``_forms`` has them
    stiffness: float, smoothing: float,
    columns: Array,  # (3 nodes, reach + 1), added to: columns of the matrix from its main diagonal down
) -> None:  # fmt: skip
    """Add the squared third differences and ``stiffness`` times the squared divergence to the band, times
    ``smoothing``: products of what there is along each axis."""
    nx, ny, nz = nodes[0], nodes[1], nodes[2]
    of_yz = np.empty((3, 3))
    for column in range(nx * ny * nz):
        cz, cy, cx = column // (nx * ny), column // nx % ny, column % nx
        for z in range(cz, min(cz + 4, nz)):
            for y in range(max(cy - 3, 0), min(cy + 4, ny)):
                here = z == cz and y == cy
                third = (z == cz) * forms[1, 4, y, cy] + (y == cy) * forms[2, 4, z, cz]
                for a in range(3):
                    for b in range(3):
                        of_y, of_z = forms[1, 2 * (a == 1) + (b == 1), y, cy], forms[2, 2 * (a == 2) + (b == 2), z, cz]
                        of_yz[a, b] = smoothing * stiffness * of_y * of_z
                first = (z * ny + y) * nx
                for x in range(max(cx - 3, 0), min(cx + 4, nx)):
                    below = 3 * (first + x - column)
                    if below < 0:
                        continue
                    of_third = (x == cx) * third + here * forms[0, 4, x, cx]
                    for b in range(3):
                        columns[3 * column + b, below] += smoothing * of_third
                        for a in range(b if below == 0 else 0, 3):
                            entry = of_yz[a, b] * forms[0, 2 * (a == 0) + (b == 0), x, cx]
                            columns[3 * column + b, below + a - b] += entry


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


def _strides(nodes: Nodes) -> Nodes:
    """How far nodes next to each other along x, y and z are apart in the order of all."""
    return 1, nodes[0], nodes[0] * nodes[1]


@lru_cache(maxsize=8)
def _forms(nodes: Nodes) -> Array:
    """Along each axis (3, 5, n, n), what penalties are products of: sums, over the middles of halves of cells, of value
    times value, value times slope, slope times value and slope times slope of two splines, and squared third
    differences."""
    out = np.zeros((3, 5, max(nodes), max(nodes)))
    for axis, count in enumerate(nodes):
        middles, knots = (np.arange(2 * (count - 3)) + 0.5) / 2, np.arange(count + 4) - 3.0
        value = BSpline.design_matrix(middles, knots, 3).toarray()
        slope = -np.diff(BSpline.design_matrix(middles, knots[1:-1], 2).toarray(), axis=1, prepend=0.0, append=0.0)
        third = np.diff(np.eye(count), 3, axis=0)
        each = [row.T @ column for row in (value, slope) for column in (value, slope)]
        out[axis, :, :count, :count] = [*each, third.T @ third]
    return out
