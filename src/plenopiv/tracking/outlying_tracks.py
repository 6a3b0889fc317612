"""Short tracks that no particle is likely to have made: their velocity departs from their neighbours'.

Three places in three frames are always a parabola, so that a ghost and a particle, or two particles, may pass for one.
A long track tells by itself that it is one particle. Those around a short one say how fast it should be: a linear fit
through their velocities, as links of two frames have (``links.of_neighbours``), and how far particles here depart from
such a fit. This is the test of outlying vectors of PIV for tracks (Duncan, Dabiri, Hove & Gharib 2010, Meas. Sci.
Technol. 21, 057002), with the errors of both known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.links import COVERED, COVERED_STD, NEIGHBOURS, of_neighbours, scatter_around

LONG = 8  # frames that a track must be seen in to be judged by itself; of a shorter sequence all of them
MOST = 25.0  # chi^2 of three velocities: normal ones exceed it once in 65,000

Array = NDArray[np.float64]
Int = NDArray[np.int64]


def outlying(frame: Int, track: Int, mean: Array, covariance: Array) -> NDArray[np.bool_]:
    """Which sightings (m,) are of tracks that depart from their neighbours. ``frame`` and ``track`` (m,), the latter -1
    without one; ``mean`` (m, 9) and ``covariance`` (m, 9, 9) as ``Trajectories``. A track is judged in the middle one
    of its frames, and only where more than NEIGHBOURS long ones are seen."""
    on_track = np.flatnonzero(track >= 0)
    order = on_track[np.lexsort((frame[on_track], track[on_track]))]
    _, start, length = np.unique(track[order], return_index=True, return_counts=True)
    long = np.zeros(len(track), bool)
    enough = length >= min(LONG, len(np.unique(frame)))
    long[order] = np.repeat(enough, length)
    middle = order[start + length // 2][~enough]
    out = np.zeros(len(track), bool)
    for number in np.unique(frame[middle]):
        asked = middle[frame[middle] == number]
        around = np.flatnonzero(long & (frame == number))
        if len(around) <= NEIGHBOURS + 1:
            continue
        both = np.concatenate([around, asked])
        linked = np.arange(len(around))
        velocity, variance = mean[both, 3:6], np.einsum("nii->ni", covariance[both])[:, 3:6]
        off = velocity - of_neighbours(mean[both, :3], linked, velocity[linked])
        beyond = off[linked] ** 2 - variance[linked]
        usual = (np.quantile(np.abs(off[linked]), COVERED, 0) / COVERED_STD) ** 2 - np.median(variance[linked], 0)
        scatter = scatter_around(mean[both, :3], linked, beyond, np.sqrt(np.maximum(usual, 0.0) + 1e-12))
        own = covariance[asked, 3:6, 3:6].copy()
        own[:, range(3), range(3)] += scatter[len(around) :] ** 2
        left = off[len(around) :]
        chi2 = np.einsum("ni,ni->n", left, np.linalg.solve(own, left[:, :, None])[:, :, 0])
        out[asked] = chi2 > MOST
    return np.asarray(np.isin(track, track[out]) & (track >= 0), np.bool_)
