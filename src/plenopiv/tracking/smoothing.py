"""Particles along their tracks: position, velocity and acceleration by a Kalman filter and smoother.

Between frames a particle's jerk j is random, with a spread s and a memory of tau frames along each axis,

    dj = -j / tau dt + s sqrt(2 / tau) dW .

Where the memory is short the acceleration is a random walk, and the best estimate from all frames is the quintic
smoothing spline, of least misfit + 1/q integral of |third derivative|^2 with q = 2 s^2 tau (Wahba 1978, J. R. Stat.
Soc. B 40, 364), which TrackFit's penalised B-splines approximate (Gesemann, Huhn, Schanz & Schroder 2016, 18th Int.
Symp. on Applications of Laser Techniques to Fluid Mechanics); where it is long, paths are smoother still. Both set the
cut-off, and are chosen from all tracks (``cut_off``). Forward in time it is a Kalman filter, which predicts the next
frame, and back again the smoother of Rauch, Tung & Striebel (1965, AIAA J. 3, 1445), with all covariances.

What a frame says of a position is taken as information, not as a covariance: near focus there is none along depth.
Time is in frames, lengths in mm. A state is (x, y, z, their velocities, accelerations, jerks).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

ORDERS = 4  # position, velocity, acceleration, jerk
SIZE = 3 * ORDERS
SOMEWHERE_MM = 1.0  # standard deviation of a position before it is seen, at least
BEYOND = 5.5  # times the camera's prior that is, where that is more
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)  # of a quadrature over a frame
WIDE = 3.0  # times the spread of all particles' velocities and accelerations is that of one before it is seen
UNKNOWN_MM = 1e3  # standard deviation of what no pixel tells
LEAST_TOLD = 1e-6  # of all information, of a direction: there a fit that has not quite ended would name any place
FAST = 2.0  # times the spread of velocities: one that is told to be larger is of another flow, a jet's say
OUTLYING = 4.0  # standard deviations from its track from which on a frame's position counts less

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """How particles move: spread (3,) of the ``jerk`` along each axis, mm / frame^3, and its ``memory`` (3,), frames;
    spread (3,) of all particles' ``velocity``, mm / frame, and ``acceleration``, mm / frame^2; ``noise`` (3,): by what
    factor positions scatter more than their frames say; ``somewhere_mm`` (3,): standard deviation of a position before
    it is seen."""

    jerk: Array
    memory: Array
    velocity: Array
    acceleration: Array
    noise: Array
    somewhere_mm: Array = field(default_factory=lambda: np.full(3, SOMEWHERE_MM))

    @cached_property
    def step(self) -> Array:
        """What a state is multiplied by in a frame (12, 12)."""
        return _by_axes([step_of(memory)[0] for memory in self.memory])

    @cached_property
    def growth(self) -> Array:
        """What is added to its covariance (12, 12)."""
        growths = [jerk**2 * step_of(memory)[1] for jerk, memory in zip(self.jerk, self.memory, strict=True)]
        return _by_axes(growths)


def seen_by(motion: Motion, prior_std_mm: Array | None) -> Motion:
    """``motion`` of particles whose places a camera knows to ``prior_std_mm`` (3,) at the worst."""
    if prior_std_mm is None:
        return motion
    return replace(motion, somewhere_mm=np.maximum(SOMEWHERE_MM, BEYOND * prior_std_mm))


def step_of(memory: float) -> tuple[Array, Array]:
    """What position, velocity, acceleration and jerk along an axis are multiplied by in a frame (4, 4), and what is
    added to their covariance where the jerk's spread is 1 (4, 4)."""
    of_jerk = np.stack(_after_jerk(0.5 * (NODES + 1.0), memory))
    growth = (1.0 / memory) * (of_jerk * WEIGHTS) @ of_jerk.T
    step = np.array([[1.0, 1.0, 0.5, 0.0], [0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    step[:, 3] = [float(each) for each in _after_jerk(np.float64(1.0), memory)]
    return step, growth


def _after_jerk(t: Any, memory: float) -> tuple[Any, Any, Any, Any]:
    """Position, velocity, acceleration and jerk at time t after a jerk of 1."""
    jerk = np.exp(-t / memory)
    acceleration = memory * (1.0 - jerk)
    velocity = memory * (t - acceleration)
    return memory * (0.5 * t * t - velocity), velocity, acceleration, jerk


def _by_axes(each: list[Array]) -> Array:
    """One matrix (12, 12) of those of x, y and z (4, 4)."""
    out = np.zeros((SIZE, SIZE))
    for axis in range(3):
        out[axis::3, axis::3] = each[axis]
    return out


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
        """The same with standard deviations larger by factors (3,), about the positions that pixels alone tell."""
        if (noise == 1.0).all():
            return self
        place, _ = of_pixels(self.position_mm, self.information, self.pull)
        information = self.information / noise[:, None] / noise
        return Sightings(self.position_mm, information, (information @ (place - self.position_mm)[..., None])[..., 0])


def of_pixels(
    position_mm: Array, information: Array, pull: Array, least_told: float = LEAST_TOLD
) -> tuple[Array, Array]:
    """Positions (..., 3) mm that pixels alone tell, and their covariance (..., 3, 3) mm^2, of estimates that a prior
    has pulled (``FrameParticles``). The estimate stays in a direction of which they tell less than ``least_told`` of
    all."""
    least = np.maximum(least_told * np.einsum("...ii->...", information), 1.0 / UNKNOWN_MM**2)
    covariance = np.asarray(np.linalg.inv(information + least[..., None, None] * np.eye(3)), np.float64)
    return position_mm + (covariance @ pull[..., None])[..., 0], covariance


@dataclass(frozen=True)
class States:
    """Estimates of n particles: ``mean`` (..., 12) and ``covariance`` (..., 12, 12), in mm and frames."""

    mean: Array
    covariance: Array


def at_rest(position_mm: Array, motion: Motion) -> States:
    """Particles somewhere near ``position_mm`` (n, 3) before they are seen."""
    mean = np.zeros((len(position_mm), SIZE))
    mean[:, :3] = position_mm
    known = motion.somewhere_mm, WIDE * motion.velocity, WIDE * motion.acceleration, motion.jerk
    return States(mean, np.broadcast_to(np.diag(np.concatenate(known) ** 2), (len(mean), SIZE, SIZE)).copy())


def begun(seen: Sightings, first: NDArray[np.int64], motion: Motion) -> States:
    """``at_rest`` before frame ``first`` (n,), where each is first seen; those that their first two sightings tell to
    be FAST, a few in a jet, may have such a velocity."""
    n, place, covariance = np.arange(len(first)), *of_pixels(seen.position_mm, seen.information, seen.pull)
    start = at_rest(seen.position_mm[n, first], motion)
    later = seen.information.any((2, 3)) & (np.arange(seen.position_mm.shape[1]) > first[:, None])
    second, known = later.argmax(1), later.any(1)
    frames = np.maximum(second - first, 1)[:, None]
    variance = np.einsum("nii->ni", covariance[n, first] + covariance[n, second]) / frames**2
    surely = np.abs(place[n, second] - place[n, first]) / frames - OUTLYING * np.sqrt(variance)
    for axis in range(3):
        fast = known & (surely[:, axis] > FAST * motion.velocity[axis])
        start.covariance[fast, 3 + axis, 3 + axis] = (WIDE * surely[fast, axis]) ** 2
    return start


def moved(states: States, motion: Motion) -> States:
    """The states one frame later."""
    covariance = motion.step @ states.covariance @ motion.step.T + motion.growth
    return States(states.mean @ motion.step.T, covariance)


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


def smoothed(seen: Sightings, motion: Motion, passes: int = 3) -> States:
    """Estimates (n, T, ...) at each frame from all frames; all particles are seen in the first one. Positions far from
    where the other frames have them count less in each further one of ``passes``."""
    seen = seen.scaled(motion.noise)
    first = np.zeros(len(seen.position_mm), np.int64)
    start = begun(seen, first, motion)
    place, _ = of_pixels(seen.position_mm, seen.information, seen.pull)
    weight = np.ones(seen.position_mm.shape[:2])
    for turn in range(passes):
        before, after = filtered(seen.weighted(weight), first, start, motion)
        found = _backward(before, after, motion)
        if turn + 1 < passes:
            off = place - found.mean[:, :, :3]
            chi2 = np.einsum("nti,ntij,ntj->nt", off, seen.information, off)
            weight = np.minimum(OUTLYING**2 / np.maximum(chi2, 1e-30), 1.0)
    return found


def _backward(before: States, after: States, motion: Motion) -> States:
    """The smoother of Rauch, Tung & Striebel: (T, n, ...) -> (n, T, ...)."""
    mean, covariance = after.mean.copy(), after.covariance.copy()
    for t in range(len(mean) - 2, -1, -1):
        moved_on = motion.step @ after.covariance[t]  # G = P F^T P_later^-1, transposed
        gain = np.swapaxes(np.linalg.solve(before.covariance[t + 1], moved_on), 1, 2)
        mean[t] += np.einsum("nij,nj->ni", gain, mean[t + 1] - before.mean[t + 1])
        covariance[t] += gain @ (covariance[t + 1] - before.covariance[t + 1]) @ np.swapaxes(gain, 1, 2)
    return States(np.moveaxis(mean, 0, 1), np.moveaxis(covariance, 0, 1))


def _stacked(states: list[States]) -> States:
    return States(np.stack([one.mean for one in states]), np.stack([one.covariance for one in states]))
