"""Dense ray tracing (DRT): which voxels can hold a particle at all (paper, section 3, Fig. 8).

The paper multiplies the values of all pixels that a voxel's rays reach and keeps the voxel where the product is not
zero. Here the rays are weights: a voxel stays while no more than ``tolerance_px`` pixels' worth of its light falls on
pixels below the threshold. Tolerance 0 is the paper's product; a little tolerance keeps a true voxel of whose 150
pixels noise, or a split of its light between microlenses, has pushed a few under the threshold.
"""

from __future__ import annotations

import numpy as np

from plenopiv.lightfield import LightField

NOISE_MULTIPLE = 3.0  # a lit pixel stands this many standard deviations of the dark noise above the black level
BRIGHT_SHARE = 0.03  # and this share of what the image's bright pixels (90th percentile) hold


def dark_noise(lightfield: LightField) -> float:
    """Standard deviation in counts of pixels without light, from the values below the black level (half a normal)."""
    values = lightfield.values[lightfield.layout.seen]
    below = values[values < 0]
    return float(np.sqrt(np.mean(below.astype(np.float64) ** 2))) if below.size else 0.0


def lit_threshold(lightfield: LightField) -> float:
    """The count above which a pixel is taken as lit, at least 1."""
    bright = float(np.percentile(lightfield.values[lightfield.layout.seen], 90))
    return max(NOISE_MULTIPLE * dark_noise(lightfield), BRIGHT_SHARE * bright, 1.0)
