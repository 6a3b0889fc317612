"""Particles that a fit takes for one: found by the second derivatives of their light."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded

from plenopiv.tracking.evidence import errors_of
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.light import UNIT_MM, PointLights, prior_std_mm
from plenopiv.tracking.pixels import with_noise
from plenopiv.tracking.refine import Prior, refine
from plenopiv.tracking.splits import STEP, crowded, equations, near_any, pairs, splits

OF_POINTS = PointLights(CAMERA)
ELECTRONS = 60_000.0


ALONE = [(-0.3, -0.3, 1.2), (0.3, -0.3, -1.7), (-0.3, 0.3, 2.1), (0.3, 0.3, -1.1)]


def fitted(pixels, position_mm, electrons):
    """Pixels with noise and stray light as measured, and particles fitted to them."""
    start, light = np.array(position_mm, np.float64), GAIN * np.array(electrons, np.float64)
    pixels = with_noise(pixels, OF_POINTS(start).image(light, len(pixels.counts)))
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
    found, offset = splits(fit, errors_of(fit, pixels.usable)[1], all_of(fit))
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
    _, off = errors_of(fit, pixels.usable)
    found, _ = splits(fit, off, crowded(fit, off))
    beyond = np.abs(truth.position_mm[:, 2]) > 0.5
    assert beyond.sum() > 10
    assert not beyond[found].any()


def test_only_those_asked_are_split():
    truth = np.array([[0.1, 0.1, 1.5], [0.1, 0.1, 1.7], *ALONE])
    pixels = pixels_of(noisy(truth, np.full(6, ELECTRONS)))
    pixels, fit = fitted(pixels, [truth[:2].mean(0), *ALONE], ELECTRONS * np.array([2, 1, 1, 1, 1]))
    found, offset = splits(fit, errors_of(fit, pixels.usable)[1], np.arange(5) > 0)
    assert found.shape == (0,)
    assert offset.shape == (0, 3)


def image(lights, values):
    return np.bincount(lights.pixel, values, CAMERA.sensor.rows * CAMERA.sensor.columns)


def terms_of(place):
    """The 11 terms (pixels, 11) in plain NumPy, of images of gradients at the places around; 0 where none lights."""
    here, around = OF_POINTS([place]), [OF_POINTS([place + STEP * axis * UNIT_MM]) for axis in np.eye(3)]
    first, *slopes = np.array(
        [[image(one, one.gradient[:, k]) * UNIT_MM[k] for k in range(3)] for one in (here, *around)]
    )
    bends = (np.array(slopes) - first) / STEP  # by axis, of slopes along axes
    lit = np.zeros(first.shape[-1], bool)
    lit[np.concatenate([here.pixel, *(one.pixel for one in around)])] = True
    both = [bends[i, j] + bends[j, i] for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.stack(
        [lit / lit.sum(), image(here, here.share), *first, bends[0, 0], bends[1, 1], bends[2, 2], *both], -1
    )


def test_second_derivatives_are_differences_of_shares():
    place, wide = np.array([0.05, -0.11, 1.9]), 0.3
    terms = terms_of(place)

    def share(at_mm):
        lights = OF_POINTS([at_mm])
        return image(lights, lights.share)

    for k, axis in enumerate(np.eye(3)):
        move = wide * axis * UNIT_MM
        difference = (share(place + move) - 2 * share(place) + share(place - move)) / wide**2
        assert np.linalg.norm(terms[:, 5 + k] - difference) < 0.25 * np.linalg.norm(difference)
        first = (share(place + move) - share(place - move)) / (2 * wide)
        assert np.linalg.norm(terms[:, 2 + k] - first) < 0.2 * np.linalg.norm(first)
    across, deep = wide * UNIT_MM * [1, 0, 0], wide * UNIT_MM * [0, 0, 1]
    corners = [share(place + a * across + b * deep) * a * b for a in (-1, 1) for b in (-1, 1)]
    mixed = sum(corners) / (4 * wide**2)
    assert np.linalg.norm(terms[:, 9] / 2 - mixed) < 0.35 * np.linalg.norm(mixed)


def test_equations_are_those_of_dense_terms():
    pixels = pixels_of(noisy(np.array(ALONE), np.full(4, ELECTRONS)))
    _, fit = fitted(pixels, ALONE, np.full(4, 0.9 * ELECTRONS))
    which = np.array([1, 3])
    normal, right = equations(fit, which)
    for n, particle in enumerate(which):
        weighed = terms_of(fit.position_mm[particle]) * fit.light[particle] * fit.weight[:, None]
        whole = weighed.T @ weighed
        scale = np.sqrt(np.diag(whole))
        assert normal[n] / scale / scale[:, None] == pytest.approx(whole / scale / scale[:, None], abs=2e-3)
        assert right[n] / scale == pytest.approx(weighed.T @ (fit.residual * fit.weight) / scale, abs=0.05)


def test_a_pair_is_read_off_its_second_derivatives():
    rng = np.random.default_rng(5)
    terms, half = rng.normal(size=(400, 11)), np.array([0.3, -0.5, 1.4])
    outer = 0.5 * np.outer(half, half)
    of_pair = np.array([outer[0, 0], outer[1, 1], outer[2, 2], outer[0, 1], outer[0, 2], outer[1, 2]])
    two, narrow = terms @ [0.7, 0.2, 0.1, -0.3, 0.4, *of_pair], -terms[:, 5:] @ of_pair
    normal = np.stack([terms.T @ terms] * 2)
    gain, found = pairs(normal, np.stack([terms.T @ two, terms.T @ narrow]))
    assert min(np.abs(found[0] - half).max(), np.abs(found[0] + half).max()) < 1e-3
    assert gain == pytest.approx(((terms[:, 5:] @ of_pair) ** 2).sum(), rel=0.1)
    assert np.isnan(found[1]).all()  # what is too narrow is no pair


def test_places_near_any_other():
    places = np.array([[0.0, 0, 0], [0.02, 0, 0], [0, 0, 0.04]])
    assert near_any(places, np.empty((0, 3)), UNIT_MM).tolist() == [False] * 3
    assert near_any(places, np.array([[0.001, 0, 0]]), UNIT_MM).tolist() == [True, False, True]
