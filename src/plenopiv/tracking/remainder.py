"""What splines leave of scattered tracks, interpolated: flow finer than their nodes, where tracks tell of it.

The remainder is taken as a random field of its own (kriging: Matheron 1963, Economic Geology 58; Rasmussen & Williams
2006, Gaussian Processes for Machine Learning, eqs. 2.23 to 2.26) with the covariance s^2 (1 + r) exp(-r), r the
distance in LENGTH mean distances between tracks. Its variance s^2 is that of the remainders nearby beyond the tracks'
own errors, less what chance makes of it: where noise alone is left next to nothing is added. A track that departs far
more than its error and its neighbours explain is believed less. Each component stands by itself, so that what is added
is not free of divergence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

LENGTH = 0.85  # mean distances between tracks
NEARBY = 32  # tracks that tell of a point
AT_A_TIME = 2000  # points
SURE = 1.25  # standard errors that chance exceeds in one case of ten, the larger of two in one of six
OUTLYING = 4.0  # standard deviations, or times what is usual nearby, from which on a track's error is taken as larger
MEDIAN_SQUARE = 0.455  # of a normal deviate
LEAST = 1e-3  # of the variance, that the tracks' errors are taken to have at least

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Remainder:
    """``left`` (n, 3) in m/s at tracks at ``position_mm`` (n, 3), whose errors explain ``noise`` (n, 3), (m/s)^2, of
    its square; ``spacing_mm``: mean distance between tracks."""

    position_mm: Array
    left: Array
    noise: Array
    spacing_mm: float

    def at(self, points_mm: Array) -> tuple[Array, Array, Array]:
        """The remainder (m, 3) in m/s at points (m, 3) in mm; its variance (m, 3) in (m/s)^2 if what tracks leave were
        noise alone, each as large as it is; and the share (m, 3) of its own variance that tracks do not tell of."""
        parts = [self._at(points_mm[n : n + AT_A_TIME]) for n in range(0, len(points_mm), AT_A_TIME)]
        if not parts:
            return np.zeros((0, 3)), np.zeros((0, 3)), np.ones((0, 3))
        values, chance, unknown = (np.concatenate(each) for each in zip(*parts, strict=True))
        return values, chance, unknown

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.position_mm)

    @cached_property
    def _believed(self) -> Array:
        """``noise`` (n, 3), more of it where a track departs OUTLYING times as far from the splines as errors explain
        and others nearby do: near focus a few are a voxel off and do not know it."""
        if not len(self.left):
            return self.noise
        near = self._tree.query(self.position_mm, min(NEARBY, len(self.left)))[1]
        square = self.left**2 / self.noise
        usual = np.maximum(np.median(square[near], 1) / MEDIAN_SQUARE, 1.0)
        return np.asarray(self.noise * np.maximum(square / (OUTLYING**2 * usual), 1.0))

    def _at(self, points: Array) -> tuple[Array, Array, Array]:
        far, near = self._tree.query(points, min(NEARBY, len(self.left)))
        values, chance, unknown = np.zeros((len(points), 3)), np.zeros((len(points), 3)), np.ones((len(points), 3))
        noise = self._believed
        variance = beyond_errors(self.left[near] ** 2 - noise[near], 1.0 / noise[near] ** 2)
        some = np.flatnonzero((variance > 0.0).any(1))
        place, length = self.position_mm[near[some]], LENGTH * self.spacing_mm
        between = _covariance(np.linalg.norm(place[:, :, None] - place[:, None], axis=-1) / length)
        here, diagonal = _covariance(far[some] / length), range(near.shape[1])
        for axis in range(3):
            rows = variance[some, axis] > 0.0
            which, form = some[rows], between[rows]
            own = near[which]
            form[:, diagonal, diagonal] += np.maximum(noise[own, axis] / variance[which, axis, None], LEAST)
            weights = np.linalg.solve(form, here[rows][:, :, None])[:, :, 0]
            values[which, axis] = (weights * self.left[own, axis]).sum(1)
            chance[which, axis] = ((weights * self.left[own, axis]) ** 2).sum(1)
            unknown[which, axis] = np.clip(1.0 - (weights * here[rows]).sum(1), 0.0, 1.0)
        return values, chance, unknown


def beyond_errors(beyond: Array, known: Array, sure: float = SURE) -> Array:
    """Variance (m, 3) that errors do not explain: the mean of ``beyond`` (m, k, 3) over k tracks nearby, of a component
    by itself or of all three, whichever is more, less ``sure`` times the standard error that it has where errors are
    all, so that noise alone adds little; at least 0. ``known`` (m, k, 3): weights, two over the variance of ``beyond``
    there."""
    whole, own = known.sum((1, 2))[:, None], known.sum(1)
    of_all = (known * beyond).sum((1, 2))[:, None] / whole - sure * np.sqrt(2.0 / whole)
    of_own = (known * beyond).sum(1) / own - sure * np.sqrt(2.0 / own)
    return np.asarray(np.maximum(np.maximum(of_all, of_own), 0.0))


def _covariance(apart: Array) -> Array:
    """Of the remainder at places ``apart``, over its variance (Matern, 3/2)."""
    return np.asarray((1.0 + apart) * np.exp(-apart))
