"""Short tracks that depart from their neighbours: found, and no others."""

import numpy as np
import pytest
from paths import STD_MM, as_seen

from plenopiv.tracking.links import NEIGHBOURS
from plenopiv.tracking.outlying_tracks import LONG, outlying
from plenopiv.tracking.sightings import SeenFrame
from plenopiv.tracking.trajectories import trajectories

FRAMES, PARTICLES = 12, 150
GRADIENT = np.array([[0.02, -0.05, 0.01], [0.05, 0.02, 0.0], [0.03, 0.0, -0.04]])  # of the velocity, 1 / frame
VELOCITY_STD = 2e-3  # mm a frame


def velocity(position):
    return np.array([0.03, -0.01, 0.05]) + position @ GRADIENT.T


def sightings(short, off, seed=0):
    """Sightings as of ``Trajectories`` of particles in a linear flow: all seen in all frames, and one more, the last,
    in the frames ``short``, with a velocity that is ``off`` (3,) mm a frame."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (PARTICLES + 1, 3))
    frame, track, mean = [], [], []
    for number in range(FRAMES):
        here = np.arange(PARTICLES + (number in short))
        moving = velocity(place[here]) + VELOCITY_STD * rng.normal(size=(len(here), 3))
        moving[PARTICLES:] += off
        frame.append(np.full(len(here), number))
        track.append(here)
        mean.append(np.concatenate([place[here], moving, np.zeros((len(here), 3))], 1))
    covariance = np.broadcast_to(np.diag([1e-6] * 3 + [VELOCITY_STD**2] * 3 + [1.0] * 3), (sum(map(len, track)), 9, 9))
    return np.concatenate(frame), np.concatenate(track), np.concatenate(mean), covariance.copy()


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("stds", "departs"), [(2.0, False), (-2.0, False), (12.0, True), (-12.0, True)])
def test_a_short_track_that_departs_is_found_whole(axis, stds, departs):
    frame, track, mean, covariance = sightings((4, 5, 8), stds * VELOCITY_STD * np.eye(3)[axis])
    found = outlying(frame, track, mean, covariance)
    assert (found == (departs & (track == PARTICLES))).all()


def test_what_its_own_error_explains_is_no_departure():
    frame, track, mean, covariance = sightings((4, 5, 8), np.array([0.0, 0.0, 12 * VELOCITY_STD]))
    covariance[track == PARTICLES, 5, 5] *= 36.0
    assert not outlying(frame, track, mean, covariance).any()


def test_long_tracks_speak_for_themselves():
    frame, track, mean, covariance = sightings(range(LONG), np.full(3, 0.1))
    assert not outlying(frame, track, mean, covariance).any()
    fewer = sightings(range(LONG - 1), np.full(3, 0.1))
    assert outlying(*fewer).sum() == LONG - 1


def test_where_all_depart_from_each_other_none_is_found():
    """Velocities without any order in space."""
    frame, track, mean, covariance = sightings((4, 5, 6), np.full(3, 0.05))
    rng = np.random.default_rng(3)
    of_track = 0.05 * rng.normal(size=(PARTICLES + 1, 3))
    mean[:, 3:6] += of_track[track]
    assert not outlying(frame, track, mean, covariance).any()


def test_with_few_neighbours_and_without_tracks_none_is_found():
    frame, track, mean, covariance = sightings((4, 5, 8), np.full(3, 0.1))
    few = (track < NEIGHBOURS + 1) | (track == PARTICLES)
    assert not outlying(frame[few], track[few], mean[few], covariance[few]).any()
    none = np.zeros(0, np.int64)
    assert outlying(none, none, np.zeros((0, 9)), np.zeros((0, 9, 9))).shape == (0,)


def test_such_particles_stay_without_a_track():
    """Where their frames have them, with their frames' errors; all others keep their tracks."""
    rng = np.random.default_rng(1)
    start = rng.uniform(-1, 1, (PARTICLES, 3))
    ghost = np.array([[0.1, 0.2, 0.3], [0.14, 0.12, 0.0], [0.25, 0.2, 0.5]])  # in frames 3, 4 and 5
    frames = []
    for number in range(FRAMES):
        place = start + number * velocity(start)
        more = ghost[number - 3 : number - 2] if 3 <= number < 6 else np.empty((0, 3))
        here = np.arange(PARTICLES + len(more))
        frames.append(SeenFrame(number, as_seen(np.concatenate([place, more]), rng=rng), here))
    found = trajectories(frames)
    alone = found.track < 0
    assert (alone.sum(), found.outlying) == (3, 1)
    assert (np.bincount(found.track[~alone]) == FRAMES).all()
    seen = np.concatenate([one.particles.position_mm[PARTICLES:] for one in frames])
    assert (found.mean[alone, :3] == seen).all()
    assert np.isnan(found.mean[alone, 3:]).all()
    std = np.sqrt(np.einsum("nii->ni", found.covariance[alone])[:, :3])
    assert std == pytest.approx(np.tile(STD_MM, (3, 1)) * found.motion.noise)
    assert np.isnan(found.covariance[alone, 3:]).all()
    assert np.isnan(found.covariance[alone, :, 3:]).all()
