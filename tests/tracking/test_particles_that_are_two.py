"""Particles that a fit takes for one: found by the second derivatives of their light."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded

from plenopiv.tracking.evidence import misfit
from plenopiv.tracking.frame import particles_of_frame, with_noise
from plenopiv.tracking.light import UNIT_MM, PointLights, prior_std_mm
from plenopiv.tracking.refine import Prior, refine
from plenopiv.tracking.splits import STEP, _derivatives, _pair, crowded, near_any, splits

OF_POINTS = PointLights(CAMERA)
ELECTRONS = 60_000.0


ALONE = [(-0.3, -0.3, 1.2), (0.3, -0.3, -1.7), (-0.3, 0.3, 2.1), (0.3, 0.3, -1.1)]


def fitted(pixels, position_mm, electrons):
    """Pixels with noise and stray light as measured, and particles fitted to them."""
    start, light = np.array(position_mm, np.float64), GAIN * np.array(electrons, np.float64)
    pixels = with_noise(pixels, OF_POINTS(start), light)
    return pixels, refine(OF_POINTS, pixels, start, light, Prior(start, prior_std_mm(CAMERA)), 6)


def all_of(fit):
    return np.ones(len(fit.light), bool)


@pytest.mark.parametrize("apart", [(0, 0, 3.0), (1.2, -0.9, 0.5), (0.6, 0.7, -2.2)], ids=str)
@pytest.mark.parametrize("z_mm", [-2.1, 1.3])
def test_two_that_are_fitted_as_one(apart, z_mm):
    middle, half = np.array([0.06, -0.04, z_mm]), 0.5 * VOXEL_MM * apart
    truth = np.stack([middle + half, middle - half, *ALONE])
    pixels = pixels_of(noisy(truth, np.full(6, ELECTRONS)))
    start, electrons = np.stack([middle, *ALONE]), ELECTRONS * np.array([2, 1, 1, 1, 1])
    pixels, fit = fitted(pixels, start, electrons)
    found, offset = splits(OF_POINTS, fit, misfit(fit, pixels.usable), all_of(fit))
    assert found.tolist() == [0]
    along = half / UNIT_MM
    cosine = offset[0] / UNIT_MM @ along / np.linalg.norm(offset[0] / UNIT_MM) / np.linalg.norm(along)
    assert abs(cosine) > 0.8
    both = particles_of_frame(OF_POINTS, pixels, start, GAIN * electrons, LIMITS)
    assert len(both.light) == 6
    off = (both.position_mm[nearest(truth, both.position_mm)] - truth) / VOXEL_MM
    assert np.abs(off).max() < 0.3
    assert both.light == pytest.approx(GAIN * ELECTRONS, rel=0.1)


def test_particles_that_stand_alone_stay_one():
    truth = seeded(0.2)
    pixels = pixels_of(noisy(truth.position_mm, truth.electrons))
    pixels, fit = fitted(pixels, truth.position_mm, truth.electrons)
    off = misfit(fit, pixels.usable)
    found, _ = splits(OF_POINTS, fit, off, crowded(fit, off))
    beyond = np.abs(truth.position_mm[:, 2]) > 0.5
    assert beyond.sum() > 10
    assert not beyond[found].any()


def test_only_those_asked_are_split():
    truth = np.array([[0.1, 0.1, 1.5], [0.1, 0.1, 1.7], *ALONE])
    pixels = pixels_of(noisy(truth, np.full(6, ELECTRONS)))
    pixels, fit = fitted(pixels, [truth[:2].mean(0), *ALONE], ELECTRONS * np.array([2, 1, 1, 1, 1]))
    found, offset = splits(OF_POINTS, fit, misfit(fit, pixels.usable), np.arange(5) > 0)
    assert found.shape == (0,)
    assert offset.shape == (0, 3)


def test_second_derivatives_are_differences_of_shares():
    place = np.array([0.05, -0.11, 1.9])
    steps = STEP * np.concatenate([np.diag(UNIT_MM), -np.diag(UNIT_MM)])
    here = OF_POINTS([place])
    pixel, terms = _derivatives(here, 0, OF_POINTS(place + steps), 0)

    def image(at_mm):
        lights = OF_POINTS([at_mm])
        return np.bincount(lights.pixel, lights.share, CAMERA.sensor.rows * CAMERA.sensor.columns)[pixel]

    wide = 0.6
    for k, axis in enumerate(np.eye(3)):
        move = wide * axis * UNIT_MM
        difference = (image(place + move) - 2 * image(place) + image(place - move)) / wide**2
        assert np.linalg.norm(terms[:, 5 + k] - difference) < 0.25 * np.linalg.norm(difference)
        first = (image(place + move) - image(place - move)) / (2 * wide)
        assert np.linalg.norm(terms[:, 2 + k] - first) < 0.2 * np.linalg.norm(first)
    across, deep = 0.6 * UNIT_MM * [1, 0, 0], 0.6 * UNIT_MM * [0, 0, 1]
    corners = [image(place + a * across + b * deep) * a * b for a in (-1, 1) for b in (-1, 1)]
    mixed = sum(corners) / (4 * wide**2)
    assert np.linalg.norm(terms[:, 9] / 2 - mixed) < 0.35 * np.linalg.norm(mixed)


def test_a_pair_is_read_off_its_second_derivatives():
    rng = np.random.default_rng(5)
    terms, half = rng.normal(size=(400, 11)), np.array([0.3, -0.5, 1.4])
    outer = 0.5 * np.outer(half, half)
    of_pair = [outer[0, 0], outer[1, 1], outer[2, 2], outer[0, 1], outer[0, 2], outer[1, 2]]
    left = terms @ [0.7, 0.2, 0.1, -0.3, 0.4, *of_pair]
    gain, found = _pair(terms, left)
    assert found is not None
    assert min(np.abs(found - half).max(), np.abs(found + half).max()) < 1e-3
    assert gain == pytest.approx(((terms[:, 5:] @ of_pair) ** 2).sum(), rel=0.1)
    less = -np.array(of_pair)
    assert _pair(terms, terms[:, 5:] @ less)[1] is None  # what is too narrow is no pair


def test_places_near_any_other():
    places = np.array([[0.0, 0, 0], [0.02, 0, 0], [0, 0, 0.04]])
    assert near_any(places, np.empty((0, 3)), UNIT_MM).tolist() == [False] * 3
    assert near_any(places, np.array([[0.001, 0, 0]]), UNIT_MM).tolist() == [True, False, True]
