"""The part of a volume that the views of a plenoptic camera see.

A point (x, z) sends the ray through ``u`` on the main lens to s = A(z) u + B(z) x on the microlens plane (Eqs. 1-3).
With R the radius of the main lens' aperture and W half the width of the sensor seen from the microlens plane:

    every view sees it where |B x| + |A| R <= W         (and the same for y)
    no view sees it where the disc of radius |A| R about (B x, B y) misses the sensor
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.sensor import Sensor, middle
from plenopiv.volume import Limits


class Coverage(NamedTuple):
    """Shares of a volume, 0 to 1: seen by every view, and by no view at all."""

    every_view: float
    no_view: float


def half_sensor_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Half the sensor's width and height in mm, projected through the main lens' centre onto the microlens plane."""
    half = 0.5 * camera.sensor.pixel_pitch_mm / (1.0 + camera.image_scale)
    return half * camera.sensor.columns, half * camera.sensor.rows


def seen_by_every_view_mm(camera: PlenopticCamera, z_mm: ArrayLike) -> tuple[NDArray, NDArray]:
    """Largest |x| and |y| in mm that every view sees at depths z, same shape as ``z_mm``; negative where nothing is."""
    blur = np.abs(camera.spread(z_mm)) * 0.5 * camera.main_lens.aperture_mm
    demagnified = 1.0 / np.abs(camera.scale(z_mm))
    half_x, half_y = half_sensor_mm(camera)
    return (half_x - blur) * demagnified, (half_y - blur) * demagnified


def pixels_that_see(
    camera: PlenopticCamera, half_mm: tuple[float, float], depth_mm: tuple[float, float]
) -> tuple[int, int]:
    """The fewest columns and rows, even, on which every view sees |x| and |y| up to ``half_mm`` at both ends of a
    depth: the inverse of ``seen_by_every_view_mm``."""
    pixel = camera.sensor.pixel_pitch_mm / (1.0 + camera.image_scale)
    blur = np.abs(camera.spread(depth_mm)) * 0.5 * camera.main_lens.aperture_mm
    reach = [float((np.abs(camera.scale(depth_mm)) * half + blur).max()) for half in half_mm]
    columns, rows = (2 * ceil(r / pixel) + 2 for r in reach)
    return columns, rows


def middle_with(camera: PlenopticCamera, limits_mm: Limits, side_px: int) -> Sensor:
    """The sensor's middle, ``side_px`` along each side. Where the volume's centre is seen farther aside than a quarter
    of that, as much more as it is: the optical axis stays in the middle."""
    x, y, z = (0.5 * (lo + hi) for lo, hi in limits_mm)
    per_mm = abs(float(camera.scale(np.array(z)))) / camera.sensor.pixel_pitch_mm
    columns, rows = (side_px + 2 * ceil(max(abs(at) * per_mm - side_px / 4, 0.0)) for at in (x, y))
    return middle(camera.sensor, columns, rows)


def coverage(camera: PlenopticCamera, limits_mm: Limits, samples: int = 41, space: SpaceMap | None = None) -> Coverage:
    """Shares of the volume between ``limits_mm`` = ((x lo, hi), (y lo, hi), (z lo, hi)), from samples^3 points.

    The points include the volume's corners; all must lie in front of the main lens (z < S_o). With ``space`` the limits
    are the laboratory's.
    """
    axes = (np.linspace(lo, hi, samples) for lo, hi in limits_mm)
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=space is None)
    if space is not None:
        x, y, z = np.moveaxis(space.to_lens(np.stack([x, y, z], -1)), -1, 0)
    blur = np.abs(camera.spread(z)) * 0.5 * camera.main_lens.aperture_mm
    magnified = np.abs(camera.scale(z))
    half_x, half_y = half_sensor_mm(camera)
    outside_x = magnified * np.abs(x) - half_x
    outside_y = magnified * np.abs(y) - half_y
    every = (outside_x + blur <= 0) & (outside_y + blur <= 0)
    none = np.hypot(np.maximum(outside_x, 0), np.maximum(outside_y, 0)) > blur
    return Coverage(float(every.mean()), float(none.mean()))
