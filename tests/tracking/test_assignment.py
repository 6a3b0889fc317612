"""The cheapest partners of particles, against all possible ones and solved as a whole."""

from itertools import permutations

import numpy as np
import pytest

from plenopiv.tracking import assignment
from plenopiv.tracking.assignment import cheapest_partners

ALONE = 25.0


def random_candidates(rng, n, m, count):
    """``count`` different pairs of ``n`` and ``m`` particles, with costs."""
    chosen = rng.choice(n * m, count, replace=False)
    return chosen // m, chosen % m, rng.uniform(0.0, ALONE, count)


def total(a, b, cost, partner):
    """What partners cost together; none of the second frame is taken twice."""
    of = {(int(i), int(j)): float(c) for i, j, c in zip(a, b, cost, strict=True)}
    taken = partner[partner >= 0]
    assert len(np.unique(taken)) == len(taken)
    return sum(of[i, int(j)] if j >= 0 else ALONE for i, j in enumerate(partner))


def cheapest_of_all(a, b, cost, n, m):
    """The least that any partners cost, each possibility tried."""
    price = np.full((n, m + n), np.inf)
    price[a, b] = cost
    price[:, m:] = ALONE
    return min(sum(price[i, j] for i, j in enumerate(each)) for each in permutations(range(m + n), n))


@pytest.mark.parametrize("seed", range(5))
def test_no_other_partners_cost_less(seed):
    rng = np.random.default_rng(seed)
    a, b, cost = random_candidates(rng, 4, 3, 7)
    partner = cheapest_partners(a, b, cost, 4, 3, ALONE)
    assert total(a, b, cost, partner) == pytest.approx(cheapest_of_all(a, b, cost, 4, 3))


@pytest.mark.parametrize("together", [1, 20, 10_000])
@pytest.mark.parametrize("count", [150, 400, 1500])
def test_groups_are_as_cheap_as_the_whole(together, count, monkeypatch):
    """From pairs that hardly touch to one large group."""
    monkeypatch.setattr(assignment, "TOGETHER", together)
    a, b, cost = random_candidates(np.random.default_rng(count), 300, 280, count)
    partner = cheapest_partners(a, b, cost, 300, 280, ALONE)
    np.testing.assert_array_equal(partner, assignment._of_all(a, b, cost, 300, 280, ALONE))


def test_a_particle_may_give_up_its_nearest_for_another_and_stay_alone():
    a, b = np.array([0, 0, 1]), np.array([0, 1, 0])
    assert cheapest_partners(a, b, np.array([1.0, 4.0, 2.0]), 2, 2, ALONE).tolist() == [1, 0]
    assert cheapest_partners(np.array([0, 1]), np.array([0, 0]), np.array([2.0, 1.0]), 2, 1, ALONE).tolist() == [-1, 0]
    nothing = np.empty(0, np.int64)
    assert cheapest_partners(nothing, nothing, np.empty(0), 3, 2, ALONE).tolist() == [-1, -1, -1]
