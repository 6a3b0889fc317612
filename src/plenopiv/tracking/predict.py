"""Where the particles of tracks will be in the next frame.

The last frames of a track give its state by a Kalman filter (``smoothing``), how particles move being learnt from all
tracks (``cut_off``); one frame later that is the prediction, with its covariance. A track of few frames, a particle
that was just found, hardly has a velocity of its own: it is taken to move as its neighbours do, as well as these agree
(Schanz, Gesemann & Schroder 2016, Exp. Fluids 57, 70, section 2.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.cut_off import COVERED, COVERED_STD, motion_of
from plenopiv.tracking.links import NEIGHBOURS, of_neighbours
from plenopiv.tracking.sightings import SeenFrame, Together, together
from plenopiv.tracking.smoothing import Motion, States, at_rest, begun, filtered, moved, seen_by
from plenopiv.volume import Limits, within

FRAMES = 8  # the last ones, that a prediction rests on
LOST = 2  # frames in which a track may not be seen before it ends
SHORT = 4  # frames below which neighbours tell a track's velocity
TOLD_BY = 150  # tracks tell how particles move
LIGHT_FRAMES = 4  # the last ones, whose mean is the light predicted

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Predicted:
    """Particles of tracks (n,) as they will be: ``position_mm`` (n, 3), its ``covariance`` (n, 3, 3) mm^2 and ``light``
    (n,) counts; ``active`` (n,): not lost in the last frame. ``motion``: what was learnt of all."""

    track: NDArray[np.int64]
    position_mm: Array
    covariance: Array
    light: Array
    active: NDArray[np.bool_]
    motion: Motion


def predicted(
    frames: Sequence[SeenFrame], number: int, limits_mm: Limits, prior_std_mm: Array | None = None
) -> Predicted:
    """The particles of frame ``number`` within ``limits_mm`` as earlier ``frames``, in the order of time, let expect
    them: those that were seen in the last one or lost for at most ``LOST`` frames. There are none where there are no
    tracks. ``prior_std_mm`` (3,): of the camera's particles."""
    recent = [one for one in frames if number - FRAMES <= one.number < number and len(one.track)]
    nothing = Predicted(
        np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0), np.empty(0, bool), _unknown()
    )
    if not recent:
        return nothing
    every = together(recent)
    motion = seen_by(motion_of(every.runs(), False, TOLD_BY), prior_std_mm)
    alive = every.of(np.flatnonzero(every.last >= number - 1 - LOST))
    if len(alive.start) == 1:
        return nothing
    states = _states(alive, number, motion)
    mean, covariance = states.mean[:, :3], states.covariance[:, :3, :3]
    active = alive.last == recent[-1].number
    kept = within(mean, limits_mm)
    track = alive.track[alive.start[:-1]][kept]
    return Predicted(track, mean[kept], covariance[kept], _light(alive)[kept], active[kept], motion)


def _states(alive: Together, number: int, motion: Motion) -> States:
    """The states of tracks in frame ``number``."""
    base = int(alive.first.min())
    states = _after_filter(alive, base, number, None, motion)
    known = np.flatnonzero(alive.length >= SHORT - 1)
    short = np.flatnonzero(alive.length < SHORT)
    if len(known) <= NEIGHBOURS or not len(short):
        return states
    velocity = states.mean[:, 3:6]
    around = of_neighbours(states.mean[:, :3], known, velocity[known])
    apart = np.quantile(np.abs(velocity - around)[known], COVERED, 0) / COVERED_STD
    some = alive.of(short)
    start = at_rest(some.position_mm[some.start[:-1]], motion)
    start.mean[:, 3:6] = around[short]
    spread = np.minimum(apart, motion.velocity) ** 2 + ((number - 1 - some.first)[:, None] * motion.acceleration) ** 2
    for axis in range(3):
        start.covariance[:, 3 + axis, 3 + axis] = spread[:, axis]
    again = _after_filter(some, base, number, start, motion)
    states.mean[short], states.covariance[short] = again.mean, again.covariance
    return states


def _after_filter(tracks: Together, base: int, number: int, start: States | None, motion: Motion) -> States:
    seen = tracks.sightings(np.full(len(tracks.start) - 1, base), number - base)
    start = begun(seen, tracks.first - base, motion) if start is None else start
    _, after = filtered(seen, tracks.first - base, start, motion)
    return moved(States(after.mean[-1], after.covariance[-1]), motion)


def _light(tracks: Together) -> Array:
    """Mean light of each track's last frames (tracks,)."""
    behind = np.repeat(tracks.start[1:], tracks.length) - np.arange(len(tracks.track))  # 1 for the last
    late, row = behind <= LIGHT_FRAMES, np.repeat(np.arange(len(tracks.start) - 1), tracks.length)
    count = np.minimum(tracks.length, LIGHT_FRAMES)
    return np.asarray(np.bincount(row[late], tracks.light[late], len(count)) / count)


def _unknown() -> Motion:
    return Motion(np.zeros(3), np.ones(3), np.zeros(3), np.zeros(3), np.ones(3))
