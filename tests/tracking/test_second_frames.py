"""The second frame of a pair, from where the particles of the first one are expected in it."""

import numpy as np
import pytest
from particle_scenes import CAMERA, GAIN, LIMITS, VOXEL_MM, nearest, noisy, pixels_of, seeded

from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.frame import particles_of_second_frame
from plenopiv.tracking.light import PointLights

LIGHT = GAIN * 400.0 * 150.0
OFF = np.array([0.5, -0.5, 0.5])  # voxels, the same of all: what correlation may be wrong by


@pytest.fixture(scope="module")
def of_points():
    return PointLights(CAMERA)


@pytest.fixture(scope="module")
def second(of_points):
    """Particles at 0.6 ppm; of those expected the first six have left, the last six true ones have just entered, and
    all are a quarter brighter than they were."""
    truth = seeded(0.6)
    pixels = pixels_of(noisy(truth.position_mm, truth.electrons))
    rng = np.random.default_rng(1)
    known = np.arange(len(truth.electrons) - 6)
    gone = rng.uniform(*np.transpose(LIMITS), (6, 3))
    scatter = rng.normal(0.0, 0.2, (len(known), 3))
    expected = np.concatenate([gone, truth.position_mm[known] + (OFF + scatter) * VOXEL_MM])
    light = 0.8 * np.concatenate([np.full(6, LIGHT), GAIN * truth.electrons[known]])
    return truth, expected, particles_of_second_frame(of_points, pixels, expected, light, LIMITS)


def test_all_are_found_wherever_they_were_expected(of_points, second):
    truth, _, found = second
    judged = (np.abs(truth.position_mm[:, 2]) > 0.46) & (of_points(truth.position_mm).whole() > 0.999)
    partner = nearest(truth.position_mm, found.position_mm)
    assert (partner[judged] >= 0).mean() > 0.97
    both = np.flatnonzero(judged & (partner >= 0))
    assert (both >= len(truth.electrons) - 6).sum() >= 3  # of those that have entered
    error = (found.position_mm[partner[both]] - truth.position_mm[both]) / VOXEL_MM
    assert (np.sqrt((error**2).mean(0)) < (0.03, 0.03, 0.06)).all()
    assert (np.abs(error.mean(0)) < (0.01, 0.01, 0.02)).all()  # nothing of OFF is left
    std = np.sqrt(np.einsum("nii->ni", found.covariance))[partner[both], :3] / VOXEL_MM
    assert 0.55 < (np.abs(error) < std).mean() < 0.85
    assert np.median(found.light[partner[both]] / (GAIN * truth.electrons[both])) == pytest.approx(1.0, abs=0.01)
    beyond = (np.abs(found.position_mm[:, 2]) > 0.46) & (of_points(found.position_mm).whole() > 0.999)
    assert np.isin(np.flatnonzero(beyond), partner).mean() > 0.97  # those that have left are not


def test_particles_that_are_elsewhere(of_points, second):
    """A displacement that is wrong throughout is said, so that the frame can be begun otherwise."""
    truth, expected, _ = second
    pixels = pixels_of(noisy(truth.position_mm, truth.electrons))
    aside = expected - 20 * VOXEL_MM
    with pytest.raises(PlenoPIVError, match="are not where they are expected in the second"):
        particles_of_second_frame(of_points, pixels, aside, np.full(len(aside), LIGHT), LIMITS)


def test_a_first_frame_without_particles(of_points):
    pixels = pixels_of(noisy(np.zeros((1, 3)), np.zeros(1)))
    with pytest.raises(PlenoPIVError, match="the pixels speak for no particle"):
        particles_of_second_frame(of_points, pixels, np.empty((0, 3)), np.empty(0), LIMITS)
