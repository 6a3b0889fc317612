"""What a field of tracks does not resolve, for its error bars: by how much it misses tracks that it was not given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from plenopiv.tracking.remainder import beyond_errors

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

    def at(self, points_mm: Array) -> Array:
        """Variance (m, 3) in (m/s)^2 of flow that is not resolved at points (m, 3) in mm, if no track told of it."""
        near = cKDTree(self.position_mm).query(points_mm, min(NEARBY, len(self.position_mm)))[1]
        beyond = beyond_errors((self.square - self.explained)[near], 1.0 / self.explained[near] ** 2)
        return np.asarray(beyond / self.untold[near].mean(1))
