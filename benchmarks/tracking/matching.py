"""True particles and reported ones, one to one, and how well each can be placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.tracking.assignment import cheapest_partners
from plenopiv.tracking.evidence import errors_of
from plenopiv.tracking.light import LightOfPoints
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, refine

ACROSS, DEEP = 1.0, 2.0  # voxels within which a reported particle can be a true one
ALONE = 10.0  # price of one that is not matched, above any match's

Array = NDArray[np.float64]


def matched(truth_mm: Array, found_mm: Array, voxel_mm: Array) -> NDArray[np.int64]:
    """Of each true particle (n, 3) the reported one (m, 3), -1 for none: the cheapest assignment (Hungarian) of those
    within ACROSS voxels in the plane and DEEP in depth."""
    truth, found = truth_mm / voxel_mm, found_mm / voxel_mm
    scale = np.array([1.0, 1.0, ACROSS / DEEP])
    near = cKDTree(truth * scale).query_ball_tree(cKDTree(found * scale), 1.5 * ACROSS)
    t = np.repeat(np.arange(len(truth)), [len(each) for each in near])
    f = np.array([k for each in near for k in each], np.int64)
    off = found[f] - truth[t]
    kept = (np.hypot(off[:, 0], off[:, 1]) <= ACROSS) & (np.abs(off[:, 2]) <= DEEP)
    t, f, off = t[kept], f[kept], off[kept]
    return cheapest_partners(t, f, ((off * scale) ** 2).sum(1), len(truth), len(found), ALONE)


def bound_mm(of_points: LightOfPoints, pixels: Pixels, truth_mm: Array, light: Array) -> Array:
    """Least standard deviation (n, 3) of each true particle among the others (Cramer-Rao), positions and ``light``, in
    counts, unknown."""
    fit = refine(of_points, pixels, truth_mm, light, Prior(truth_mm, np.full(3, 1e3)), 0)
    return np.sqrt(np.einsum("nii->ni", errors_of(fit, pixels.usable)[0]))[:, :3] * fit.unit_mm
