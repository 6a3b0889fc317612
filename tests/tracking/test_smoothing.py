"""Kalman filter and smoother of tracks: against dense least squares, parabolas, circles, and known noise."""

import numpy as np
import pytest
from paths import STD_MM, parabolas, seen_frames
from scipy.linalg import expm

from plenopiv.tracking.cut_off import motion_of
from plenopiv.tracking.sightings import together
from plenopiv.tracking.smoothing import SOMEWHERE_MM, Motion, Sightings, smoothed, step_of
from plenopiv.tracking.trajectories import between, trajectories

JERK, MEMORY = np.array([2e-4, 8e-4, 4e-4]), np.array([5.0, 2.0, 4.0])


def random_paths(n, frames, rng):
    """Paths (frames, n, 3) whose jerk is random and has a memory, with velocities and accelerations, by fine steps."""
    fine, density = 200, 2 * JERK**2 / MEMORY
    x, j = rng.uniform(-1, 1, (n, 3)), rng.normal(size=(n, 3)) * JERK
    v, a = rng.normal(size=(n, 3)) * 0.05, rng.normal(size=(n, 3)) * 0.003
    out = [(x, v, a)]
    for _ in range(frames - 1):
        for _ in range(fine):
            x, v, a = x + v / fine + 0.5 * a / fine**2, v + a / fine + 0.5 * j / fine**2, a + j / fine
            j = j * np.exp(-1 / fine / MEMORY) + rng.normal(size=(n, 3)) * np.sqrt(density / fine)
        out.append((x, v, a))
    return tuple(np.stack(each) for each in zip(*out, strict=True))


def exact_step(memory):
    """Step and growth (4, 4) of position, velocity, acceleration and jerk along an axis by matrix exponentials (Van
    Loan 1978, IEEE Trans. Autom. Control 23, 395)."""
    rate = np.diag([1.0, 1.0, 1.0], 1)
    rate[3, 3] = -1.0 / memory
    noise = np.zeros((4, 4))
    noise[3, 3] = 2.0 / memory
    both = expm(np.block([[-rate, noise], [np.zeros((4, 4)), rate.T]]))
    step = both[4:, 4:].T
    return step, step @ both[:4, 4:]


def dense(position, information, pull, motion):
    """Means (T, 12) and covariances (T, 12, 12) of one track by one matrix of all its states: each frame's term of the
    negative logarithm of the probability is added as it stands."""
    frames = len(position)
    matrix, right = np.zeros((12 * frames, 12 * frames)), np.zeros(12 * frames)
    first = np.concatenate([np.full(3, SOMEWHERE_MM), 3 * motion.velocity, 3 * motion.acceleration, motion.jerk])
    matrix[:12, :12] += np.diag(1.0 / first**2)
    right[:3] += position[0] / first[:3] ** 2
    for t in range(frames):
        at = slice(12 * t, 12 * t + 3)
        matrix[at, at] += information[t]
        right[at] += information[t] @ position[t] + pull[t]
    for t in range(frames - 1):
        for axis in range(3):
            step, growth = exact_step(motion.memory[axis])
            rows = 12 * t + axis + 3 * np.arange(8)
            difference = np.concatenate([-step, np.eye(4)], 1)
            matrix[np.ix_(rows, rows)] += difference.T @ np.linalg.inv(motion.jerk[axis] ** 2 * growth) @ difference
    scale = np.sqrt(np.diag(matrix))
    inverse = np.linalg.inv(matrix / scale / scale[:, None]) / scale / scale[:, None]
    mean = inverse @ right
    blocks = [inverse[12 * t : 12 * t + 12, 12 * t : 12 * t + 12] for t in range(frames)]
    return mean.reshape(frames, 12), np.stack(blocks)


@pytest.mark.parametrize("memory", [0.3, 2.0, 50.0])
def test_the_step_of_a_frame_is_that_of_matrix_exponentials(memory):
    step, growth = step_of(memory)
    exact, grown = exact_step(memory)
    assert step == pytest.approx(exact, rel=1e-9, abs=1e-9)
    assert growth == pytest.approx(grown, rel=1e-6)


def test_the_smoother_is_the_least_squares_of_all_states():
    """Errors that are correlated between axes, a frame that is missing, one without depth, and slopes."""
    rng = np.random.default_rng(3)
    n, frames = 3, 6
    position = (
        rng.uniform(-1, 1, (n, 1, 3)) + 0.05 * np.arange(frames)[None, :, None] + 1e-3 * rng.normal(size=(n, frames, 3))
    )
    root = rng.normal(size=(n, frames, 3, 3)) * 3e2
    information = root @ np.swapaxes(root, 2, 3) + 1e5 * np.eye(3)
    information[1, 2] = 0.0
    information[:, 3, 2] = information[:, 3, :, 2] = 0.0
    pull = 10.0 * rng.normal(size=(n, frames, 3))
    pull[1, 2] = 0.0
    memory = np.array([0.5, 3.0, 10.0])
    motion = Motion(np.array([1e-3, 5e-4, 2e-3]), memory, np.full(3, 0.1), np.full(3, 0.02), np.ones(3))
    found = smoothed(Sightings(position, information, pull), motion, passes=1)
    for k in range(n):
        mean, covariance = dense(position[k], information[k], pull[k], motion)
        scale = np.sqrt(np.einsum("tii->ti", covariance))
        assert np.abs((found.mean[k] - mean) / scale).max() < 1e-4
        assert np.abs((found.covariance[k] - covariance) / scale[:, :, None] / scale[:, None, :]).max() < 1e-4


def test_spread_memory_and_errors_of_random_paths_are_found():
    """The jerk's density and memory to a factor of 1.4 and 1.6, errors that are 1.5 times as large as stated to 3 %;
    what is stated of positions, velocities and accelerations holds 68 and 95 % of the errors."""
    rng = np.random.default_rng(5)
    x, v, a = random_paths(800, 20, rng)
    frames = seen_frames(lambda t: x[int(t)].copy(), 20, 800)
    for one in frames:
        one.particles.position_mm[:] += 1.5 * STD_MM * rng.normal(size=(800, 3))
    motion = motion_of(together(frames).runs())
    assert (np.abs(np.log(motion.jerk**2 * motion.memory / (JERK**2 * MEMORY))) < np.log(1.4)).all()
    assert (np.abs(np.log(motion.memory / MEMORY)) < np.log(1.6)).all()
    assert motion.noise == pytest.approx(np.full(3, 1.5), rel=0.03)
    found = trajectories(frames)
    truth = np.concatenate([x, v, a], 2).reshape(-1, 9)
    off = np.abs(found.mean - truth) / np.sqrt(np.einsum("nii->ni", found.covariance))
    assert (off < 1).mean(0) == pytest.approx(np.full(9, 0.683), abs=0.04)
    assert (off < 2).mean(0) == pytest.approx(np.full(9, 0.954), abs=0.02)


def test_wrong_positions_change_the_motion_found_by_little():
    """Three of a hundred positions are 30 standard deviations off: density within a factor of 3, factor of errors below
    1.4, and nine of ten velocities are nearly what they were."""
    rng = np.random.default_rng(5)
    x, *_ = random_paths(400, 20, rng)
    frames = seen_frames(lambda t: x[int(t)].copy(), 20, 400, rng)
    clean = trajectories(frames)
    for one in frames:
        wrong = rng.random(400) < 0.03
        one.particles.position_mm[wrong] += 30 * STD_MM * rng.normal(size=(wrong.sum(), 3))
    found = trajectories(frames)
    density = found.motion.jerk**2 * found.motion.memory / (clean.motion.jerk**2 * clean.motion.memory)
    assert (np.abs(np.log(density)) < np.log(3)).all()
    assert (found.motion.noise < 1.4).all()
    std = np.sqrt(np.einsum("nii->ni", clean.covariance)[:, 3:6])
    assert np.quantile(np.abs(found.mean - clean.mean)[:, 3:6] / std, 0.9) < 1.0


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_jerk_that_errors_hide_is_not_taken_for_none(seed):
    """100 tracks of nine frames whose errors hide nearly all of the jerk: nine of ten accelerations and more lie within
    two of their standard deviations. With the likeliest jerk, often none at all, it was 88 % of them."""
    rng = np.random.default_rng(seed)
    x, _, a = random_paths(100, 9, rng)
    found = trajectories(seen_frames(lambda t: x[int(t)].copy(), 9, 100, rng, std_mm=20 * STD_MM))
    off = np.abs(found.mean[:, 6:] - a.reshape(-1, 3)) / np.sqrt(np.einsum("nii->ni", found.covariance)[:, 6:])
    assert ((off < 2).mean(0) > 0.94).all()


def test_parabolas_are_kept_on_every_axis():
    """Velocity and acceleration of a parabola, which has no jerk, to a small part of what noise leaves."""
    _, velocity, bend, path = parabolas(50)
    frames = seen_frames(path, 12, 50, std_mm=0.01 * STD_MM)
    found = trajectories(frames)
    t = found.frame[:, None]
    assert (np.sign(found.mean[:, 6:]) == np.sign(np.array([-1, 1, 1]))).all()
    assert found.mean[:, :3] == pytest.approx(np.concatenate([path(k) for k in range(12)]), abs=1e-5)
    assert found.mean[:, 3:6] == pytest.approx(np.tile(velocity, (12, 1)) + np.tile(bend, (12, 1)) * t, abs=1e-5)
    assert found.mean[:, 6:] == pytest.approx(np.tile(bend, (12, 1)), abs=1e-5)
    position, moving, std = between(found, 3)
    assert position == pytest.approx(path(3.5), abs=1e-5)
    assert moving == pytest.approx(velocity + 3.5 * bend, abs=1e-5)
    assert (std > 0).all()


def test_a_circle_with_noise():
    """Rotation by 0.15 rad a frame and a drift: errors of acceleration within the bars, smaller than those of second
    differences by far, and in the direction of the centre."""
    rng, n, turn = np.random.default_rng(8), 300, 0.15
    radius, phase = rng.uniform(0.2, 1.0, n), rng.uniform(0, 2 * np.pi, n)

    def path(t):
        angle = phase + turn * t
        return np.stack([radius * np.cos(angle), 0.02 * t + 0 * angle, -radius * np.sin(angle)], -1)

    found = trajectories(seen_frames(path, 25, n, rng))
    truth = np.concatenate([-(turn**2) * (path(float(t)) - [0, 0.02 * t, 0]) for t in range(25)])
    off, std = np.abs(found.mean[:, 6:] - truth), np.sqrt(np.einsum("nii->ni", found.covariance)[:, 6:])
    middle = (found.frame >= 4) & (found.frame < 21)
    assert 0.6 < (off < std)[middle].mean() < 0.9  # smoother than jerk with a memory: a little more than 68 %
    assert (off < 2 * std)[middle].mean() > 0.9
    second_differences = 6.0**0.5 * STD_MM
    assert (np.sqrt((off[middle] ** 2).mean(0)) < 0.5 * second_differences).all()


def test_depth_that_no_pixel_tells_comes_from_the_other_frames():
    """Near focus frames 4 to 6 say nothing of z, and the track's depth there is that of its way through."""
    *_, path = parabolas(60)
    rng = np.random.default_rng(2)
    frames = seen_frames(path, 11, 60, rng)
    for one in frames[4:7]:
        one.particles.information[:, 2] = one.particles.information[:, :, 2] = 0.0
        one.particles.position_mm[:, 2] = 7.0  # wherever the fit left it
    found = trajectories(frames)
    off = found.mean[:, 2] - np.concatenate([path(float(t))[:, 2] for t in range(11)])
    std = np.sqrt(found.covariance[:, 2, 2])
    hidden = (found.frame >= 4) & (found.frame <= 6)
    assert np.abs(off[hidden]).max() < 0.03
    assert 0.5 < (np.abs(off) < std)[hidden].mean() < 0.9
    assert std[hidden].mean() > std[~hidden].mean()


def test_a_wrong_position_does_not_draw_its_track_along():
    *_, path = parabolas(40)
    rng = np.random.default_rng(4)
    frames = seen_frames(path, 12, 40, rng)
    frames[5].particles.position_mm[7] += 60 * STD_MM
    found = trajectories(frames)
    mine = (found.track == found.track[7]) & (found.frame != 5)
    off = found.mean[mine, :3] - np.stack([path(float(t))[7] for t in range(12) if t != 5])
    assert np.abs(off / STD_MM).max() < 4


@pytest.mark.parametrize("noise", [np.ones(3), np.array([1.0, 1.0, 1.6])])
def test_what_pixels_say_is_one_thing_whatever_prediction_pulled_at_it(noise):
    """The same places of pixels, one of them wrong, as they are and as a fit with a prediction has them."""
    rng = np.random.default_rng(12)
    jerk, still = np.full(3, 3e-5), np.full(3, 3.0)
    motion = Motion(jerk, still, np.full(3, 0.05), np.full(3, 0.003), noise)
    std, frames, number = np.array([2e-3, 2e-3, 8e-3]), 20, 200
    turn = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]])  # x and z are told together
    information = np.broadcast_to(np.linalg.inv(turn * std[:, None] * std), (number, frames, 3, 3))
    true = np.arange(frames)[:, None] * np.array([0.05, 0.02, 0.01])
    place = true + rng.multivariate_normal(np.zeros(3), turn * std[:, None] * std, (number, frames))
    place[:, 10, 0] += 10 * std[0]
    expected = true + 1.2 * std * rng.standard_normal((number, frames, 3))
    of_prediction = np.eye(3) / (1.2 * std) ** 2
    slope = (information @ place[..., None])[..., 0] + expected @ of_prediction
    fitted = np.linalg.solve(information + of_prediction, slope[..., None])[..., 0]
    pull = (fitted - expected) @ of_prediction
    alone = smoothed(Sightings(place, information, np.zeros_like(place)), motion)
    pulled = smoothed(Sightings(fitted, information, pull), motion)
    assert pulled.mean == pytest.approx(alone.mean, abs=5e-6)
    off = (alone.mean[:, 10, :3] - true[10]).mean(0) / np.sqrt(np.einsum("nii->ni", alone.covariance[:, 10]))[0, :3]
    assert (np.abs(off) < 1.0).all()


def test_short_tracks():
    """Without a track no velocity, of few frames no acceleration; two frames' velocity is their difference."""
    *_, path = parabolas(80)
    lengths = np.full(80, 6)
    lengths[:3] = 1, 2, 3
    frames = seen_frames(path, 6, 80, present=lambda t: t < lengths)
    found = trajectories(frames)
    first = found.frame == 0
    assert found.track[0] == -1
    assert np.isnan(found.mean[0, 3:]).all()
    assert np.isfinite(found.mean[first][1:, 3:6]).all()
    assert np.isnan(found.mean[first][1:3, 6:]).all()
    assert np.isfinite(found.mean[first][3:, 6:]).all()
    assert (np.unique(found.track[1:]) == np.arange(79)).all()
    moved = path(1.0)[1] - path(0.0)[1]
    assert found.mean[1, 3:6] == pytest.approx(moved, abs=0.01)
    assert found.covariance[1, 3, 3] > found.covariance[10, 3, 3]
