"""Tracks predicted, followed, lost and found again: particles whose paths are known."""

from dataclasses import replace

import numpy as np
import pytest
from paths import FAR, STD_MM, as_seen, parabolas, seen_frames

from plenopiv.tracking.follow import followed
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.predict import LOST, predicted
from plenopiv.tracking.sightings import SeenFrame


def test_the_prediction_of_a_parabola_is_exact():
    *_, path = parabolas(60)
    by = predicted(seen_frames(path, 6, 60, std_mm=0.01 * STD_MM), 6, FAR)
    assert by.track.tolist() == list(range(60))
    assert by.position_mm == pytest.approx(path(6.0), abs=1e-5)
    assert by.light == pytest.approx(np.full(60, 100.0))


def test_predictions_are_as_far_off_as_they_say():
    rng = np.random.default_rng(0)
    *_, path = parabolas(400)
    by = predicted(seen_frames(path, 8, 400, rng), 8, FAR)
    off = np.abs(by.position_mm - path(8.0)) / np.sqrt(np.einsum("nii->ni", by.covariance))
    assert 0.6 < (off < 1).mean() < 0.8
    assert 0.92 < (off < 2).mean() < 0.985


def test_a_particle_that_leaves_is_not_looked_for():
    *_, path = parabolas(60)
    limits = ((-0.9, 1.2), (-2, 2), (-3, 4))
    by = predicted(seen_frames(path, 6, 60), 6, limits)
    inside = (path(6.0)[:, 0] > -0.9) & (path(6.0)[:, 0] < 1.2)
    assert 0 < inside.sum() < 60
    assert by.track.tolist() == np.flatnonzero(inside).tolist()


@pytest.mark.parametrize("missing", range(1, LOST + 3))
def test_a_particle_that_is_not_seen_for_some_frames(missing):
    """It is predicted as long as it may come back, and its error bar grows."""
    *_, path = parabolas(60)
    frames = 10
    seen = seen_frames(
        path, frames, 60, std_mm=0.01 * STD_MM, present=lambda t: (np.arange(60) != 7) | (t < frames - missing)
    )
    by = predicted(seen, frames, FAR)
    if missing > LOST:
        assert 7 not in by.track
        return
    assert by.position_mm[7] == pytest.approx(path(float(frames))[7], abs=1e-5)
    others = np.delete(np.einsum("nii->ni", by.covariance), 7, 0)
    assert (np.diag(by.covariance[7]) > others.max(0)).all()


def test_a_particle_that_enters_moves_as_its_neighbours_do():
    """Seen once, in the last frame: its velocity is that of those around it, a rotation about y and a drift."""
    rng = np.random.default_rng(6)
    start = rng.uniform(-1, 1, (200, 3))

    def path(t):
        turn = 0.03 * t
        x, y, z = start.T
        return np.stack([x * np.cos(turn) + z * np.sin(turn), y - 0.04 * t, z * np.cos(turn) - x * np.sin(turn)], -1)

    new = np.arange(200) < 5
    by = predicted(seen_frames(path, 6, 200, present=lambda t: ~new | (t == 5)), 6, FAR)
    assert np.isin(np.arange(5), by.track).all()
    off = by.position_mm[np.isin(by.track, np.arange(5))] - path(6.0)[:5]
    assert np.abs(off).max() < 5e-3  # it moves by 0.05 mm


def test_nothing_is_predicted_of_nothing():
    *_, path = parabolas(20)
    assert len(predicted([], 3, FAR).track) == 0
    assert len(predicted(seen_frames(path, 3, 20), 20, FAR).track) == 0


def following(found, origin, frames=6, n=60):
    *_, path = parabolas(n)
    by = predicted(seen_frames(path, frames, n), frames, FAR)
    return followed(found(path(float(frames))), origin(n), by, 1000)


def test_particles_go_on_with_their_tracks_and_new_ones_begin():
    added = np.array([[5.0, 5.0, 5.0]])
    out = following(lambda at: as_seen(np.concatenate([at, added])), lambda n: np.append(np.arange(n), -1))
    assert out.track.tolist() == [*range(60), 1000]
    assert out.kept == 60
    assert (out.off_mm < STD_MM).all()


def test_a_particle_far_from_where_it_was_predicted_is_another_one():
    def found(at):
        at[4] += np.array([0.0, 0.08, 0.0])
        return as_seen(at)

    out = following(found, np.arange)
    assert out.track[4] == 1000
    assert np.delete(out.track, 4).tolist() == [k for k in range(60) if k != 4]
    assert out.kept == 59


@pytest.mark.parametrize("ratio", [0.25, 1.0, 3.0])
def test_how_far_is_measured_without_the_pull_of_the_prediction(ratio):
    """Pixels have a particle 4 or 6 standard deviations off, of both together; the fit is between them and the
    prediction, which is ``ratio`` times as uncertain as pixels are."""
    *_, path = parabolas(60)
    by = predicted(seen_frames(path, 6, 60), 6, FAR)
    by = replace(by, covariance=np.broadcast_to(np.diag((ratio * STD_MM) ** 2), (60, 3, 3)))
    off = np.zeros((60, 3))
    off[7, 0], off[8, 0] = np.array([4.0, 6.0]) * STD_MM[0] * np.sqrt(1 + ratio**2)
    share, covariance = ratio**2 / (1 + ratio**2), np.zeros((60, 4, 4))
    covariance[:, range(3), range(3)], covariance[:, 3, 3] = share * STD_MM**2, 1.0
    information = np.broadcast_to(np.diag(1 / STD_MM**2), (60, 3, 3))
    pull = share * off / (ratio * STD_MM) ** 2
    place = by.position_mm + share * off
    found = FrameParticles(place, by.light, covariance, np.ones(60), 1.0, information, pull)
    track = followed(found, np.arange(60), by, 60).track
    assert np.flatnonzero(track != by.track).tolist() == [8]


def test_a_particle_of_another_light_is_another_one():
    light = np.full(60, 130.0)  # all are brighter now
    light[9] = 400.0
    out = following(lambda at: as_seen(at, light=light), np.arange)
    assert out.track[9] == 1000
    assert out.kept == 59


def test_a_lost_particle_that_is_found_in_the_residual_goes_on_with_its_track():
    """Its fit ran away, and the search found it where it had been predicted."""
    order = np.roll(np.arange(60), 3)
    out = following(lambda at: as_seen(at[order]), lambda n: np.where(order == 11, -1, order))
    assert out.track.tolist() == order.tolist()
    assert out.kept == 60


def test_a_track_goes_on_after_a_frame_without_it():
    *_, path = parabolas(60)
    frames = seen_frames(path, 7, 60, present=lambda t: (np.arange(60) != 7) | (t != 6))
    by = predicted(frames, 7, FAR)
    out = followed(as_seen(path(7.0)), np.argsort(by.track), by, 1000)
    assert out.track[7] == 7


def test_frames_may_be_missing():
    """A frame that is lost: tracks are predicted over it."""
    *_, path = parabolas(60)
    frames = [one for one in seen_frames(path, 8, 60, std_mm=0.01 * STD_MM) if one.number != 7]
    by = predicted(frames, 8, FAR)
    assert by.position_mm == pytest.approx(path(8.0), abs=1e-5)
    assert isinstance(frames[0], SeenFrame)
