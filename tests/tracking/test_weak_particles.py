"""Which particles without evidence go first, of those that are coupled."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, noisy, pixels_of, seeded
from scipy.sparse import bsr_array

from plenopiv.tracking import areas, covariance
from plenopiv.tracking.alone import lowers
from plenopiv.tracking.covariance import covariance_among
from plenopiv.tracking.evidence import LEAST, doubtful, errors_of, without_evidence
from plenopiv.tracking.light import UNIT_MM, PointLights, prior_std_mm
from plenopiv.tracking.refine import Effort, Prior, refine

OF_POINTS = PointLights(CAMERA)
TOLD = Effort(told=True)
ELECTRONS = 60_000.0
PLACE = np.array([[0.06, -0.04, 1.9], [-0.25, 0.2, -1.4]])


def left_of(position, share, passes):
    """The particles at ``position`` that are left after some passes, of light that is a ``share`` of those that there
    are; nothing moves."""
    pixels = pixels_of(noisy(PLACE, np.full(len(PLACE), ELECTRONS)))
    light, prior = GAIN * ELECTRONS * np.asarray(share), Prior(position, prior_std_mm(CAMERA))
    left = np.arange(len(light))
    for _ in range(passes):
        fit = refine(OF_POINTS, pixels, position[left], light[left], prior.of(left), 0)
        out = without_evidence(fit, *errors_of(fit, pixels.usable))
        left = left[~out]
    return left.tolist()


def test_evidence_alone_is_what_light_explains_that_places_do_not():
    columns = np.random.default_rng(0).normal(size=(3, 60, 4))
    own = np.einsum("npi,npj->nij", columns, columns)
    normal = bsr_array((own, np.arange(3), np.arange(4)), shape=(12, 12))
    for n, found in enumerate(lowers(covariance_among(normal, np.arange(3), 0), np.array([1.0, 1.0, 4.0]))):
        light, rest = columns[n][:, 3], columns[n][:, :3]
        explained = np.linalg.norm(light - rest @ np.linalg.lstsq(rest, light, rcond=None)[0]) ** 2
        assert found == pytest.approx(explained / (4.0 if n == 2 else 1.0), rel=1e-3)


def test_a_swarm_goes_at_once_and_the_particle_stays():
    """Twelve faint ones about a particle, whose places no pixel tells."""
    swarm = PLACE[0] + np.random.default_rng(3).normal(0.0, (2e-3, 2e-3, 1e-2), (12, 3))
    position, share = np.concatenate([PLACE, swarm]), np.concatenate([np.ones(2), np.full(12, 1e-3)])
    assert left_of(position, share, 1) == [0, 1]


def test_of_two_in_the_place_of_one_the_weaker_goes():
    """Each would have evidence without the other."""
    position = np.stack([PLACE[0] + (0, 0, 2e-4), *PLACE])
    assert left_of(position, [0.4, 0.6, 1.0], 1) == [1, 2]
    assert left_of(position, [0.6, 0.4, 1.0], 3) == [0, 2]


def test_of_a_group_that_is_bright_one_goes_after_the_other():
    swarm = PLACE[0] + np.random.default_rng(5).normal(0.0, (1e-4, 1e-4, 5e-4), (3, 3))
    position, share = np.concatenate([swarm, PLACE[1:]]), [0.3, 0.25, 0.45, 1.0]
    assert [len(left_of(position, share, passes)) for passes in (1, 2, 3)] == [3, 2, 2]
    assert left_of(position, share, 3) == [2, 3]


def test_all_that_is_told_stays():
    assert left_of(PLACE, [1.0, 1.0], 2) == [0, 1]
    assert LEAST > 18.5  # chi^2 of four degrees of freedom is above that once in a thousand


def test_many_weak_particles_are_judged_an_area_at_a_time(monkeypatch):
    """To the same end as all at once, those about an area being known."""
    rng, truth = np.random.default_rng(4), seeded(0.5)
    place, bright = truth.position_mm, GAIN * truth.electrons
    pixels = pixels_of(noisy(place, truth.electrons))
    seconds = place + rng.normal(0.0, (2e-3, 2e-3, 1e-2), place.shape)
    position, light = np.concatenate([place, seconds]), np.concatenate([0.4 * bright, 0.6 * bright])
    fit = refine(OF_POINTS, pixels, position, light, Prior(position, prior_std_mm(CAMERA)), 0)
    judged = errors_of(fit, pixels.usable)
    whole = [without_evidence(fit, *judged, swarms=swarms) for swarms in (False, True)]
    assert whole[0].sum() > 10
    monkeypatch.setattr(covariance, "TOGETHER", 10)
    for swarms in (False, True):
        np.testing.assert_array_equal(without_evidence(fit, *judged, swarms=swarms), whole[swarms])


def test_who_lacks_evidence_is_doubtful_and_most_others_are_not():
    """Particles, as many ghosts of a few counts, and seconds in the places of some."""
    rng, truth = np.random.default_rng(2), seeded(0.3)
    place, bright = truth.position_mm, GAIN * truth.electrons
    pixels = pixels_of(noisy(place, truth.electrons))
    ghosts = rng.uniform(place.min(0), place.max(0), place.shape)
    seconds = place[::6] + rng.normal(0.0, (2e-3, 2e-3, 1e-2), place[::6].shape)
    light = np.concatenate([bright, np.full(len(ghosts), 1e-3 * bright.mean()), 0.5 * bright[::6]])
    light[: len(bright) : 6] *= 0.5
    position = np.concatenate([place, ghosts, seconds])
    fit = refine(OF_POINTS, pixels, position, light, Prior(position, prior_std_mm(CAMERA)), 0, TOLD)
    which = np.arange(len(light))[3:]
    covariance, off = errors_of(fit, pixels.usable, which=which)
    doubt = doubtful(fit, which)
    np.testing.assert_allclose(fit.told[which, 0], off, rtol=1e-12)
    weak = lowers(covariance, off) < LEAST
    assert weak.sum() > len(ghosts)
    assert doubt[weak].all()
    alone = np.ones(len(light), bool)
    alone[len(bright) :], alone[: len(bright) : 6] = False, False
    assert doubt[alone[3:]].mean() < 0.5


def test_a_bright_particle_is_doubtful_for_its_neighbour_alone():
    position = np.stack([*PLACE, PLACE[0] + (0, 0, 0.3)])
    pixels = pixels_of(noisy(position, np.full(3, ELECTRONS)))
    prior = Prior(position, prior_std_mm(CAMERA))
    fit = refine(OF_POINTS, pixels, position, np.full(3, GAIN * ELECTRONS), prior, 0, TOLD)
    assert doubtful(fit, np.arange(3)).tolist() == [True, False, True]
    assert doubtful(fit, np.array([2])).tolist() == [True]


def test_what_particles_say_by_themselves_is_told_by_areas_as_at_once(monkeypatch):
    truth = seeded(0.5)
    pixels, light = pixels_of(noisy(truth.position_mm, truth.electrons)), GAIN * truth.electrons
    prior = Prior(truth.position_mm, prior_std_mm(CAMERA))
    whole = refine(OF_POINTS, pixels, truth.position_mm, light, prior, 40, TOLD)
    assert refine(OF_POINTS, pixels, truth.position_mm, light, prior, 1).told.shape == (0, 2)
    monkeypatch.setattr(areas, "TOGETHER", 20)
    parts = refine(OF_POINTS, pixels, truth.position_mm, light, prior, 40, TOLD)
    near = (np.abs(parts.position_mm - whole.position_mm) < 0.1 * UNIT_MM).all(1)
    assert near.mean() > 0.8
    assert parts.told[near] == pytest.approx(whole.told[near], rel=0.05)
    assert whole.told[near, 1].std() > 0.2 * whole.told[near, 1].mean()
