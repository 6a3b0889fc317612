"""Particles along their tracks: position, velocity and acceleration by a Kalman filter and smoother.

Between frames a particle's jerk is white noise of spectral density q along each axis, so that its acceleration is a
random walk; the best estimate from all frames is then a quintic smoothing spline (Wahba 1978, J. R. Stat. Soc. B 40,
364), the one of least

    sum over frames of the pixels' misfit  +  1/q integral of |third derivative|^2 .

This is what TrackFit's penalised B-splines approximate (Gesemann, Huhn, Schanz & Schroder 2016, 18th Int. Symp. on
Applications of Laser Techniques to Fluid Mechanics); q sets its cut-off, as there the weight of the penalty
(``cut_off``). Forward in time it is a Kalman filter, which predicts the next frame, and back again the smoother of
Rauch, Tung & Striebel (1965, AIAA J. 3, 1445), with the covariances of all nine quantities.

What a frame says of a position is taken as information, not as a covariance: near focus there is none along depth.
Time is in frames, lengths in mm. A state is (x, y, z, their velocities, their accelerations).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STEP = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])  # of position, velocity, acceleration in a frame
GROWTH = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])  # of their covariance, over q
SOMEWHERE_MM = 1.0  # standard deviation of a position before it is seen
WIDE = 3.0  # times the spread of all particles' velocities and accelerations is that of one before it is seen
OUTLYING = 4.0  # standard deviations from its track from which on a frame's position counts less (Huber 1981)

Array = NDArray[np.float64]
MOVE = np.kron(STEP, np.eye(3))


@dataclass(frozen=True)
class Motion:
    """How particles move: ``jerk`` (3,), the spectral density of jerk along each axis, mm^2 / frame^5; spread (3,) of
    all particles' ``velocity``, mm / frame, and ``acceleration``, mm / frame^2; ``noise`` (3,): by what factor
    positions scatter more than their frames say."""

    jerk: Array
    velocity: Array
    acceleration: Array
    noise: Array


@dataclass(frozen=True)
class Sightings:
    """What T frames, one after the other, say of n particles: ``position_mm`` (n, T, 3), ``information`` (n, T, 3, 3)
    mm^-2 and ``pull`` (n, T, 3) mm^-1 (``FrameParticles``), 0 where one is not seen."""

    position_mm: Array
    information: Array
    pull: Array

    def weighted(self, weight: Array) -> Sightings:
        """The same, each counting ``weight`` (n, T)."""
        return Sightings(self.position_mm, weight[:, :, None, None] * self.information, weight[:, :, None] * self.pull)

    def scaled(self, noise: Array) -> Sightings:
        """The same with standard deviations larger by factors (3,)."""
        return Sightings(self.position_mm, self.information / noise[:, None] / noise, self.pull / noise**2)


@dataclass(frozen=True)
class States:
    """Estimates of n particles: ``mean`` (..., 9) and ``covariance`` (..., 9, 9), in mm and frames."""

    mean: Array
    covariance: Array


def at_rest(position_mm: Array, motion: Motion) -> States:
    """Particles somewhere near ``position_mm`` (n, 3) before they are seen."""
    mean = np.zeros((len(position_mm), 9))
    mean[:, :3] = position_mm
    spread = np.concatenate([np.full(3, SOMEWHERE_MM), WIDE * motion.velocity, WIDE * motion.acceleration]) ** 2
    return States(mean, np.broadcast_to(np.diag(spread), (len(mean), 9, 9)).copy())


def moved(states: States, motion: Motion) -> States:
    """The states one frame later."""
    covariance = MOVE @ states.covariance @ MOVE.T + np.kron(GROWTH, np.diag(motion.jerk))
    return States(states.mean @ MOVE.T, covariance)


def updated(states: States, position_mm: Array, information: Array, pull: Array) -> States:
    """The states with what a frame says of the positions (n, 3) known as well.

    With R^-1 = L, the gain P H^T (S + R)^-1 is P H^T (L S + 1)^-1 L, which needs no inverse of L.
    """
    along = states.covariance[:, :, :3]
    gain = along @ np.linalg.inv(information @ along[:, :3] + np.eye(3))
    off = position_mm - states.mean[:, :3]
    slope = np.einsum("nij,nj->ni", information, off) + pull
    covariance = states.covariance - gain @ information @ np.swapaxes(along, 1, 2)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    return States(states.mean + np.einsum("nij,nj->ni", gain, slope), covariance)


def filtered(seen: Sightings, first: NDArray[np.int64], start: States, motion: Motion) -> tuple[States, States]:
    """Estimates (T, n, ...) at each frame from the frames before it, and from these and itself. Particle k is first
    seen in frame ``first[k]``, before which it is as ``start`` says; there is nothing of it in earlier frames."""
    before, after, now = [], [], start
    for t in range(seen.position_mm.shape[1]):
        if t > 0:
            later, fresh = moved(now, motion), first >= t
            now = States(
                np.where(fresh[:, None], start.mean, later.mean),
                np.where(fresh[:, None, None], start.covariance, later.covariance),
            )
        before.append(now)
        now = updated(now, seen.position_mm[:, t], seen.information[:, t], seen.pull[:, t])
        after.append(now)
    return _stacked(before), _stacked(after)


def smoothed(seen: Sightings, motion: Motion, passes: int = 2) -> States:
    """Estimates (n, T, ...) at each frame from all frames; all particles are seen in the first one. Positions far from
    where the other frames have them count less in each further one of ``passes``."""
    seen = seen.scaled(motion.noise)
    start, first = at_rest(seen.position_mm[:, 0], motion), np.zeros(len(seen.position_mm), np.int64)
    weight = np.ones(seen.position_mm.shape[:2])
    for turn in range(passes):
        before, after = filtered(seen.weighted(weight), first, start, motion)
        found = _backward(before, after)
        if turn + 1 < passes:
            off = seen.position_mm - found.mean[:, :, :3]
            chi2 = np.einsum("nti,ntij,ntj->nt", off, seen.information, off)
            weight = np.minimum(OUTLYING / np.sqrt(np.maximum(chi2, 1e-30)), 1.0)
    return found


def _backward(before: States, after: States) -> States:
    """The smoother of Rauch, Tung & Striebel: (T, n, ...) -> (n, T, ...)."""
    mean, covariance = after.mean.copy(), after.covariance.copy()
    for t in range(len(mean) - 2, -1, -1):
        moved_on = MOVE @ after.covariance[t]  # G = P F^T P_later^-1, transposed
        gain = np.swapaxes(np.linalg.solve(before.covariance[t + 1], moved_on), 1, 2)
        mean[t] += np.einsum("nij,nj->ni", gain, mean[t + 1] - before.mean[t + 1])
        covariance[t] += gain @ (covariance[t + 1] - before.covariance[t + 1]) @ np.swapaxes(gain, 1, 2)
    return States(np.moveaxis(mean, 0, 1), np.moveaxis(covariance, 0, 1))


def _stacked(states: list[States]) -> States:
    return States(np.stack([one.mean for one in states]), np.stack([one.covariance for one in states]))
