"""A frame from predicted positions: particles that are there, have left, have entered, and near focus."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.shaken import particles_of_prediction

OFF = np.array([0.1, 0.1, 0.2])  # voxels, of predictions
LIGHT = GAIN * 400.0 * 150.0


@pytest.fixture(scope="module")
def of_points():
    return PointLights(CAMERA)


@pytest.fixture(scope="module")
def shaken(of_points):
    """Particles at 0.6 ppm; of those predicted the first six have left, the last six true ones have just entered, and
    all are a quarter brighter than predicted."""
    truth = seeded(0.6)
    counts = noisy(truth.position_mm, truth.electrons)
    rng = np.random.default_rng(1)
    known = np.arange(len(truth.electrons) - 6)
    gone = rng.uniform(*np.transpose(LIMITS), (6, 3))
    place = truth.position_mm[known] + rng.normal(size=(len(known), 3)) * OFF * VOXEL_MM
    position = np.concatenate([gone, place])
    light = 0.8 * np.concatenate([np.full(6, LIGHT), GAIN * truth.electrons[known]])
    std = np.broadcast_to(OFF * VOXEL_MM, position.shape)
    return truth, particles_of_prediction(of_points, pixels_of(counts), position, std, light, LIMITS)


def test_predicted_particles_are_found_and_keep_their_names(of_points, shaken):
    truth, (found, origin) = shaken
    judged = (np.abs(truth.position_mm[:, 2]) > 0.46) & (of_points(truth.position_mm).whole() > 0.999)
    partner = nearest(truth.position_mm, found.position_mm)
    assert (partner[judged] >= 0).mean() > 0.95
    both = np.flatnonzero(judged & (partner >= 0))
    expected = np.where(both < len(truth.electrons) - 6, both + 6, -1)
    assert (origin[partner[both]] == expected).mean() > 0.95
    error = (found.position_mm[partner[both]] - truth.position_mm[both]) / VOXEL_MM
    assert (np.sqrt((error**2).mean(0)) < (0.03, 0.03, 0.06)).all()
    std = np.sqrt(np.einsum("nii->ni", found.covariance))[partner[both], :3] / VOXEL_MM
    assert 0.55 < (np.abs(error) < std).mean() < 0.85
    assert np.median(found.light[partner[both]] / (GAIN * truth.electrons[both])) == pytest.approx(1.0, abs=0.01)


def test_those_that_have_left_are_not_there(shaken):
    _, (_, origin) = shaken
    assert np.isin(np.arange(6), origin).sum() == 0


def test_nothing_predicted_and_nothing_there(of_points):
    pixels = pixels_of(noisy(np.zeros((1, 3)), np.zeros(1)))
    for n in (0, 2):
        position = np.full((n, 3), 0.1) * (1, -1, 10)
        with pytest.raises(PlenoPIVError, match="the pixels speak for no particle"):
            particles_of_prediction(of_points, pixels, position, np.full((n, 3), 0.01), np.full(n, LIGHT), LIMITS)


def test_what_pixels_say_does_not_depend_on_the_prediction(of_points):
    """A particle alone, predicted well, badly, and with little certainty: position and information of the pixels are
    the same, whatever the prior has done to the fit."""
    place = np.array([[0.03, -0.05, 1.2]])
    pixels = pixels_of(noisy(place, np.array([60_000.0])))
    said = []
    for off, std in ((0.0, 3e-4), (5e-4, 3e-4), (1e-3, 1e-2)):
        start = place + off * np.array([1.0, -1.0, 4.0])
        widths = std * np.array([[1.0, 1.0, 4.0]])
        found, _ = particles_of_prediction(of_points, pixels, start, widths, np.array([GAIN * 60_000.0]), LIMITS)
        information, pull = found.information[0], found.pull[0]
        said.append((found.position_mm[0] + np.linalg.solve(information, pull), information))
    std = np.sqrt(np.diag(np.linalg.inv(said[2][1])))
    for position, information in said[:2]:
        assert np.abs((position - said[2][0]) / std).max() < 0.35
        assert information == pytest.approx(said[2][1], rel=0.1, abs=0.05 * np.abs(said[2][1]).max())
    assert np.abs((said[2][0] - place[0]) / std).max() < 4


def test_near_focus_depth_is_the_predicted_one(of_points):
    """All light under one microlens: the fit leaves depth where the track has it, and pixels claim nothing of it."""
    i, j = 0, 0
    centre = np.array(CAMERA.lattice.centres(i, j)).ravel() / CAMERA.scale(0.05)
    place = np.array([[*centre, 0.05]])
    pixels = pixels_of(noisy(place, np.array([60_000.0])))
    std = np.array([[2e-3, 2e-3, 1e-2]])
    start = place + np.array([[1e-3, 0.0, 8e-3]])
    found, origin = particles_of_prediction(of_points, pixels, start, std, np.array([GAIN * 60_000.0]), LIMITS)
    own = np.flatnonzero(origin == 0)[0]
    assert found.position_mm[own, 2] == pytest.approx(start[0, 2], abs=3e-3)
    assert found.covariance[own, 2, 2] ** 0.5 == pytest.approx(1e-2, rel=0.3)
    assert found.information[own, 2, 2] < 0.3 / 1e-2**2


def test_small_steps_of_light_follow_the_derivatives(of_points):
    """Light of moved points by derivatives against computed anew: the difference is of second order."""
    places = np.array([[0.03, -0.05, 1.2], [-0.1, 0.08, -2.0], [0.2, 0.1, 0.6]])
    lights, which = of_points(places), np.array([2, 0])
    n, errors = CAMERA.sensor.rows * CAMERA.sensor.columns, []
    for step in (1e-3, 5e-4):
        by = step * np.array([[1.0, -0.5, 2.0], [-1.0, 1.0, 3.0]])
        moved = places.copy()
        moved[which] += by
        shifted = lights.shifted(which, by)
        errors.append(np.abs(shifted.image(np.ones(3), n) - of_points(moved).image(np.ones(3), n)).sum())
        assert np.abs(lights.image(np.ones(3), n) - of_points(moved).image(np.ones(3), n)).sum() > 5 * errors[-1]
    assert errors[1] < 0.45 * errors[0]
    assert (lights.share == of_points(places).share).all()
