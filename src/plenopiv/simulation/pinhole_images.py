"""Images of particles through pinhole cameras: a Gaussian about where each is imaged, integrated over the pixels.

A small particle's image is the lens' diffraction spot; its Airy disc is near a Gaussian (Adrian & Yao 1985), whose e^-2
diameter is four standard deviations. Cameras focus through all of the volume: the diameter is the same everywhere.
"""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.particles import Particles

REACH = 4.5  # standard deviations; 7e-6 of the light lies beyond along each axis
AT_A_TIME = 1 << 14  # particles


def pinhole_image(camera: PinholeCamera, particles: Particles, *, diameter_px: float = 2.7) -> NDArray[np.float64]:
    """Mean electrons of every pixel, upright, float64 (rows, columns).

    ``diameter_px``: e^-2 diameter of a point's image. A particle's own diameter adds to it as squares do. The light of
    a particle is the same in every camera and at every distance; what falls off the sensor is lost.

    Raises PlenoPIVError for a diameter that is not positive and particles that are not in front of the camera.
    """
    from scipy.special import erf

    if not diameter_px > 0:
        raise PlenoPIVError(f"simulation: diameter_px = {diameter_px}, give a positive number of pixels")
    sensor = camera.sensor
    image = np.zeros(sensor.rows * sensor.columns)
    position = particles.position_mm
    if len(position) and camera.in_camera(position)[:, 2].max() >= 0:
        raise PlenoPIVError("simulation: a particle is not in front of the camera; keep the camera out of the volume")
    for first in range(0, len(position), AT_A_TIME):
        now = slice(first, first + AT_A_TIME)
        place = camera.project(position[now])
        own = particles.diameter_mm * camera.pixels_per_mm(position[now])
        sigma = 0.25 * np.sqrt(diameter_px**2 + own**2)
        half = ceil(REACH * sigma.max())
        pixel = np.rint(place).astype(np.int64)[:, :, None] + np.arange(-half, half + 1)  # (particle, 2, across)
        width = sqrt(2.0) * sigma[:, None, None]
        from_middle = pixel - place[:, :, None]
        share = 0.5 * (erf((from_middle + 0.5) / width) - erf((from_middle - 0.5) / width))
        share *= (pixel >= 0) & (pixel < np.array([sensor.columns, sensor.rows])[:, None])
        light = particles.electrons[now, None, None] * share[:, 1, :, None] * share[:, 0, None, :]
        flat = pixel[:, 1, :, None] * sensor.columns + pixel[:, 0, None, :]
        on_sensor = light > 0
        image += np.bincount(flat[on_sensor], weights=light[on_sensor], minlength=image.size)
    return image.reshape(sensor.rows, sensor.columns)
