"""What share of its light a voxel sends into usable pixels, where some are masked, hot, or full of static light.

Behind lost pixels MART has too few equations to take light away from voxels that hold no particle: what it started with
is left in both frames, in the same place, and pulls displacements toward zero. In the correlation a voxel therefore
counts by its share, to the power of four (``Chain.weighted``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.protocol import Projection
from plenopiv.volume import SparseVolume

TOGETHER = 8  # views gathered at once


def usable_share(projection: Projection, whole: Projection, volume: SparseVolume) -> NDArray[np.float32]:
    """For each listed voxel the share, 0 to 1, of its light in the pixels that ``projection`` uses; ``whole``: the same
    cameras with all their pixels (``PlenopticProjector.whole``)."""
    used, lit = np.zeros((2, volume.values.size), np.float32)
    ones, equations = whole.seen.astype(np.float32), projection.seen.astype(np.float32)
    for first in range(0, whole.views, TOGETHER):
        views = np.arange(first, min(first + TOGETHER, whole.views))
        used += whole.gather(views, equations[views], volume)
        lit += whole.gather(views, ones[views], volume)
    return np.clip(used / np.maximum(lit, np.finfo(np.float32).tiny), 0, 1, dtype=np.float32)
