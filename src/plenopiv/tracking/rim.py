"""Pixels that the rim of the main lens clips: no equations for the fit, which knows the aperture alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera

DEEP_PX = 0.05  # by which the rim must cut into the aperture's image to count
BEFORE_PX = 0.8  # a pixel whose centre is nearer to the rim than this may be cut
TOGETHER = 128  # rows worked on at a time


def clipped_by_rim(camera: PlenopticCamera) -> NDArray[np.bool_] | None:
    """Pixels (rows, columns) of an upright image whose light the rim of the main lens clips, in part or all of it; None
    where nothing does.

    In the direction in which a pixel lies from the middle of its micro-image the rim is at a distance of
    m cos(turn) + sqrt(R^2 - m^2 sin^2(turn)), R the rim's radius and m how far its middle is off.
    """
    rim, sensor = camera.rim, camera.sensor
    if rim is None:
        return None
    px, pitch = camera.portion_mm, sensor.pixel_pitch_mm
    column0, row0 = sensor.axis
    out = np.empty((sensor.rows, sensor.columns), bool)
    columns = np.arange(sensor.columns, dtype=np.float64)
    whole = 1.0 + camera.image_scale
    for first in range(0, sensor.rows, TOGETHER):
        rows = np.arange(first, min(first + TOGETHER, sensor.rows), dtype=np.float64)[:, None]
        s, t = np.broadcast_arrays((column0 - columns) * pitch / whole, (rows - row0) * pitch / whole)
        lens_s, lens_t = camera.lattice.centres(*camera.lattice.nearest(s, t))
        x = columns - (column0 - lens_s * whole / pitch)
        y = rows - (row0 + lens_t * whole / pitch)
        middle_x = (rim.slip * lens_s + rim.start_mm[0]) / px
        middle_y = -(rim.slip * lens_t + rim.start_mm[1]) / px
        away = np.maximum(np.hypot(x, y), 1e-9)
        along = (x * middle_x + y * middle_y) / away
        across = middle_x**2 + middle_y**2 - along**2
        edge = along + np.sqrt(np.maximum((rim.radius_mm / px) ** 2 - across, 0.0))
        out[first : first + len(rows)] = (edge < camera.aperture_radius_px - DEEP_PX) & (away > edge - BEFORE_PX)
    return out if out.any() else None
