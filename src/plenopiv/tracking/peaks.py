"""Local maxima of a reconstructed volume: the first guess of where particles are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, uniform_filter

from plenopiv.volume import Volume

SLAB = 32  # planes that are dense in memory at a time
SMOOTHING = (0.7, 0.6, 0.6)  # voxels along z, y, x: a particle's voxels have one maximum
AROUND = (2, 1, 1)  # voxels on each side within which a maximum is the largest
LIGHT = (7, 5, 5)  # voxels, sides of the box whose light is counted as a peak's
FAINT = 0.05  # of the light of a typical peak: fainter ones are left out

Array = NDArray[np.float64]


def peaks(volume: Volume) -> tuple[Array, Array]:
    """Positions (n, 3) in mm of a volume's local maxima, to a fraction of a voxel by parabolas, and their light (n,),
    the sum of the box of voxels around each, in the volume's unit.

    Maxima with less than FAINT of the light of a typical one, the median weighed with light, are left out.
    """
    nz = volume.grid.shape[0]
    margin = max(LIGHT[0] // 2, AROUND[0]) + 4  # the smoothing's reach as well
    places, lights = [], []
    for low in range(0, nz, SLAB):
        high = min(low + SLAB, nz)
        values = volume.slab(low - margin, high + margin)
        smooth = gaussian_filter(values, SMOOTHING, mode="constant", truncate=4.0)
        largest = maximum_filter(smooth, tuple(2 * a + 1 for a in AROUND), mode="constant")
        inside = slice(margin, margin + high - low)
        k, j, i = np.nonzero((smooth[inside] == largest[inside]) & (smooth[inside] > 0))
        k += margin
        around = uniform_filter(values.astype(np.float64), LIGHT, mode="constant")[k, j, i] * np.prod(LIGHT)
        offset = np.stack([_parabola(smooth, (k, j, i), axis) for axis in (2, 1, 0)], -1)
        index = np.stack([i, j, k - margin + low], -1) + offset
        places.append(np.asarray(volume.grid.first_mm) + index * np.asarray(volume.grid.voxel_mm))
        lights.append(around)
    position, light = np.concatenate(places), np.concatenate(lights)
    if not len(light):
        return position, light
    order = np.argsort(light)
    typical = light[order][np.searchsorted(np.cumsum(light[order]), 0.5 * light.sum())]
    kept = light > FAINT * typical
    return position[kept], light[kept]


def _parabola(values: NDArray, at: tuple[NDArray, NDArray, NDArray], axis: int) -> Array:
    """How far, in voxels, the top of a parabola through a maximum and its two neighbours along an axis is from it."""
    before, after = list(at), list(at)
    before[axis] = np.maximum(at[axis] - 1, 0)
    after[axis] = np.minimum(at[axis] + 1, values.shape[axis] - 1)
    low, middle, high = (values[tuple(where)].astype(np.float64) for where in (before, at, after))
    bend = 2.0 * middle - low - high
    return np.clip(np.where(bend > 0, 0.5 * (high - low) / np.where(bend > 0, bend, 1.0), 0.0), -0.5, 0.5)
