"""Whether the volume explains the light of a frame: particles before or behind it, static light and counts that are not
proportional to light leave more of it over than reconstruction does.

What is left is compared in a few views, in pixels whose rays cross the whole depth inside the volume, so that a volume
smaller than the field of view is no fault. Of simulated recordings with nothing wrong 0.15 to 0.29 of the light's
spread are left (0.1 to 6 particles per microlens, 8 to 28 pixels across one); with a third of the depth cut off it is
0.51, with half of it 0.65.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.noise import Noise
from plenopiv.volume import SparseVolume

VIEWS = 8  # that are compared
FEWEST = 500  # pixels of them
CLEAR = 2.0  # times the noise that the light's spread must be, before the rest tells anything
MOST_LEFT = 0.4


def unexplained_share(
    projector: PlenopticProjector, volume: SparseVolume, image: NDArray, noise: Noise
) -> float | None:
    """RMS difference between a frame (upright image in counts) and the light of its reconstructed ``volume``, over the
    standard deviation of the frame's light, both without noise; None where too few pixels see nothing but the volume,
    or noise hides it."""
    sensor = projector.layout.camera.sensor
    whole = projector.whole_views
    views = (
        whole[np.unique(np.linspace(0, len(whole) - 1, min(VIEWS, len(whole))).astype(int))] if len(whole) else whole
    )
    inside = np.array([projector.rays_inside_grid(int(view)) for view in views])
    if np.count_nonzero(inside) < FEWEST:
        return None
    values = projector.values_of([image])[views]
    inside &= values < sensor.full_scale - sensor.black_level
    seen = values[inside].astype(np.float64)
    if seen.size < FEWEST:
        return None
    rest = seen - projector.forward(views, volume)[inside]
    variance = noise.dark**2 + noise.counts_per_electron * max(float(seen.mean()), 0.0)
    spread = float(seen.var()) - variance
    if spread < CLEAR**2 * variance:
        return None
    return float(np.sqrt(max(float(np.mean(rest**2)) - variance, 0.0) / spread))


def finding(share: float | None, name: str) -> Finding | None:
    """A finding where the light of frame ``name`` is not that of particles in the volume."""
    if share is None or share < MOST_LEFT:
        return None
    return Finding(
        "unexplained-light",
        "warning",
        f"{100 * share:.0f} % of the light's contrast in {name} is not that of particles in the volume (15 to 30 % are "
        "usual)",
        100 * share,
        "%",
        "widen volume.z_mm if particles before or behind it are lit; else there is static light, or a wrong black "
        "level or camera: ask plenopiv check",
    )
