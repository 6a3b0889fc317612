"""Links of two frames, from particles whose places are known."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.simulation.flows import flow
from plenopiv.tracking import links as linking
from plenopiv.tracking.expected import expected as expected_in
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import GATE, link

DT_S = 5e-4
STD_MM = np.array([0.0004, 0.0004, 0.002])
FLOW = flow("rotation", rate_rad_s=80.0, drift_m_s=(0.02, 0.1, -0.03))
SCATTER_MM = np.array([0.012, 0.012, 0.05])


def particles(position, light, seed):
    rng = np.random.default_rng(seed)
    covariance = np.zeros((len(light), 4, 4))
    for k, std in enumerate((*STD_MM, 0.01)):
        covariance[:, k, k] = std**2 if k < 3 else (std * light) ** 2
    off = rng.normal(size=position.shape) * STD_MM
    return FrameParticles(
        position + off, light * (1 + 0.01 * rng.normal(size=len(light))), covariance, light * 0 + 1, 1
    )


@pytest.fixture(scope="module")
def frames():
    """1500 particles, the second frame in another order, each frame without some of the other's."""
    rng = np.random.default_rng(5)
    a = rng.uniform((-1.5, -1.5, -2.5), (1.5, 1.5, 2.5), (1500, 3))
    light = np.exp(0.25 * rng.normal(size=1500))
    b = a + 1e3 * DT_S * FLOW(a)
    kept_a, kept_b = np.arange(0, 1470), rng.permutation(np.arange(30, 1500))
    return kept_a, kept_b, particles(a[kept_a], light[kept_a], 1), particles(b[kept_b], 0.8 * light[kept_b], 2)


def predictor(points_mm):
    """What correlation finds: too slow by a tenth, and off at the edges."""
    return 0.9e3 * DT_S * FLOW(points_mm) + 0.01 * points_mm[:, :1] ** 2 * np.array([0.0, 1.0, 0.0])


def test_links_are_right_and_complete(frames):
    kept_a, kept_b, first, second = frames
    links = link(first, second, predictor, SCATTER_MM, 1.0)
    right = kept_a[links.a] == kept_b[links.b]
    assert right.mean() > 0.995
    assert right.sum() > 0.97 * 1440
    assert len(np.unique(links.a)) == len(np.unique(links.b)) == len(links.a)
    assert (links.scatter_mm < SCATTER_MM).all()


def test_candidates_are_all_within_the_gate_and_held_some_at_a_time(frames, monkeypatch):
    *_, first, second = frames
    covariance = second.covariance.copy()
    covariance[::40, 2, 2] = 0.5**2  # near focus pixels tell no depth
    second = replace(second, covariance=covariance)
    expected, scatter = predictor(first.position_mm), np.broadcast_to(SCATTER_MM, first.position_mm.shape)
    found = linking._within(first, second, expected, scatter)
    off = second.position_mm[None] - (first.position_mm + expected)[:, None]
    first_var, second_var = (np.einsum("nii->ni", each.covariance)[:, :3] for each in (first, second))
    every = (off**2 <= GATE * (SCATTER_MM**2 + first_var[:, None] + second_var[None])).all(2)
    assert set(zip(*(each.tolist() for each in found), strict=True)) == set(map(tuple, np.argwhere(every).tolist()))
    monkeypatch.setattr(linking, "AT_A_TIME", 7)
    assert all(
        (one == other).all()
        for one, other in zip(found, linking._within(first, second, expected, scatter), strict=True)
    )


def test_no_particle_moves_farther_than_stated(frames):
    *_, first, second = frames
    links = link(first, second, predictor, SCATTER_MM, 0.1)
    moved = second.position_mm[links.b] - first.position_mm[links.a]
    assert 100 < len(links.a) < 1400
    assert np.linalg.norm(moved, axis=1).max() <= 0.1


def test_nothing_to_link(frames):
    *_, first, second = frames
    away = FrameParticles(second.position_mm + 50.0, second.light, second.covariance, second.misfit, 1.0)
    assert len(link(first, away, predictor, SCATTER_MM, 1.0).a) == 0
    empty = FrameParticles(np.empty((0, 3)), np.empty(0), np.empty((0, 4, 4)), np.empty(0), 1.0)
    assert len(link(empty, second, predictor, SCATTER_MM, 1.0).a) == 0
    assert len(link(first, empty, predictor, SCATTER_MM, 1.0).a) == 0


@pytest.mark.parametrize("gap_mm", [0.02, 0.3])
def test_two_that_might_be_each_other_are_not_linked(gap_mm):
    """Pairs of particles in flow that the predictor misses by 0.05 mm: which is which is told where they are far
    apart."""
    rng = np.random.default_rng(1)
    middle, along = rng.uniform(-30.0, 30.0, (300, 3)), rng.normal(size=(300, 3))
    half = 0.5 * gap_mm * along / np.linalg.norm(along, axis=1, keepdims=True)
    a, moves = np.concatenate([middle + half, middle - half]), np.array([0.1, -0.05, 0.2])
    b = a + moves + 0.05 * rng.normal(size=a.shape)
    light = np.ones(len(a))
    links = link(
        particles(a, light, 1),
        particles(b, light, 2),
        lambda at: np.broadcast_to(moves, at.shape),
        np.full(3, 0.05),
        1.0,
    )
    right = links.a == links.b
    if gap_mm < 0.05:
        assert len(right) < 0.1 * len(a)
    else:
        assert right.sum() > 0.9 * len(a)
        assert right.mean() > 0.99


def test_particles_of_which_something_is_not_known_are_not_linked(frames):
    """One of them had ended in an error of SciPy's, or taken the links of all with it."""
    *_, first, second = frames
    position, light, covariance = first.position_mm.copy(), first.light.copy(), first.covariance.copy()
    position[3, 2], light[4:7], covariance[7, 0, 0] = np.nan, (np.nan, 0.0, -1.0), np.inf
    odd = replace(first, position_mm=position, light=light, covariance=covariance)
    others = np.setdiff1d(np.arange(len(light)), range(3, 8))
    expected = link(first.of(others), second, predictor, SCATTER_MM, 1.0)
    found = link(odd, second, predictor, SCATTER_MM, 1.0)
    assert (found.a == others[expected.a]).all()
    assert (found.b == expected.b).all()
    assert (found.cost == expected.cost).all()
    back = link(second, odd, lambda at: -predictor(at), SCATTER_MM, 1.0)
    assert len(back.b) > 0.9 * len(second.light)
    assert not np.isin(back.b, range(3, 8)).any()


def test_particles_beyond_the_predictor_are_not_linked(frames):
    *_, first, second = frames

    def within(at):
        return np.where(at[:, :1] > 0.5, np.nan, predictor(at))

    found = link(first, second, within, SCATTER_MM, 1.0)
    assert len(found.a) > 0.9 * (first.position_mm[:, 0] < 0.5).sum()
    assert first.position_mm[found.a, 0].max() <= 0.5
    position, light = expected_in(first, second.position_mm, second.light, within, SCATTER_MM, 1.0)
    assert np.isfinite(position).all()
    assert len(position) == len(light) >= len(second.light)
    nowhere = link(first, second, lambda at: np.full_like(at, np.nan), SCATTER_MM, 1.0)
    assert len(nowhere.a) == 0
