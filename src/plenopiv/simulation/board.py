"""Images of a dot board through a pinhole camera: what a calibration is given.

Bright round dots on a dark board that lies in a plane z = constant, on a square grid along x and y with one dot on the
origin. That one is larger than the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.errors import PlenoPIVError


def board_image(
    camera: PinholeCamera,
    z_mm: float,
    *,
    side_mm: float = 110.0,
    pitch_mm: float = 5.0,
    diameter_mm: float = 2.0,
    origin_diameter_mm: float = 3.0,
    electrons_per_pixel: float = 4000.0,
    background: float = 0.05,
    blur_px: float = 0.0,
) -> NDArray[np.float64]:
    """Mean electrons of every pixel, upright, float64 (rows, columns).

    A square board of ``side_mm`` with all dots that fit wholly on it; a pixel inside a dot holds
    ``electrons_per_pixel``, one beside it the share ``background`` of that, one on the rim in proportion to the area
    that the rim, taken as straight within the pixel, leaves it. ``blur_px``: standard deviation of the lens' blur.

    Raises PlenoPIVError for dots that touch.
    """
    if max(diameter_mm, 0.5 * (diameter_mm + origin_diameter_mm)) >= pitch_mm:
        raise PlenoPIVError(f"board: dots of {diameter_mm} and {origin_diameter_mm} mm touch at {pitch_mm} mm pitch")
    sensor = camera.sensor
    pixel = np.stack(np.meshgrid(np.arange(float(sensor.columns)), np.arange(float(sensor.rows))), -1)
    x, y = np.moveaxis(camera.on_plane(pixel, z_mm), -1, 0)[:2]
    outermost = int((0.5 * side_mm - 0.5 * diameter_mm) / pitch_mm)
    i, j = (np.clip(np.rint(c / pitch_mm), -outermost, outermost) for c in (x, y))
    radius = np.where((i == 0) & (j == 0), 0.5 * origin_diameter_mm, 0.5 * diameter_mm)
    off_x, off_y = x - i * pitch_mm, y - j * pitch_mm
    from_middle = np.maximum(np.hypot(off_x, off_y), 1e-9)
    # the distance from the rim grows by so many mm per pixel, across the rim: turns mm into px
    (x_row, x_column), (y_row, y_column) = np.gradient(x), np.gradient(y)
    mm_px = np.hypot(off_x * x_column + off_y * y_column, off_x * x_row + off_y * y_row) / from_middle
    lit = np.clip(0.5 - (from_middle - radius) / np.maximum(mm_px, 1e-9), 0.0, 1.0)
    image = electrons_per_pixel * (background + (1.0 - background) * lit)
    if blur_px:
        from scipy import ndimage

        image = ndimage.gaussian_filter(image, blur_px, mode="nearest")
    return image
