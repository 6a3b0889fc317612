"""Central moments of a vector at many places, one sample after the other.

Sums of products of deviations from the mean are carried from one sample to the next by the binomial theorem: with
n samples of mean m and one more, x, the mean moves by e = (x - m)/n', n' = n + 1, and

    S'_p = sum_{q <= p} C(p, q) S_q (-e)^(p - q) + (x - m - e)^p,   S_0 = n, S_1 = 0,

where p and q count the factors of each component (Pebay 2008, Sandia report SAND2008-6212, treats the general case;
with p = 2 it is Welford's method). No large numbers are subtracted, so that a mean of many standard deviations does no
harm.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import comb

import numpy as np
from numpy.typing import NDArray

Key = tuple[int, int, int]
PAIRS = ((0, 1), (0, 2), (1, 2))  # u v, u w, v w
HIGHEST = 6  # of one component, for the uncertainty of its skewness
FEWEST = 3  # samples whose products of deviations scatter: those of two are equal


def key(*powers: tuple[int, int]) -> Key:
    """The moment with these (component, power)."""
    found = [0, 0, 0]
    for component, power in powers:
        found[component] += power
    return found[0], found[1], found[2]


KEYS = tuple(
    sorted(
        {key((c, p)) for c in range(3) for p in range(2, HIGHEST + 1)}
        | {key((a, p), (b, q)) for a, b in PAIRS for p in (1, 2) for q in (1, 2)},
        key=lambda k: (-sum(k), k),
    )
)


@cache
def _terms(of: Key) -> tuple[tuple[int, Key, Key], ...]:
    """(C(p, q), q, p - q) for the q < p that add to S'_p: those whose S_q is not zero."""
    found: list[tuple[int, Key, Key]] = []
    for q in product(range(of[0] + 1), range(of[1] + 1), range(of[2] + 1)):
        if q != of and sum(q) != 1:
            rest = of[0] - q[0], of[1] - q[1], of[2] - q[2]
            found.append((comb(of[0], q[0]) * comb(of[1], q[1]) * comb(of[2], q[2]), q, rest))
    return tuple(found)


class Moments:
    """Means and sums of products of deviations at ``shape`` places, of three components.

    ``count`` (shape): samples; ``mean`` (3, shape); ``sums``: by key, the powers of each component, up to six of one
    and two of each of two.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = np.zeros(shape, np.int64)
        self.mean = np.zeros((3, *shape))
        self.sums = {k: np.zeros(shape) for k in KEYS}

    def add(self, values: NDArray[np.float64], counted: NDArray[np.bool_]) -> None:
        """One sample (3, shape) at the places that are ``counted`` (shape); others keep what they have."""
        before = self.count.astype(float)
        self.count += counted
        delta = np.where(counted, values - self.mean, 0.0)
        shift = delta / np.maximum(self.count, 1)
        self.mean += shift
        back, ahead = _powers(-shift), _powers(delta - shift)
        for k in KEYS:  # from high to low order: each needs lower ones as they were
            total = self.sums[k]
            for factor, q, rest in _terms(k):
                old = before if q == (0, 0, 0) else self.sums[q]
                total += factor * old * _times(back, rest)
            total += _times(ahead, k)

    def central(self, *powers: tuple[int, int]) -> NDArray[np.float64]:
        """The central moment of these (component, power): the mean product of deviations; NaN without samples."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.sums[key(*powers)] / self.count

    def covariance(self, a: int, b: int) -> NDArray[np.float64]:
        """Covariance of two components with the divisor n - 1; NaN with fewer than two samples."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.count > 1, self.sums[key((a, 1), (b, 1))] / (self.count - 1.0), np.nan)


def _powers(values: NDArray[np.float64]) -> list[list[NDArray[np.float64]]]:
    """Powers 1 to HIGHEST of each component."""
    found = [[component] for component in values]
    for powers in found:
        while len(powers) < HIGHEST:
            powers.append(powers[-1] * powers[0])
    return found


def _times(powers: list[list[NDArray[np.float64]]], of: Key) -> NDArray[np.float64]:
    found: NDArray[np.float64] | None = None
    for component, power in enumerate(of):
        if power:
            factor = powers[component][power - 1]
            found = factor if found is None else found * factor
    assert found is not None
    return found
