"""A frame whose particles are known beforehand: fitted from where their tracks predict them, and no reconstruction.

All predicted particles are moved at once until they explain the raw pixels ("shaken", Schanz, Gesemann & Schroder 2016,
Exp. Fluids 57, 70), each with the prediction as prior: near focus, where pixels tell no depth, the track does. Those
that the pixels do not speak for are lost for this frame, others are found in what is left, as in any frame. A particle
that ends far from where it was predicted, or with another light, is not that particle but a new one. New particles that
are where a lost one may have come to go on with its track.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.frame import FrameParticles
from plenopiv.tracking.links import GATE, LIGHT_STD, cheapest
from plenopiv.tracking.predict import Predicted
from plenopiv.tracking.smoothing import of_pixels

FEWEST = 0.5  # of the particles predicted: fewer found, and the prediction was wrong
LIGHT_OF_A_TRACK = 0.1  # relative standard deviation of the light predicted

Array = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Followed:
    """Which track (n,) each particle of a frame is of, new ones having numbers of their own; ``kept``: how many of the
    tracks predicted were found; ``off_mm`` (3,): how far, root mean square but for the outermost, from there."""

    track: Int
    kept: int
    off_mm: Array


def followed(found: FrameParticles, origin: Int, by: Predicted, unused: int) -> Followed:
    """The tracks of the particles ``found`` in a frame that began at those predicted, ``origin`` (n,), -1 for new ones.
    Numbers from ``unused`` on are those of new tracks."""
    track = np.full(len(found.light), -1, np.int64)
    ratio, fitted = _ratio(found, origin, by), found.position_mm
    found = _by_pixels(found)
    own = np.flatnonzero(origin >= 0)
    own = own[_cost(found, own, by, origin[own], ratio) < GATE]
    track[own] = by.track[origin[own]]
    off = np.abs(fitted[own] - by.position_mm[origin[own]])
    lost = np.setdiff1d(np.arange(len(by.track)), origin[own])
    new = np.flatnonzero(track < 0)
    if len(lost) and len(new):
        none = np.zeros((len(lost), 3))
        again = cheapest(_as_particles(by, lost), found.of(new), none, none, ratio, np.inf)
        track[new[again.b]] = by.track[lost[again.a]]
    kept = int((track >= 0).sum())
    fresh = track < 0
    track[fresh] = unused + np.arange(fresh.sum())
    return Followed(track, kept, np.quantile(off, 0.683, 0) if len(off) else np.zeros(3))


def _by_pixels(found: FrameParticles) -> FrameParticles:
    """The particles where pixels alone have them: the prediction that they began at has pulled them towards it."""
    if found.information is None or found.pull is None:
        return found
    place, covariance = found.position_mm, found.covariance.copy()
    place, covariance[:, :3, :3] = of_pixels(place, found.information, found.pull)
    return replace(found, position_mm=place, covariance=covariance)


def _ratio(found: FrameParticles, origin: Int, by: Predicted) -> float:
    """Logarithm of this frame's light over that predicted."""
    own = origin >= 0
    return float(np.median(np.log(found.light[own] / by.light[origin[own]]))) if own.any() else 0.0


def _cost(found: FrameParticles, own: Int, by: Predicted, origin: Int, ratio: float) -> Array:
    """chi^2 with four degrees of freedom of the particles ``own`` against where and how bright they were predicted."""
    off = found.position_mm[own] - by.position_mm[origin]
    covariance = found.covariance[own][:, :3, :3] + by.covariance[origin]
    cost = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[:, :, None])[:, :, 0])
    brighter = np.log(found.light[own] / by.light[origin]) - ratio
    relative = found.covariance[own, 3, 3] / found.light[own] ** 2
    return np.asarray(cost + brighter**2 / (relative + LIGHT_OF_A_TRACK**2 + LIGHT_STD**2))


def _as_particles(by: Predicted, which: Int) -> FrameParticles:
    covariance = np.zeros((len(which), 4, 4))
    covariance[:, :3, :3] = by.covariance[which]
    covariance[:, 3, 3] = (LIGHT_OF_A_TRACK * by.light[which]) ** 2
    return FrameParticles(by.position_mm[which], by.light[which], covariance, np.ones(len(which)), np.nan)
