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


def sightings(short, off, frames=FRAMES, seed=0):
    """Sightings as of ``Trajectories`` of particles in a linear flow: all seen in all frames, and one more, the last,
    in the middle, in the frames ``short``, with a velocity that is ``off`` (3,) or (frames, 3) mm a frame, without an
    error of its own. In no order."""
    rng = np.random.default_rng(seed)
    place = np.concatenate([rng.uniform(-1, 1, (PARTICLES, 3)), [[0.1, -0.05, 0.0]]])
    off = np.broadcast_to(off, (len(short), 3))
    frame, track, mean = [], [], []
    for number in range(frames):
        here = np.arange(PARTICLES + (number in short))
        moving = velocity(place[here])
        moving[:PARTICLES] += VELOCITY_STD * rng.normal(size=(PARTICLES, 3))
        if number in short:
            moving[PARTICLES] += off[list(short).index(number)]
        frame.append(np.full(len(here), number))
        track.append(here)
        mean.append(np.concatenate([place[here], moving, np.zeros((len(here), 3))], 1))
    covariance = np.broadcast_to(np.diag([1e-6] * 3 + [VELOCITY_STD**2] * 3 + [1.0] * 3), (sum(map(len, track)), 9, 9))
    order = rng.permutation(len(covariance))
    each = np.concatenate(frame), np.concatenate(track), np.concatenate(mean), covariance.copy()
    return tuple(part[order] for part in each)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("stds", "departs"), [(5.0, False), (-5.0, False), (8.0, True), (-8.0, True)])
def test_a_short_track_that_departs_is_found_whole(axis, stds, departs):
    frame, track, mean, covariance = sightings((4, 5, 8), stds * VELOCITY_STD * np.eye(3)[axis])
    found = outlying(frame, track, mean, covariance)
    assert (found == (departs & (track == PARTICLES))).all()


@pytest.mark.parametrize("where", range(3))
def test_one_frame_in_which_it_departs_is_enough(where):
    frame, track, mean, covariance = sightings((4, 5, 8), 10 * VELOCITY_STD * np.eye(3)[[where]].T * np.ones(3))
    assert (outlying(frame, track, mean, covariance) == (track == PARTICLES)).all()


def test_what_its_own_error_explains_is_no_departure():
    frame, track, mean, covariance = sightings((4, 5, 8), np.array([0.0, 0.0, 12 * VELOCITY_STD]))
    covariance[track == PARTICLES, 5, 5] *= 36.0
    assert not outlying(frame, track, mean, covariance).any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_errors_that_go_together_are_known(sign):
    """Of errors nearly equal along x and y a departure with equal signs is likely, one with opposite signs is not."""
    frame, track, mean, covariance = sightings((4, 5, 8), 15 * VELOCITY_STD * np.array([1.0, sign, 0.0]))
    own = np.flatnonzero(track == PARTICLES)
    covariance[own, 3, 3] = covariance[own, 4, 4] = 26 * VELOCITY_STD**2
    covariance[own, 3, 4] = covariance[own, 4, 3] = 25 * VELOCITY_STD**2
    assert outlying(frame, track, mean, covariance).any() == (sign < 0)


def test_neighbours_with_large_errors_do_not_hide_it():
    """They scatter no more than these say."""
    frame, track, mean, covariance = sightings((4, 5, 8), np.zeros(3))
    rng = np.random.default_rng(2)
    others = track != PARTICLES
    mean[others, 3:6] += 5 * VELOCITY_STD * rng.normal(size=(others.sum(), 3))
    covariance[:, range(3, 6), range(3, 6)] = 26 * VELOCITY_STD**2
    assert not outlying(frame, track, mean, covariance).any()
    mean[~others, 4] += 8.0 * 26**0.5 * VELOCITY_STD
    assert (outlying(frame, track, mean, covariance) == ~others).all()


def test_long_tracks_speak_for_themselves():
    assert not outlying(*sightings(range(LONG), np.full(3, 0.1))).any()
    assert outlying(*sightings(range(LONG - 1), np.full(3, 0.1))).sum() == LONG - 1


def test_in_a_short_sequence_those_that_are_seen_throughout_do():
    assert not outlying(*sightings(range(5), np.full(3, 0.1), frames=5)).any()
    assert outlying(*sightings((0, 2, 3), np.full(3, 0.1), frames=5)).sum() == 3


def test_where_all_depart_from_each_other_none_is_found():
    """Velocities without any order in space."""
    frame, track, mean, covariance = sightings((4, 5, 6), np.full(3, 0.05))
    rng = np.random.default_rng(3)
    of_track = 0.05 * rng.normal(size=(PARTICLES + 1, 3))
    mean[:, 3:6] += of_track[track]
    assert not outlying(frame, track, mean, covariance).any()


def test_with_few_neighbours_and_without_tracks_none_is_found():
    frame, track, mean, covariance = sightings((4, 5, 8), np.full(3, 0.1))
    few = (track < NEIGHBOURS) | (track == PARTICLES)
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


def jet(place):
    """Half width .6 mm, so fast that its core is crossed in three frames."""
    speed = 0.05 + 0.6 * np.exp(-(place[:, 1] ** 2 + place[:, 2] ** 2) / 0.6**2)
    return speed[:, None] * np.array([1.0, 0.0, 0.0])


def waves(place):
    """A mean and waves as long as the volume, which particles cross in ten frames."""
    x, y, z = np.pi * place.T
    swirl = np.stack([np.sin(y) + np.cos(z), np.sin(z) + np.cos(x), np.sin(x) + np.cos(y)], 1)
    return np.array([0.2, 0.0, 0.0]) + 0.05 * swirl


@pytest.mark.parametrize("flow", [jet, waves])
def test_fast_particles_keep_their_tracks_and_ghosts_do_not(flow):
    """Most tracks are short, as particles enter and leave: hardly one of them is lost; of a hundred ghosts of three to
    five frames, whose velocities are off by .06 mm a frame, four of five are found."""
    rng = np.random.default_rng(7)
    count, frames = 400, 12
    more: list[list] = [[] for _ in range(frames)]
    for number in range(100):
        length = int(rng.integers(3, 6))
        first, at = int(rng.integers(0, frames - length + 1)), rng.uniform(-0.9, 0.9, 3)
        moving = flow(at[None])[0] + 0.06 * rng.normal(size=3)
        for k in range(length):
            more[first + k].append((at + k * moving, 10**6 + number))
    place, track, unused, seen = rng.uniform(-1, 1, (count, 3)), np.arange(count), count, []
    for ghosts in more:
        where = np.concatenate([place, np.array([at for at, _ in ghosts]).reshape(-1, 3)])
        number = np.concatenate([track, np.array([each for _, each in ghosts], np.int64)])
        seen.append(SeenFrame(len(seen), as_seen(where, rng=rng), number))
        place = place + flow(place + 0.5 * flow(place))
        gone = (np.abs(place) > 1).any(1)
        place[gone] = (place[gone] + 1) % 2 - 1  # comes in on the other side, as another particle
        track = np.where(gone, unused + np.cumsum(gone), track)
        unused += count
    number = np.concatenate([one.track for one in seen])
    length = np.unique(number, return_counts=True, return_inverse=True)
    frames_of = length[2][length[1]]
    lost, ghost = trajectories(seen).track < 0, number >= 10**6
    short = ~ghost & (frames_of > 1) & (frames_of < LONG)
    assert short.sum() > 0.2 * count * frames
    assert lost[short].mean() < 0.01
    assert lost[ghost].mean() > 0.8
