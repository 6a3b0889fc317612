"""The cheapest assignment of the particles of one frame to those of the next.

Candidates join particles into groups, most of them small. What is cheapest in each is cheapest together, so groups are
solved some at a time: a solver's time grows with the square of the particles that it is given.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, min_weight_full_bipartite_matching

TOGETHER = 1000  # candidates that are solved at once, at least, where there are as many

Array = NDArray[np.float64]
Int = NDArray[np.int64]


def cheapest_partners(a: Int, b: Int, cost: Array, n: int, m: int, alone: float) -> Int:
    """The partner (n,) of each particle of the first frame, -1 for none, of which all together cost least. Candidates
    (k,): particle ``a`` of ``n`` with ``b`` of ``m``, at a ``cost`` of 0 or more, each pair once; a particle of the
    first frame without a partner costs ``alone`` (Kuhn 1955)."""
    partner = np.full(n, -1)
    if len(a) == 0:
        return partner
    _, group = connected_components(csr_array((np.ones(len(a)), (a, n + b)), shape=(n + m, n + m)), directed=False)
    order = np.argsort(group[a], kind="stable")
    ends = np.append(np.flatnonzero(np.diff(group[a][order])) + 1, len(a))
    low = 0
    for high in ends.tolist():
        if high - low >= TOGETHER or high == len(a):
            some = order[low:high]
            (own_a, of_a), (own_b, of_b) = (np.unique(each[some], return_inverse=True) for each in (a, b))
            found = _of_all(of_a, of_b, cost[some], len(own_a), len(own_b), alone)
            partner[own_a] = np.where(found >= 0, own_b[found], -1)
            low = high
    return partner


def _of_all(a: Int, b: Int, cost: Array, n: int, m: int, alone: float) -> Int:
    """The same, solved as a whole."""
    # each particle may stay alone in a column of its own; no entry may be 0
    rows, columns = np.concatenate([a, np.arange(n)]), np.concatenate([b, m + np.arange(n)])
    price = np.concatenate([cost, np.full(n, alone)]) + 1.0
    row, taken = min_weight_full_bipartite_matching(csr_array((price, (rows, columns)), shape=(n, m + n)))
    partner = np.empty(n, np.int64)
    partner[row] = np.where(taken < m, taken, -1)
    return partner
