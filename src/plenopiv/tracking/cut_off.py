"""How far smoothing goes: spread and memory of the jerk, and the size of position errors, from the tracks themselves.

Each frame's position differs from what the frames before it predict by an innovation e of variance F, both from a
Kalman filter along one axis (``smoothing``). Spread and memory are those of greatest likelihood over all tracks
(Schweppe 1965, IEEE Trans. Inf. Theory 11, 61). Errors have long tails, as of two particles that are seen as one, so
that it is not the normal distribution's but that of Student's t with nu degrees of freedom (Lange, Little & Taylor
1989, J. Am. Stat. Assoc. 84, 881),

    -2 ln L = sum (ln F + (nu + 1) ln(1 + e^2 / (nu kappa F))) ,

kappa being such that normal errors of variance F make F the likeliest. Where errors hide the jerk, as in depth, none at
all may be as likely as the true one, and without it accelerations would be stated far too well: the jerk is the largest
whose -2 ln L is within 1 of the least, one standard deviation (decision 83). The factor by which positions scatter
more than their standard deviations say is that of 68 % of the innovations. The first three frames of a track tell
neither: they tell where it begins. The filter follows innovations beyond four standard deviations less (Huber 1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import plain_kernel
from plenopiv.threads import in_threads
from plenopiv.tracking.smoothing import OUTLYING, WIDE, Motion, step_of

ONE_STD = 0.683  # of a normal distribution within a standard deviation
TELLING = 3  # frames of a track before those whose innovations count
LEAST_INNOVATIONS = 30  # for a likelihood
MOST_TRACKS = 3000  # that are looked at, evenly spaced among all
DECADES = (-9, 4)  # of q, over the variance of a position, that are tried first
FREEDOM, OF_NORMAL = 4.0, 0.6906  # nu, kappa
MEMORY = 3.0  # frames, that the search begins with
MEMORIES = (0.25, 64.0)  # frames, between which it looks
FINEST = 0.1  # step, of decades of q and of octaves of the memory, at which it ends
ONE_STD_OFF = 1.0  # of -2 ln L, above its least
COVERED, COVERED_STD = 0.95, 1.96  # spreads are those of a normal distribution with the same 95 %

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Runs:
    """Positions of tracks, one after the other: ``start`` (tracks + 1,), where each begins; ``frame`` (m,), rising
    within a track; ``position_mm`` (m, 3) and ``variance`` (m, 3) mm^2."""

    start: NDArray[np.int64]
    frame: NDArray[np.int64]
    position_mm: Array
    variance: Array


def entries_of(start: NDArray[np.int64], which: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of tracks one after the other, which begin at ``start`` (tracks + 1,), those ``which`` alone: where each begins
    then, and the places of their entries."""
    length = np.diff(start)[which]
    begins = np.concatenate([[0], np.cumsum(length)])
    return begins, np.repeat(start[which] - begins[:-1], length) + np.arange(begins[-1])


@plain_kernel
def _innovations(
    begin: int, end: int,
    start: NDArray[np.int64], frame: NDArray[np.int64], value: NDArray[np.float64], variance: NDArray[np.float64],
    step: NDArray[np.float64], growth: NDArray[np.float64],  # (4, 4)
    spread: NDArray[np.float64],  # (4,), variances before a track begins
    log_f: NDArray[np.float64], z: NDArray[np.float64],  # (m,), filled: ln F and |e| / F^1/2; 0 in the first frames
) -> None:  # fmt: skip
    """The innovations of tracks ``begin`` to ``end`` along one axis."""
    x, y, gain = np.empty(4), np.empty(4), np.empty(4)
    p, q = np.empty((4, 4)), np.empty((4, 4))
    for n in range(begin, end):
        a = start[n]
        for i in range(a, start[n + 1]):
            log_f[i], z[i] = 0.0, 0.0
        for i in range(4):
            x[i] = 0.0
            for j in range(4):
                p[i, j] = 0.0
            p[i, i] = spread[i]
        x[0], p[0, 0] = value[a], variance[a]
        for m in range(a + 1, start[n + 1]):
            for _ in range(frame[m] - frame[m - 1]):
                for i in range(4):
                    y[i] = 0.0
                    for k in range(i, 4):
                        y[i] += step[i, k] * x[k]
                    for j in range(4):
                        q[i, j] = 0.0
                        for k in range(i, 4):
                            q[i, j] += step[i, k] * p[k, j]
                for i in range(4):
                    x[i] = y[i]
                    for j in range(i, 4):
                        moved = growth[i, j]
                        for k in range(j, 4):
                            moved += q[i, k] * step[j, k]
                        p[i, j] = moved
                        p[j, i] = moved
            e, f = value[m] - x[0], p[0, 0] + variance[m]
            off = abs(e) / f**0.5
            if m - a >= TELLING:
                log_f[m], z[m] = np.log(f), off
            believed = min(OUTLYING / off, 1.0) if off > 0.0 else 1.0
            for i in range(4):
                gain[i] = believed * p[0, i] / f
                y[i] = p[0, i]
            for i in range(4):
                x[i] += gain[i] * e
                for j in range(4):
                    p[i, j] -= gain[i] * y[j]


def motion_of(runs: Runs, with_noise: bool = True, most_tracks: int = MOST_TRACKS) -> Motion:
    """How the particles of tracks move. Without ``with_noise`` position errors are taken to be of the size stated.
    ``most_tracks``: that are looked at, evenly spaced among all.

    Where tracks are too few or too short to tell, acceleration changes by its own spread within a frame.
    """
    tracks = len(runs.start) - 1
    runs = _some(runs, max(-(-tracks // most_tracks), 1))
    velocity, acceleration = _spreads(runs)
    jerk, memory, noise = acceleration.copy(), np.full(3, MEMORY), np.ones(3)
    for axis in range(3):
        value, variance = np.ascontiguousarray(runs.position_mm[:, axis]), np.ascontiguousarray(runs.variance[:, axis])
        if not len(variance):
            continue
        begun = (WIDE * velocity[axis]) ** 2, (WIDE * acceleration[axis]) ** 2
        search = _Search(runs, value, variance, begun, with_noise)
        if search.enough:
            jerk[axis], memory[axis], noise[axis] = search.best()
    return Motion(jerk, memory, velocity, acceleration, noise)


class _Search:
    """Looks for the likeliest motion along an axis."""

    def __init__(self, runs: Runs, value: Array, variance: Array, begun: tuple[float, float], with_noise: bool):
        self.runs, self.value, self.variance, self.begun, self.with_noise = runs, value, variance, begun, with_noise
        self.typical = float(np.median(variance))
        place = np.arange(len(runs.frame)) - np.repeat(runs.start[:-1], np.diff(runs.start))
        self.telling = np.flatnonzero(place >= TELLING)
        self.log_f, self.z = np.empty(len(runs.frame)), np.empty(len(runs.frame))
        self.known: dict[tuple[float, float], tuple[float, float]] = {}

    @property
    def enough(self) -> bool:
        """Whether the tracks have so many innovations that they tell something."""
        return len(self.telling) >= LEAST_INNOVATIONS

    def best(self) -> tuple[float, float, float]:
        """The largest spread of the jerk that the tracks allow, its memory, and the factor of errors: by decades of q,
        then by steps that are halved where none leads on (compass search)."""
        octave = float(np.log2(MEMORY))
        decade = min((self.at(float(d), octave), float(d)) for d in range(DECADES[0], DECADES[1] + 1))[1]
        at, step = (decade, octave), 1.0
        low, high = np.log2(MEMORIES)
        while step > FINEST:
            step *= 0.5
            while True:
                around = [(at[0] + step, at[1]), (at[0] - step, at[1])]
                around += [(at[0], float(np.clip(at[1] + sign * 4.0 * step, low, high))) for sign in (1, -1)]
                better = min(around, key=lambda one: self.at(*one))
                if not self.at(*better) < self.at(*at):
                    break
                at = better
        least = self.known[at][0]
        while at[0] < DECADES[1] and self.at(at[0] + step, at[1])[0] <= least + ONE_STD_OFF:
            at = (at[0] + step, at[1])
        noise = self.known[at][1]
        return self._jerk(*at) * noise, 2.0 ** at[1], noise

    def _jerk(self, decade: float, octave: float) -> float:
        return float((self.typical * 10.0**decade / (2.0 * 2.0**octave)) ** 0.5)

    def at(self, decade: float, octave: float) -> tuple[float, float]:
        """-2 ln L, but for a constant, at a decade of q and an octave of the memory, with the factor of errors that
        68 % of the innovations have, at least 1, and that factor."""
        if (decade, octave) not in self.known:
            step, growth = step_of(2.0**octave)
            square = self._jerk(decade, octave) ** 2
            spread = np.array([0.0, *self.begun, square])
            fixed = self.runs.start, self.runs.frame, self.value, self.variance, step, square * growth, spread
            in_threads(_innovations, len(self.runs.start) - 1, *fixed, self.log_f, self.z)
            z, scale = self.z[self.telling], 1.0
            if self.with_noise:
                scale = max(float(np.quantile(z, ONE_STD)), 1.0)
            z = z / scale
            tails = (FREEDOM + 1.0) * np.log1p(z * z / (FREEDOM * OF_NORMAL))
            unlikely = float(self.log_f.sum() + 2.0 * len(z) * log(scale) + tails.sum())
            self.known[decade, octave] = unlikely, scale
        return self.known[decade, octave]


def _some(runs: Runs, every: int) -> Runs:
    """Each ``every``-th of the tracks."""
    if every == 1:
        return runs
    taken = np.arange(0, len(runs.start) - 1, every)
    start, at = entries_of(runs.start, taken)
    return Runs(start, runs.frame[at], runs.position_mm[at], runs.variance[at])


def _spreads(runs: Runs) -> tuple[Array, Array]:
    """Root mean squares (3,), but for the outermost, of velocity and acceleration, by differences: position errors are
    in them."""
    same = np.ones(max(len(runs.frame) - 1, 0), bool)
    same[runs.start[1:-1] - 1] = False
    same &= np.diff(runs.frame) == 1
    step = np.diff(runs.position_mm, axis=0)
    bend, both = np.diff(step, axis=0), same[1:] & same[:-1]
    velocity = np.quantile(np.abs(step[same]), COVERED, 0) / COVERED_STD if same.any() else np.zeros(3)
    acceleration = np.quantile(np.abs(bend[both]), COVERED, 0) / COVERED_STD if both.any() else velocity
    return velocity + 1e-9, acceleration + 1e-9
