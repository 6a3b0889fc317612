"""Tracks over many frames, smoothed: position, velocity and acceleration of each particle in each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.cut_off import motion_of
from plenopiv.tracking.outlying_tracks import outlying
from plenopiv.tracking.sightings import SeenFrame, Together, together
from plenopiv.tracking.smoothing import Motion, seen_by, smoothed

LEAST_FRAMES = 4  # in which a particle must be seen for an acceleration
AT_ONCE = 60_000  # frames of tracks that are smoothed at a time

Array = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Trajectories:
    """The particles of several frames, one after the other, on smooth tracks.

    ``frame`` and ``track`` (m,), the latter -1 for a particle that is seen in one frame alone, or on a short track that
    its neighbours do not let expect (``outlying_tracks``); ``mean`` (m, 9): x, y, z in mm, velocity in mm per frame,
    acceleration in mm per frame^2, and their ``covariance`` (m, 9, 9); NaN where there is none: velocities of particles
    without a track, accelerations of those seen in fewer than ``LEAST_FRAMES``. ``motion``: what was learnt of all;
    ``outlying``: how many tracks were left out as their neighbours do not let expect them.
    """

    frame: Int
    track: Int
    mean: Array
    covariance: Array
    motion: Motion
    outlying: int = 0


def trajectories(frames: Sequence[SeenFrame], prior_std_mm: Array | None = None) -> Trajectories:
    """Smooth the tracks of all ``frames``, which are in the order of time. ``prior_std_mm`` (3,): of the camera's
    particles."""
    every = together(frames)
    motion = seen_by(motion_of(every.runs()), prior_std_mm)
    alone = np.concatenate([one.particles.position_mm for one in frames]).reshape(-1, 3)
    own = np.concatenate([one.particles.covariance for one in frames]).reshape(-1, 4, 4)
    mean, covariance = np.full((len(alone), 9), np.nan), np.full((len(alone), 9, 9), np.nan)
    of_frames = own[:, :3, :3] * np.outer(motion.noise, motion.noise)
    mean[:, :3], covariance[:, :3, :3] = alone, of_frames
    for which in _groups(every):
        some = every.of(which)
        begin, frames_of_all = some.first, int((some.last - some.first).max()) + 1
        found = smoothed(some.sightings(begin, frames_of_all), motion)
        row, at = np.repeat(np.arange(len(which)), some.length), some.frame - np.repeat(begin, some.length)
        mean[some.origin], covariance[some.origin] = found.mean[row, at, :9], found.covariance[row, at, :9, :9]
        few = some.origin[np.repeat(some.length, some.length) < LEAST_FRAMES]
        mean[few, 6:] = covariance[few, 6:] = covariance[few, :, 6:] = np.nan
    frame = np.repeat([one.number for one in frames], [len(one.track) for one in frames]).astype(np.int64)
    track = np.full(len(frame), -1, np.int64)
    track[every.origin] = np.where(np.repeat(every.length, every.length) > 1, every.track, -1)
    stray = outlying(frame, track, mean, covariance)
    left_out = len(np.unique(track[stray]))
    track[stray], mean[stray, :3], mean[stray, 3:], covariance[stray] = -1, alone[stray], np.nan, np.nan
    covariance[stray, :3, :3] = of_frames[stray]
    return Trajectories(frame, _from_zero(track), mean, covariance, motion, left_out)


def between(found: Trajectories, first: int) -> tuple[Array, Array, Array]:
    """Positions (n, 3) mm and velocities (n, 3) mm per frame, with standard deviations (n, 3), of the tracks that are
    seen in frame ``first`` and the next, half way between: the cubic through both ends and their velocities, whose
    velocity has the mean acceleration's change taken off where it is known."""
    a, b = (np.flatnonzero((found.frame == k) & (found.track >= 0)) for k in (first, first + 1))
    _, in_a, in_b = np.intersect1d(found.track[a], found.track[b], return_indices=True)
    p, q = found.mean[a[in_a]], found.mean[b[in_b]]
    position = 0.5 * (p[:, :3] + q[:, :3]) - 0.125 * (q[:, 3:6] - p[:, 3:6])
    velocity = 0.5 * (p[:, 3:6] + q[:, 3:6]) - 0.125 * np.nan_to_num(q[:, 6:] - p[:, 6:])
    variance = [np.einsum("nii->ni", found.covariance[each])[:, 3:6] for each in (a[in_a], b[in_b])]
    return position, velocity, np.sqrt(0.5 * (variance[0] + variance[1]))


def _groups(every: Together) -> list[Int]:
    """Tracks of two frames and more, in groups of about the same length that fit in memory together."""
    span = every.last - every.first + 1
    order = np.flatnonzero(every.length > 1)
    order = order[np.argsort(span[order], kind="stable")]
    out, begin = [], 0
    while begin < len(order):
        end = begin + 1
        while end < len(order) and span[order[end]] * (end + 1 - begin) <= AT_ONCE:
            end += 1
        out.append(order[begin:end])
        begin = end
    return out


def _from_zero(track: Int) -> Int:
    """Numbers of tracks without gaps, in the order in which they begin; -1 stays."""
    seen, first, inverse = np.unique(track, return_index=True, return_inverse=True)
    rank = np.full(len(seen), -1, np.int64)
    real = np.flatnonzero(seen >= 0)
    rank[real[np.argsort(first[real], kind="stable")]] = np.arange(len(real))
    return rank[inverse]
