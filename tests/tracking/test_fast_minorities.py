"""A few particles that are far faster than most, and places that are known worse than a particle's first guess."""

import numpy as np
import pytest
from paths import STD_MM, seen_frames

from plenopiv.tracking.smoothing import BEYOND, SOMEWHERE_MM, Motion, Sightings, begun, seen_by, smoothed
from plenopiv.tracking.trajectories import trajectories

JET = np.array([1.0, 0.0, 0.5])  # mm a frame
MOTION = Motion(np.full(3, 1e-4), np.full(3, 3.0), np.full(3, 0.2), np.full(3, 0.01), np.ones(3))


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_a_jet_in_fluid_nearly_at_rest(frames):
    """2 % of the particles cross in a few frames: their velocities are their own, and as well known as stated."""
    rng, n, few, time = np.random.default_rng(1), 1200, 24, 12
    slow = rng.normal(0, 0.02, (n, 3))
    begin = rng.integers(0, time - frames + 1, few * (time // frames))
    velocity = np.concatenate([slow, JET + rng.normal(0, 0.03, (len(begin), 3))])
    start = rng.uniform([-8, -8, -4], [8, 8, 4], (len(velocity), 3))
    start[n:] = rng.normal(0, [0.3, 0.4, 0.4], (len(begin), 3)) - begin[:, None] * velocity[n:]

    def there(t):
        return np.concatenate([np.ones(n, bool), (t >= begin) & (t < begin + frames)])

    found = trajectories(seen_frames(lambda t: start + velocity * t, time, len(velocity), rng, 5 * STD_MM, there))
    number = np.concatenate([np.flatnonzero(there(t)) for t in range(time)])
    jet = (number >= n) & (found.track >= 0)
    assert jet.sum() > 0.9 * (number >= n).sum()
    off = found.mean[jet, 3:6] - velocity[number[jet]]
    std = np.sqrt(np.einsum("nii->ni", found.covariance[jet])[:, 3:6])
    assert (found.mean[jet, 3:6].mean(0) / JET)[[0, 2]] == pytest.approx([1, 1], abs=0.02)
    assert (np.abs(off) < 2 * std).mean() > 0.9
    assert np.sqrt((off**2).mean(0))[0] < 0.015


def test_what_may_be_an_error_of_a_position_is_no_velocity():
    """Two sightings whose difference is told badly leave the spread of all particles' velocities."""
    place = np.zeros((3, 2, 3))
    place[:, 1, 2] = 2.0
    std = np.array([0.01, 0.6, 0.01])  # along z, of each particle
    information = np.zeros((3, 2, 3, 3))
    information[..., [0, 1], [0, 1]] = 1e4
    information[..., 2, 2] = 1.0 / std[:, None] ** 2
    information[2, 1] = 0.0  # and one that is not seen again
    start = begun(Sightings(place, information, np.zeros_like(place)), np.zeros(3, np.int64), MOTION)
    spread = np.sqrt(start.covariance[:, 5, 5]) / MOTION.velocity[2]
    assert spread[0] == pytest.approx(3 * 2.0 / 0.2, rel=0.05)
    assert spread[1:] == pytest.approx([3, 3])


@pytest.mark.parametrize("prior_mm", [0.2, 2.0, 4.5])
def test_error_bars_of_places_that_a_camera_hardly_tells(prior_mm):
    """In frames that tell depth to twice the camera's prior; of small magnifications that is many millimetres."""
    rng, n, frames = np.random.default_rng(0), 1500, 6
    true = rng.normal(0, 0.2, (n, 1, 3)) * np.arange(frames)[:, None] * [1, 0, 0]
    std = np.array([0.02, 0.02, 2 * prior_mm])
    seen = true + rng.normal(size=true.shape) * std
    information = np.broadcast_to(np.diag(1 / std**2), (n, frames, 3, 3)).copy()
    motion = seen_by(MOTION, np.array([0.02, 0.02, prior_mm]))
    assert motion.somewhere_mm == pytest.approx([1, 1, max(SOMEWHERE_MM, BEYOND * prior_mm)])
    found = smoothed(Sightings(seen, information, np.zeros_like(seen)), motion)
    off, stated = found.mean[:, :, 2], np.sqrt(found.covariance[:, :, 2, 2])
    assert off.std() / np.sqrt((stated**2).mean()) == pytest.approx(1.0, abs=0.1)
    assert seen_by(MOTION, None) is MOTION
