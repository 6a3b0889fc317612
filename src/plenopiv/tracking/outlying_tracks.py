"""Short tracks that no particle is likely to have made: their velocity departs from their neighbours'.

Three places in three frames are always a parabola, so that a ghost and a particle, or two particles, may pass for one.
The tracks around say how fast it should be: a linear fit through their velocities, as links of two frames have
(``links.of_neighbours``), and how far particles here depart from such fits. Of PIV's tests of outlying vectors it is a
relative of that for unevenly spaced ones (Duncan, Dabiri, Hove & Gharib 2010, Meas. Sci. Technol. 21, 057002), with a
slope, and errors that are known.

Neighbours are tracks of all lengths: particles that are fast, or have just come in, are all on short ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.tracking.links import NEIGHBOURS, of_neighbours, scatter_about

LONG = 8  # frames from which on a track speaks for itself; of a shorter sequence all of them
MOST = 36.0  # chi^2 of three velocities: six standard deviations along one, as flow is not linear between neighbours
PASSES = 3  # in which those that were found are no neighbours

Array = NDArray[np.float64]
Int = NDArray[np.int64]


def outlying(frame: Int, track: Int, mean: Array, covariance: Array) -> NDArray[np.bool_]:
    """Which sightings (m,) are of tracks that depart from their neighbours. ``frame`` and ``track`` (m,), the latter -1
    without one; ``mean`` (m, 9) and ``covariance`` (m, 9, 9) as ``Trajectories``. A track of fewer than LONG frames is
    judged in each of them where more than NEIGHBOURS + 1 tracks are seen."""
    on_track = np.flatnonzero(track >= 0)
    by_frame = on_track[np.argsort(frame[on_track], kind="stable")]
    _, own, length = np.unique(track[on_track], return_inverse=True, return_counts=True)
    asked = np.zeros(len(track), bool)
    asked[on_track] = (length < min(LONG, len(np.unique(frame))))[own]
    out = np.zeros(len(track), bool)
    for _ in range(PASSES):
        found = np.zeros(len(track), bool)
        for some in np.split(by_frame, np.flatnonzero(np.diff(frame[by_frame])) + 1):
            if asked[some].any():
                found[some[asked[some]]] = _departing(mean[some], covariance[some], asked[some], ~out[some])
        before, out = out, np.asarray(np.isin(track, track[found]) & (track >= 0), np.bool_)
        if (out == before).all():
            break
    return out


def _departing(mean: Array, covariance: Array, asked: NDArray[np.bool_], taken: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the particles ``asked`` of one frame depart from those ``taken`` as neighbours."""
    linked, place, velocity = np.flatnonzero(taken), mean[:, :3], mean[:, 3:6]
    if len(linked) <= NEIGHBOURS + 1:
        return np.zeros(asked.sum(), bool)
    off = velocity - of_neighbours(place, linked, velocity[linked])
    variance = np.einsum("nii->ni", covariance[linked])[:, 3:6]
    _, scatter = scatter_about(place, linked, np.abs(off[linked]), variance)
    own, left = covariance[asked, 3:6, 3:6].copy(), off[asked]
    own[:, range(3), range(3)] += scatter[asked] ** 2
    return np.asarray(np.einsum("ni,ni->n", left, np.linalg.solve(own, left[:, :, None])[:, :, 0]) > MOST)
