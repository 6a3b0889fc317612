"""Solutions of equations that differ little from some whose factor is known: another smoothing, some tracks less.

With M factorised, others of the same penalty are c M + D, where D is information of data alone, which is cheap to
multiply by. The solution of (c M + t D) x = b is looked for among the sums of M^-1 b, M^-1 D M^-1 b and so on (Lanczos
1950, J. Res. Natl. Bur. Stand. 45, 255), which are the same for every c and t: one factor does for a range of
smoothings. Each vector more takes a solution by the factor, a fortieth of the time of the factor itself.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking import banded
from plenopiv.tracking.splines import Equations, coefficients

MOST = 40  # vectors: these take as much time as a factor ...
FEW = 8  # ... and so many tell whether they will do
NO_MORE = 1e-3  # a solution is off: root of the sum of squares over all tracks, in their standard deviations
AHEAD, FAR = 10.0, 1.5  # times a smoothing is one that is factorised for it, and powers of ten from where on it is
LESS, MORE = -1.5, 3.0  # powers of ten from a smoothing that is factorised to those that it may tell

Array = NDArray[np.float64]


class Space:
    """Where solutions x of (c M + t D) x = ``right`` (n,) are looked for: M has the ``factor``, D multiplies by
    ``times``."""

    def __init__(self, factor: Array, times: Callable[[Array], Array], right: Array):
        self._factor, self._times = factor, times
        self._each, self._dual = np.empty((MOST, len(right))), np.empty((MOST, len(right)))  # v with v M v = 1, and M v
        self._form, self._beyond = np.zeros((MOST, MOST)), np.zeros(MOST)  # D among them; what D v has beyond them
        self._size, self._told = self._add(0, right), 0

    def solution(self, c: float, t: float) -> Array | None:
        """x (n,) for a ``c`` and a ``t``; None where MOST vectors do not tell it."""
        if self._size == 0.0:
            return np.zeros(self._each.shape[1])
        for k in range(1, MOST + 1):
            if k > self._told:
                self._tell(k - 1)
            whole = c * np.eye(k) + t * self._form[:k, :k]
            share = np.linalg.solve(whole, self._size * np.eye(k)[0])
            least = float(np.linalg.eigvalsh(whole)[0])  # D may be negative along some of them
            off, most = abs(t * self._beyond[k - 1] * share[-1]), NO_MORE * max(least, 0.0) ** 0.5
            if off <= most:
                return np.asarray(share @ self._each[:k])
            if k >= FEW and (most == 0.0 or k * np.log(self._size / most) > MOST * np.log(self._size / off)):
                return None
        return None

    def _tell(self, k: int) -> None:
        """Multiply vector ``k`` by D: what of it is along the vectors, and the next vector."""
        moved = self._times(self._each[k])
        self._form[: k + 1, k] = self._form[k, : k + 1] = self._each[: k + 1] @ moved
        self._beyond[k], self._told = self._add(k + 1, moved), k + 1

    def _add(self, k: int, dual: Array) -> float:
        """Make M^-1 ``dual``, less what is along the ``k`` vectors before, the next one; its size."""
        one = banded.solution(self._factor, dual[:, None])[:, 0]
        for _ in range(2):  # once more for what rounding leaves
            along = self._dual[:k] @ one
            one, dual = one - along @ self._each[:k], dual - along @ self._dual[:k]
        size = max(float(one @ dual), 0.0) ** 0.5
        if k < MOST and size > 0.0:
            self._each[k], self._dual[k] = one / size, dual / size
        return size


class Solved:
    """``coefficients`` (k, 3, nodes) that solve ``equations`` with a ``smoothing`` for velocities (k, n, 3). The factor
    is kept: by it the solutions of others of the same tracks and the same penalty are found.

    Raises:
        PlenoPIVError: as ``Equations.factor``.
    """

    def __init__(self, equations: Equations, velocity: Array, smoothing: float):
        self._equations, self._strength = equations, smoothing * equations.unit
        self._factor, self._right = equations.factor(smoothing), equations.right(velocity)
        self._found = banded.solution(self._factor, self._right)
        self.coefficients = coefficients(self._found)

    def nearby(self, equations: Equations, velocity: Array, smoothing: float) -> Array:
        """The coefficients (3, nodes) of other equations for velocities (n, 3).

        Raises:
            PlenoPIVError: as ``Equations.factor``.
        """
        c = smoothing * equations.unit / self._strength
        if LESS <= np.log10(c) <= MORE:
            times, start = equations.less(c, self._equations), np.ascontiguousarray(self._found[:, 0])
            right = equations.right(velocity[None])[:, 0] - c * self._right[:, 0] - times(start)
            found = Space(self._factor, times, right).solution(c, 1.0)
            if found is not None:
                return coefficients((start + found)[:, None])[0]
        return equations.solution(velocity[None], smoothing)[0]


class Smoothings:
    """The solutions of ``equations`` for velocities (n, 3) with any smoothing. One factor is kept at a time."""

    def __init__(self, equations: Equations, velocity: Array):
        self._equations, self._right = equations, equations.right(velocity[None])[:, 0]
        self._known: tuple[float, Space] | None = None  # a smoothing, and the space of its factor

    def solution(self, smoothing: float) -> Array:
        """Coefficients (3, nodes).

        Raises:
            PlenoPIVError: as ``Equations.factor``.
        """
        at = smoothing
        if self._known is not None:
            way = float(np.log10(smoothing / self._known[0]))
            found = self._known[1].solution(10.0**way, 1.0 - 10.0**way) if LESS <= way <= MORE else None
            if found is not None:
                return coefficients(found[:, None])[0]
            if abs(way) > FAR:  # further on, to tell of the next ones, too
                at = smoothing * AHEAD ** np.sign(way)
        self._known = None
        try:
            factor = self._equations.factor(at)
        except PlenoPIVError:
            at, factor = smoothing, self._equations.factor(smoothing)
        self._known = at, Space(factor, self._equations.less(0.0, self._equations), self._right)
        if at != smoothing:
            return self.solution(smoothing)
        return coefficients(banded.solution(factor, self._right[:, None]))[0]
