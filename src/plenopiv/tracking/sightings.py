"""Particles of many frames by their tracks: tables of where each was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.cut_off import Runs, entries_of
from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.smoothing import Sightings, of_pixels

Array = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class SeenFrame:
    """The particles of frame ``number``, from 0, and the track (n,) that each belongs to; no two have the same."""

    number: int
    particles: FrameParticles
    track: Int


@dataclass(frozen=True)
class Together:
    """The particles of several frames, one after the other, sorted by track and frame. ``track`` (m,), ``frame`` (m,);
    ``origin`` (m,): place in the frames one after the other; ``position_mm``, ``information``, ``pull`` and ``light``
    as ``FrameParticles``; ``start`` (tracks + 1,): where each track begins."""

    track: Int
    frame: Int
    origin: Int
    position_mm: Array
    information: Array
    pull: Array
    light: Array
    start: Int

    def of(self, which: Int) -> Together:
        """The tracks ``which``, by number in the order of ``start``, alone."""
        start, at = entries_of(self.start, which)
        of_pixels = self.position_mm[at], self.information[at], self.pull[at], self.light[at]
        return Together(self.track[at], self.frame[at], self.origin[at], *of_pixels, start)

    @property
    def length(self) -> Int:
        """In how many frames each track is seen (tracks,)."""
        return np.diff(self.start)

    @property
    def first(self) -> Int:
        """The first frame of each track (tracks,)."""
        return self.frame[self.start[:-1]]

    @property
    def last(self) -> Int:
        """The last one."""
        return self.frame[self.start[1:] - 1]

    def sightings(self, begin: Int, frames: int) -> Sightings:
        """What ``frames`` frames from ``begin`` (tracks,) on say of each track."""
        tracks = len(self.start) - 1
        row, at = np.repeat(np.arange(tracks), self.length), self.frame - np.repeat(begin, self.length)
        position, pull = np.zeros((tracks, frames, 3)), np.zeros((tracks, frames, 3))
        information = np.zeros((tracks, frames, 3, 3))
        position[row, at], pull[row, at], information[row, at] = self.position_mm, self.pull, self.information
        return Sightings(position, information, pull)

    def runs(self) -> Runs:
        """The positions that pixels alone tell, and their variances along each axis."""
        alone, covariance = of_pixels(self.position_mm, self.information, self.pull, 0.0)
        return Runs(self.start, self.frame, alone, np.einsum("nii->ni", covariance).copy())


def together(frames: Sequence[SeenFrame]) -> Together:
    """The particles of ``frames``, in the order of time, by track. Where it is not known what pixels alone say, the
    covariance does."""
    track = np.concatenate([one.track for one in frames])
    frame = np.repeat([one.number for one in frames], [len(one.track) for one in frames]).astype(np.int64)
    order = np.lexsort((frame, track))
    said = [_of_pixels(one.particles) for one in frames]
    begins = np.flatnonzero(np.diff(track[order], prepend=-1))
    return Together(
        track[order],
        frame[order],
        order,
        np.concatenate([one.particles.position_mm for one in frames]).reshape(-1, 3)[order],
        np.concatenate([information for information, _ in said])[order],
        np.concatenate([pull for _, pull in said])[order],
        np.concatenate([one.particles.light for one in frames])[order],
        np.append(begins, len(order)).astype(np.int64),
    )


def _of_pixels(particles: FrameParticles) -> tuple[Array, Array]:
    if particles.information is not None and particles.pull is not None:
        return particles.information, particles.pull
    return np.asarray(np.linalg.inv(particles.covariance[:, :3, :3])), np.zeros_like(particles.position_mm)
