"""How wide the main lens' aperture appears under the microlenses of a white image: whether f-numbers match."""

from __future__ import annotations

from cmath import exp
from math import hypot

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.micro_images import Disc, find_disc, inside, refine_disc
from plenopiv.cameras.plenoptic import PlenopticCamera

SAMPLE = 600  # micro-images that are fitted
ITERATIONS = 6


def aperture_disc(white: NDArray, camera: PlenopticCamera) -> Disc:
    """Radius and blur, in pixels, of the micro-images of an upright white image (rows, columns) of counts.

    ``camera`` with the lattice that the image shows (``find_lattice``). Matched f-numbers make the diameter one
    ``image_pitch_px``.
    """
    image = np.asarray(white)[:, ::-1]  # both axes grow with (s, t)
    lattice, pitch = camera.lattice, camera.image_pitch_px
    reach = int(hypot(*image.shape) / pitch) + 2
    i, j = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    s, t = lattice.centres(i.ravel(), j.ravel())
    positions = (s + 1j * t) * ((1.0 + camera.image_scale) / camera.sensor.pixel_pitch_mm)
    turned = pitch * exp(1j * lattice.rotation_rad)
    positions = positions[inside(image.shape, positions, Disc(lattice.kind, turned, 0.0, 0.0).half_window)]
    positions = positions[:: max(1, len(positions) // SAMPLE)]
    disc = find_disc(image, positions[:: max(1, len(positions) // 60)], lattice.kind, turned)
    for _ in range(ITERATIONS):
        disc = refine_disc(image, positions, disc)
    return disc
