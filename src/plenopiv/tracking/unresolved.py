"""What a field of tracks does not resolve, for its error bars: by how much it misses tracks that it was not given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from plenopiv.tracking.remainder import SURE, beyond_errors

NEARBY = 32  # tracks held out, at a point

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Unresolved:
    """Of tracks at ``position_mm`` (n, 3) that were held out, splines and remainder being of the others: ``square``
    (n, 3), (m/s)^2, of what they are missed by; ``explained`` (n, 3) of that by the track's error and the scatter of
    fits; ``untold`` (n, 3): share of the remainder's variance of which the others do not tell."""

    position_mm: Array
    square: Array
    explained: Array
    untold: Array

    def at(self, points_mm: Array, believed: ArrayLike = 0.0) -> Array:
        """Variance (m, 3) in (m/s)^2 of flow that is not resolved at points (m, 3) in mm, if no track told of it:
        ``believed``, where that is neither less nor more than tracks held out allow."""
        near = cKDTree(self.position_mm).query(points_mm, min(NEARBY, len(self.position_mm)))[1]
        beyond, known = (self.square - self.explained)[near], 1.0 / self.explained[near] ** 2
        least, most = (beyond_errors(beyond, known, sure) / self.untold[near].mean(1) for sure in (SURE, -SURE))
        return np.asarray(np.clip(believed, least, most))
