"""Which particles without evidence go first, of those that are coupled."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, noisy, pixels_of

from plenopiv.tracking.covariance import covariance_of
from plenopiv.tracking.evidence import LEAST, misfit, weakest_first, without_evidence
from plenopiv.tracking.light import PointLights, prior_std_mm
from plenopiv.tracking.refine import Prior, refine

OF_POINTS = PointLights(CAMERA)
ELECTRONS = 60_000.0


def equations(columns):
    """Normal equations of particles' derivatives (pixels, 4 a particle), each over its pixel's standard deviation."""
    return columns.T @ columns


def alone(columns):
    """By how much chi^2 rises without the light of the first of particles, in units of its own, all else free."""
    light, rest = columns[:, 3], np.delete(columns, 3, 1)
    return float(np.linalg.norm(light - rest @ np.linalg.lstsq(rest, light, rcond=None)[0]) ** 2)


def test_two_in_the_place_of_one_leave_one():
    one = np.random.default_rng(0).normal(size=(50, 4)) * 3.0
    assert alone(one) > LEAST
    near = one + 1e-3 * np.random.default_rng(1).normal(size=one.shape)
    assert weakest_first(equations(np.hstack([one, near])), np.ones(2)).sum() == 1
    assert weakest_first(equations(np.hstack([0.5 * one, one])), np.ones(2)).tolist() == [True, False]


def test_a_swarm_is_halved_each_time_and_the_brightest_stays():
    one = np.random.default_rng(0).normal(size=(60, 4)) * 3.0
    light = np.array([1.0, 0.1, 0.2, 0.05, 0.02, 0.3, 0.01, 0.15])
    noise = np.random.default_rng(1).normal(size=(8, 60, 4))
    columns = [e * (one + 0.02 * each) for e, each in zip(light, noise, strict=True)]
    left = np.arange(8)
    for expected in (4, 2, 1):
        gone = weakest_first(equations(np.hstack([columns[n] for n in left])), np.ones(len(left)))
        left = left[~gone]
        assert len(left) == expected
        assert 0 in left


def test_no_more_go_than_there_is_no_evidence_for():
    """Of three the last two are one: with either of them gone, the other has evidence, by a misfit of 1; at one so
    large that it has none, one of three still stays."""
    first, second = np.random.default_rng(2).normal(size=(2, 80, 4)) * 2.0
    columns = np.hstack([first, second, second * 1.01])
    assert weakest_first(equations(columns), np.ones(3)).tolist() == [False, True, False]
    assert alone(np.hstack([first, second])) > LEAST
    assert weakest_first(equations(columns), np.full(3, 100.0)).sum() == 2


def test_a_swarm_in_a_frame_goes_and_the_particle_stays():
    """Twelve faint ones about a particle, whose places no pixel tells."""
    place = np.array([[0.06, -0.04, 1.9], [-0.25, 0.2, -1.4]])
    pixels = pixels_of(noisy(place, np.full(2, ELECTRONS)))
    swarm = place[0] + np.random.default_rng(3).normal(0.0, (2e-3, 2e-3, 1e-2), (12, 3))
    position = np.concatenate([place, swarm])
    light = GAIN * ELECTRONS * np.concatenate([np.ones(2), np.full(12, 1e-3)])
    prior = Prior(position, prior_std_mm(CAMERA))
    left = np.arange(len(light))
    for _ in range(4):
        fit = refine(OF_POINTS, pixels, position[left], light[left], prior.of(left), 0)
        out = without_evidence(fit, covariance_of(fit), misfit(fit, pixels.usable))
        left = left[~out]
    assert left.tolist() == [0, 1]
    assert (np.abs(position) < np.array(LIMITS)[:, 1]).all()


@pytest.mark.parametrize("count", [1, 5])
def test_all_that_is_told_stays(count):
    place = np.random.default_rng(count).uniform(-0.3, 0.3, (count, 3)) * (1, 1, 4) + (0, 0, 1.5)
    pixels = pixels_of(noisy(place, np.full(count, ELECTRONS)))
    light = np.full(count, GAIN * ELECTRONS)
    fit = refine(OF_POINTS, pixels, place, light, Prior(place, prior_std_mm(CAMERA)), 2)
    assert not without_evidence(fit, covariance_of(fit), misfit(fit, pixels.usable)).any()
