"""Equations that differ little from factorised ones have the solutions that their own factors give."""

import numpy as np
import pytest

from plenopiv.tracking import nearby
from plenopiv.tracking.nearby import Smoothings, Solved
from plenopiv.tracking.splines import Equations, values_at

NODES, STEP, LOW = (7, 6, 8), 0.5, np.zeros(3)


@pytest.fixture
def tracks():
    """Velocities (n, 3), their standard deviations, values of splines."""
    rng = np.random.default_rng(6)
    points = LOW + STEP * rng.uniform(0.0, 1.0, (700, 3)) * (np.array(NODES) - 3)
    std = rng.uniform(0.01, 0.05, (700, 3))
    return np.sin(2.0 * points) + std * rng.standard_normal((700, 3)), std, values_at(points, LOW, STEP, NODES)


@pytest.fixture
def factors(monkeypatch):
    """Smoothings that are factorised."""
    made, of = [], Equations.factor
    monkeypatch.setattr(Equations, "factor", lambda self, smoothing: made.append(smoothing) or of(self, smoothing))
    return made


def off(values, std, found, expected):
    """How far splines are from the expected ones at the tracks: root of the sum of squares, in standard deviations."""
    return np.sqrt((((values @ (found - expected).T) / std) ** 2).sum())


def test_few_factors_tell_of_all_smoothings(tracks, factors):
    velocity, std, values = tracks
    equations = Equations(values, std, NODES, True)
    smoothings = Smoothings(equations, velocity)
    powers = [-1.0, -2.0, 0.0, 1.0, 2.0, 3.0, 2.5, 1.5]
    found = [smoothings.solution(10.0**power) for power in powers]
    assert len(factors) <= 3
    for power, one in zip(powers, found, strict=True):
        assert off(values, std, one, equations.solution(velocity[None], 10.0**power)[0]) < 2 * nearby.NO_MORE


def test_a_fold_and_other_errors_take_no_factor_of_their_own(tracks, factors):
    velocity, std, values = tracks
    solved = Solved(Equations(values, std, NODES, True), np.stack([velocity, 2.0 * velocity]), 3.0)
    assert solved.coefficients[1] == pytest.approx(2.0 * solved.coefficients[0])
    held = np.arange(len(std)) % 5 == 0
    wider = std * np.where(np.arange(len(std)) % 7 == 0, 3.0, 1.0)[:, None]
    for other, smoothing in ((np.where(held[:, None], np.inf, std), 3.0), (wider, 1.0)):
        equations = Equations(values, other, NODES, True)
        factors.clear()
        found = solved.nearby(equations, velocity, smoothing)
        assert not factors
        expected = equations.solution(velocity[None], smoothing)[0]
        assert off(values, std, found, expected) < 4 * nearby.NO_MORE  # at those held out, too
    left = ~held  # infinite errors are tracks that are not there
    alone = Equations(values[left], std[left], NODES, True).solution(velocity[left][None], 3.0)[0]
    same = Equations(values, np.where(held[:, None], np.inf, std), NODES, True).solution(velocity[None], 3.0)[0]
    assert same == pytest.approx(alone, abs=1e-9)


def test_what_is_too_far_is_factorised(tracks, factors):
    velocity, std, values = tracks
    equations = Equations(values, std, NODES, True)
    solved = Solved(equations, velocity[None], 1e-4)
    found = solved.nearby(equations, velocity, 1e3)
    assert factors == [1e-4, 1e3]
    assert (found == equations.solution(velocity[None], 1e3)[0]).all()
    nothing = Smoothings(equations, np.zeros_like(velocity))
    assert (nothing.solution(1.0) == 0.0).all()
