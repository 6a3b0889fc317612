"""How far smoothing goes: the spectral density of jerk, and the size of position errors, from the tracks themselves.

Each frame's position differs from what the frames before it predict by an innovation e of variance F, both from a
Kalman filter along one axis (``smoothing``). The density q is the one of greatest likelihood,

    -2 ln L = sum (ln F + e^2 / F) ,

over all tracks (Schweppe 1965, IEEE Trans. Inf. Theory 11, 61), and so is the factor by which positions scatter more
than their standard deviations say. The first three frames of a track tell neither: they tell where it begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import plain_kernel
from plenopiv.threads import in_threads
from plenopiv.tracking.smoothing import WIDE, Motion

TELLING = 3  # frames of a track before those whose innovations count
LEAST_INNOVATIONS = 30  # for a likelihood
MOST_TRACKS = 3000  # that are looked at, evenly spaced among all
LARGEST = 16.0  # squared innovation, in variances, that one counts at most: a wrong link
DECADES = (-9, 4)  # of q that are tried, over the variance of a position
FINE = 5  # bisections of the best decade
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


@plain_kernel
def _innovations(
    begin: int, end: int,
    start: NDArray[np.int64], frame: NDArray[np.int64], value: NDArray[np.float64], variance: NDArray[np.float64],
    jerk: float, velocity: float, acceleration: float,  # density of jerk, variances before a track begins
    total: NDArray[np.float64],  # (tracks, 3), filled: sums of ln F and of e^2 / F, and how many
) -> None:  # fmt: skip
    """Sums over the innovations of tracks ``begin`` to ``end`` along one axis."""
    for n in range(begin, end):
        for k in range(3):
            total[n, k] = 0.0
        a = start[n]
        x, v, g = value[a], 0.0, 0.0
        xx, xv, xg, vv, vg, gg = variance[a], 0.0, 0.0, velocity, 0.0, acceleration
        for i in range(a + 1, start[n + 1]):
            for _ in range(frame[i] - frame[i - 1]):
                x, v = x + v + 0.5 * g, v + g
                xx = xx + 2.0 * xv + xg + vv + vg + 0.25 * gg + jerk / 20.0
                xv = xv + xg + vv + 1.5 * vg + 0.5 * gg + jerk / 8.0
                xg = xg + vg + 0.5 * gg + jerk / 6.0
                vv = vv + 2.0 * vg + gg + jerk / 3.0
                vg = vg + gg + jerk / 2.0
                gg = gg + jerk
            e, f = value[i] - x, xx + variance[i]
            if i - a >= TELLING:
                total[n, 0] += np.log(f)
                total[n, 1] += min(e * e / f, LARGEST)
                total[n, 2] += 1.0
            kx, kv, kg = xx / f, xv / f, xg / f
            x, v, g = x + kx * e, v + kv * e, g + kg * e
            gg, vg, vv = gg - kg * xg, vg - kv * xg, vv - kv * xv
            xg, xv, xx = xg - kx * xg, xv - kx * xv, xx - kx * xx


def motion_of(runs: Runs, with_noise: bool = True) -> Motion:
    """How the particles of tracks move. Without ``with_noise`` position errors are taken to be of the size stated.

    Where tracks are too few or too short to tell, acceleration changes by its own spread within a frame.
    """
    tracks = len(runs.start) - 1
    runs = _some(runs, max(-(-tracks // MOST_TRACKS), 1))
    velocity, acceleration = _spreads(runs)
    jerk, noise = acceleration**2, np.ones(3)
    for axis in range(3):
        value, variance = np.ascontiguousarray(runs.position_mm[:, axis]), np.ascontiguousarray(runs.variance[:, axis])
        typical = float(np.median(variance)) if len(variance) else 0.0
        if typical <= 0.0:
            continue
        before = (WIDE * velocity[axis]) ** 2, (WIDE * acceleration[axis]) ** 2
        decades = np.arange(DECADES[0], DECADES[1] + 1.0)
        tried = [(_unlikely(runs, value, variance, typical * 10.0**d, before, with_noise), d) for d in decades]
        if not np.isfinite(tried[0][0][0]):
            continue
        width = 1.0
        for _ in range(FINE):
            width *= 0.5
            best = min(tried)[1]
            tried += [
                (_unlikely(runs, value, variance, typical * 10.0**d, before, with_noise), d)
                for d in (best - width, best + width)
            ]
        (_, noise[axis]), decade = min(tried)
        jerk[axis] = typical * 10.0**decade * noise[axis] ** 2
    return Motion(jerk, velocity, acceleration, noise)


def _unlikely(
    runs: Runs, value: Array, variance: Array, jerk: float, before: tuple[float, float], with_noise: bool
) -> tuple[float, float]:
    """-2 ln L of a density of jerk along an axis, with the likeliest factor of errors, at least 1, and that factor."""
    total = np.empty((len(runs.start) - 1, 3))
    in_threads(_innovations, len(total), runs.start, runs.frame, value, variance, jerk, *before, total)
    logs, squares, count = total.sum(0)
    if count < LEAST_INNOVATIONS:
        return np.inf, 1.0
    scale = max(squares / count, 1.0) if with_noise else 1.0
    return float(logs + count * log(scale) + squares / scale), float(scale**0.5)


def _some(runs: Runs, every: int) -> Runs:
    """Each ``every``-th of the tracks."""
    if every == 1:
        return runs
    taken = np.arange(0, len(runs.start) - 1, every)
    length = np.diff(runs.start)[taken]
    start = np.concatenate([[0], np.cumsum(length)])
    which = np.repeat(runs.start[taken] - start[:-1], length) + np.arange(start[-1])
    return Runs(start, runs.frame[which], runs.position_mm[which], runs.variance[which])


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
