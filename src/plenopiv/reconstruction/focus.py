"""What light counts in the correlation by its distance from the focal plane.

Within the dead zone |z| < z0 a particle's light falls under one microlens: the volume shows the microlens, at its own
fixed place and through all of the zone, not the particle. Such blobs repeat from frame to frame on the lattice of the
microlenses and pull every window that holds them toward zero displacement or a multiple of the pitch. Beyond the zone
the blur |A| P_m spans |z|/z0 microlenses, and that many places of its edge tell where the particle is.

What is correlated is therefore weighed by (|z| / (reach z0))^1.5 up to the reach of two half dead zones. Steeper
weights do more where light is plenty, and less where much of it is lost (docs/decisions/0012, with measurements).
``displacement.depth_weights`` says how, so that nothing is pulled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera

POWER = 1.5
LEAST = 1e-3  # in focus: windows of nothing else still have a vector
NEAR = 1.5  # half dead zones, within which displacements in depth are off by more than their error bars say


def focus_weight(camera: PlenopticCamera, z_mm: NDArray[np.float64], reach: float) -> NDArray[np.float32]:
    """Weight of light at ``z_mm``, in its shape, nearly 0 in focus, 1 from ``reach`` half dead zones on. ``reach`` 0:
    all 1."""
    if reach == 0:
        return np.ones(z_mm.shape, np.float32)
    return np.clip((camera.dead_zones(z_mm) / reach) ** POWER, LEAST, 1).astype(np.float32)


def near_focus(
    camera: PlenopticCamera, one_end_mm: NDArray[np.float64], other_end_mm: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which windows see much light without depth, in the shape of z of the two ends of the middle half of each: a place
    between them lies within NEAR half dead zones."""
    low, high = np.minimum(one_end_mm, other_end_mm), np.maximum(one_end_mm, other_end_mm)
    return camera.dead_zones(np.clip(0.0, low, high)) < NEAR
