"""Dense ray tracing (DRT): which voxels can hold a particle at all (paper, section 3, Fig. 8).

The paper multiplies the values of all pixels that a voxel's rays reach and keeps the voxel where the product is not
zero. But a particle of E counts does not only light its pixels: it gives each of them at least w E. The least I / w
over a voxel's pixels therefore bounds the light that it can hold. A voxel stays where that bound, each pixel taken
NOISE_MARGIN standard deviations of its noise brighter than measured, reaches the faintest particle looked for.

The product is the bound "> 0"; both are here (``"bound"``, ``"product"``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import Projector
from plenopiv.reconstruction.noise import Noise

LIT_MULTIPLE = 3.0  # a lit pixel stands this many standard deviations of the dark noise above the black level
BRIGHT_SHARE = 0.03  # and this share of what the image's bright pixels (90th percentile) hold
NOISE_MARGIN = 2.0
LONE, CROWDED = 0.2, 0.4  # share of the typical particle that the faintest one holds, in the dark and in a crowd
CROWD = 0.3  # share of the pixels that are lit from which on particles crowd
APART = 8  # microlenses: further than a particle's light spreads in one view


def lit_threshold(lightfield: LightField, noise: Noise) -> float:
    """The count above which a pixel is taken as lit, at least 1."""
    bright = float(np.percentile(lightfield.values[lightfield.layout.seen], 90))
    return max(LIT_MULTIPLE * noise.dark, BRIGHT_SHARE * bright, 1.0)


def most_light(lightfield: LightField, noise: Noise) -> NDArray[np.float32]:
    """The most counts that each pixel (view, lens) may have collected; a saturated one any number."""
    sensor = lightfield.layout.camera.sensor
    saturated = lightfield.values >= sensor.full_scale - sensor.black_level
    bound = np.maximum(lightfield.values, 0) + np.float32(NOISE_MARGIN) * noise.std(lightfield.values)
    bound[saturated] = np.inf
    return bound


def dark_to_light(lightfield: LightField, threshold: float) -> NDArray[np.float32]:
    """The same for the paper's product: none where a pixel does not exceed ``threshold`` counts, else any number."""
    return np.where(lightfield.values > threshold, np.inf, 0.0).astype(np.float32)


def faintest_share(lightfield: LightField, particle: float) -> float:
    """Share of the typical particle that a voxel must be able to hold; ``particle``: its counts in a pixel that it
    lights wholly in focus.

    A particle's light is split among voxels: the more of them stay, the less is lost at its rim. Where few pixels are
    lit that costs nothing; in a crowd it keeps voxels between particles.
    """
    lit = float(np.mean(lightfield.values[lightfield.layout.seen] > LONE * particle))
    return LONE + (CROWDED - LONE) * min(lit / CROWD, 1.0)


def typical_particle(lightfield: LightField, projector: Projector, noise: Noise) -> float:
    """Light of a particle, in counts, all its pixels together, from the pixels' variance and mean.

    Particles strewn at random with density n give a pixel the mean n <E> sum(w) and the variance n <E^2> sum(w^2)
    (Campbell's theorem), sums over the volume. Their ratio is <E^2>/<E>, the typical brightness of those that carry the
    light, whatever n is. The variance is taken between microlenses APART along a row, which takes out a slowly varying
    illumination, and between pixels that see the volume alone and are not saturated.
    """
    where = lightfield.layout
    saturation = where.camera.sensor.full_scale - where.camera.sensor.black_level
    total, squares, _ = projector.sharpness().T
    light = projector.light_of_planes().astype(np.float64)
    step_sums, mean_sums, count = 0.0, 0.0, 0
    for view in projector.whole_views:
        values = lightfield.values[view].reshape(where.nj, where.ni)
        inside = projector.looks_through(int(view)).reshape(where.nj, where.ni)
        inside &= values < saturation
        both = inside[:, APART:] & inside[:, :-APART]
        a, b = values[:, APART:][both].astype(np.float64), values[:, :-APART][both]
        step_sums += float(np.sum((a - b) ** 2))
        mean_sums += float(np.sum(a + b))
        count += a.size
    if not count or mean_sums <= 0:
        return 0.0
    mean = 0.5 * mean_sums / count
    variance = 0.5 * step_sums / count - noise.dark**2 - noise.counts_per_electron * mean
    typical = variance / mean * (light @ total) / (light**2 @ squares)
    return max(float(typical), 0.0)
