"""Weights of planes near focus in the correlation.

Within the dead zone |z| < z0 a particle's light falls under one microlens: the volume shows the microlens, at its own
fixed place and through all of the zone, not the particle. Such blobs repeat from frame to frame on the lattice of the
microlenses and pull every window that holds them toward zero displacement or a multiple of the pitch. Beyond the zone
the blur |A| P_m spans |z|/z0 microlenses, and that many places of its edge tell where the particle is.

Planes are therefore weighed by (|z| / (reach z0))^2 up to |z| = reach z0 before they are correlated. In uniform and
sheared flows the errors of the windows at focus fall two- to threefold in-plane and by a fifth in depth; a longer reach
does more for depth, but where the flow curves along z a window at focus then measures its ends more than its middle
(docs/decisions/0012, with the measurements).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera


def focus_weight(camera: PlenopticCamera, z_mm: NDArray[np.float64], reach: float) -> NDArray[np.float32]:
    """Weight of each plane at ``z_mm``, 0 in focus to 1 from ``reach`` dead zones on. ``reach`` 0: all 1."""
    if reach == 0:
        return np.ones(z_mm.shape, np.float32)
    below, above = camera.dead_zone_mm()
    zone = np.where(z_mm < 0, -below, above)
    return (np.minimum(np.abs(z_mm) / (reach * zone), 1.0) ** 2).astype(np.float32)
