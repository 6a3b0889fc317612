"""Equations of splines against dense ones, and what is interpolated of what they leave."""

import numpy as np
import pytest

from plenopiv.tracking.remainder import LENGTH, SURE, Remainder
from plenopiv.tracking.splines import RIDGE, Equations, values_at
from plenopiv.tracking.unresolved import Unresolved

NODES, STEP, LOW = (5, 6, 4), 0.5, np.array([-1.0, 0.0, 2.0])


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def test_splines_are_one_in_all_and_their_derivatives_are_differences(rng):
    points = LOW + STEP * rng.uniform(0.01, 0.99, (50, 3)) * (np.array(NODES) - 3)
    assert values_at(points, LOW, STEP, NODES).sum(1) == pytest.approx(np.ones(50))
    for axis in range(3):
        move = 1e-5 * np.eye(3)[axis]
        ahead, behind = (values_at(points + s * move, LOW, STEP, NODES).toarray() for s in (1, -1))
        slopes = values_at(points, LOW, STEP, NODES, axis).toarray()
        assert slopes == pytest.approx((ahead - behind) / 2e-5, abs=1e-6)


def test_coefficients_solve_the_dense_equations(rng):
    points = LOW + STEP * rng.uniform(0.0, 1.0, (400, 3)) * (np.array(NODES) - 3)
    velocity, std = rng.standard_normal((400, 3)), rng.uniform(0.5, 2.0, (400, 3))
    values = values_at(points, LOW, STEP, NODES)
    equations, smoothing = Equations(values, std, NODES, False), 0.3
    found = equations.solution(velocity[None], smoothing)[0]
    dense, third = values.toarray(), np.zeros((np.prod(NODES),) * 2)
    of_axis = [np.diff(np.eye(count), 3, axis=0) for count in NODES[::-1]]
    for axis in range(3):
        each = [of_axis[a] if a == axis else np.eye(count) for a, count in enumerate(NODES[::-1])]
        whole = np.kron(np.kron(each[0], each[1]), each[2])
        third += whole.T @ whole
    unit = np.mean([((dense / std[:, [k]]) ** 2).sum(0).mean() for k in range(3)])
    assert equations.unit == pytest.approx(unit)
    for k in range(3):
        form = dense.T @ (dense / std[:, [k]] ** 2) + smoothing * unit * third + RIDGE * unit * np.eye(len(third))
        assert found[k] == pytest.approx(np.linalg.solve(form, dense.T @ (velocity[:, k] / std[:, k] ** 2)), abs=1e-7)


def test_the_remainder_is_simple_kriging(rng):
    """Against one system of all tracks, where these are as few as are taken at a point."""
    place, noise = rng.uniform(0.0, 1.0, (30, 3)), np.full((30, 3), 0.01)
    left = np.stack([np.sin(6 * place[:, 0]), 0.001 * rng.standard_normal(30), 0.1 * rng.standard_normal(30)], 1)
    points = rng.uniform(0.2, 0.8, (20, 3))
    found, chance, unknown = Remainder(place, left, noise, 0.3).at(points)
    beyond = left**2 - noise
    mean, own = beyond.mean(), beyond.mean(0)
    by_chance = SURE * 0.01 * np.sqrt(2 / 90), SURE * 0.01 * np.sqrt(2 / 30)  # of noise^2 without anything beyond
    variance = np.maximum(np.maximum(mean - by_chance[0], own - by_chance[1]), 0.0)
    assert variance.min() > 0.0

    def covariance(a, b):
        apart = np.linalg.norm(a[:, None] - b, axis=-1) / (LENGTH * 0.3)
        return (1.0 + apart) * np.exp(-apart)

    for k in range(3):
        form = variance[k] * covariance(place, place) + np.diag(noise[:, k])
        weights = np.linalg.solve(form, variance[k] * covariance(place, points))
        assert found[:, k] == pytest.approx(weights.T @ left[:, k])
        assert chance[:, k] == pytest.approx((weights.T**2) @ left[:, k] ** 2)
        assert unknown[:, k] == pytest.approx(1.0 - (weights * covariance(place, points)).sum(0))


def test_noise_alone_leaves_next_to_nothing(rng):
    place, noise = rng.uniform(0.0, 1.0, (3000, 3)), np.full((3000, 3), 0.04)
    found, chance, unknown = Remainder(place, 0.2 * rng.standard_normal((3000, 3)), noise, 0.07).at(place[:500])
    assert np.sqrt((found**2).mean()) < 0.05
    assert unknown.mean() > 0.9
    added = found != 0.0
    assert (chance[~added] == 0.0).all()
    assert 0.6 < np.sqrt(chance[added].mean() / (found[added] ** 2).mean()) < 1.4


def test_a_track_that_is_wrong_beside_its_neighbours_is_not_followed():
    """One in twenty is twenty standard deviations off, as near focus: nothing is made of it where it is not flow."""
    rng = np.random.default_rng(8)
    place = rng.uniform(0, 1, (2000, 3))
    noise = np.full((2000, 3), 0.01**2)
    left = 0.01 * rng.standard_normal((2000, 3))
    wrong = rng.random(2000) < 0.05
    left[wrong] += 0.2 * rng.choice([-1.0, 1.0], (wrong.sum(), 3))
    points = rng.uniform(0.1, 0.9, (400, 3))
    assert np.sqrt(np.mean(Remainder(place, left, noise, 0.08).at(points)[0] ** 2)) < 0.006
    wave = 0.2 * np.sin(2 * np.pi * place[:, :1] / 0.5)  # but where all depart, they are followed
    found, *_ = Remainder(place, left + wave, noise, 0.08).at(points)
    off = found - 0.2 * np.sin(2 * np.pi * points[:, :1] / 0.5)
    assert np.sqrt(np.median(off**2)) < 0.05


def test_what_is_not_resolved_is_what_is_believed_as_far_as_tracks_held_out_allow(rng):
    """Their squares are 1.5 beyond errors of variance 1, and half of the variance is untold."""
    place = rng.uniform(0.0, 1.0, (32, 3))
    explained, untold = np.ones((32, 3)), np.full((32, 3), 0.5)
    of_all = Unresolved(place, 2.5 * np.ones((32, 3)), explained, untold)
    chance = SURE * np.sqrt(2 / 96), SURE * np.sqrt(2 / 32)  # of the three components together, and of one
    least, most = 2 * (1.5 - chance[0]), 2 * (1.5 + chance[1])
    for believed, found in ((0.0, least), (3.0, 3.0), (9.0, most)):
        assert of_all.at(place[:1], believed) == pytest.approx(np.full((1, 3), found))
    none = Unresolved(place, 0.2 * np.ones((32, 3)), explained, untold)
    assert (none.at(place[:1], 9.0) == 0.0).all()
