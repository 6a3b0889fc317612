"""How the microlens array has moved against the sensor since the white image was taken."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, radians

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.sensor import Sensor


@dataclass(frozen=True)
class ArrayDrift:
    """Where the microlenses' images are now, against where they were: shifted by ``shift_px`` (right, down) in the
    middle of an upright image, turned there by ``turn_deg``, counter-clockwise in (s, t) and in the image, and 1 +
    ``scale`` times as far from the middle."""

    shift_px: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    scale: float = 0.0

    def __bool__(self) -> bool:
        """Whether anything has moved."""
        return self != ArrayDrift()

    def most_px(self, sensor: Sensor) -> float:
        """How far the images have moved at the most, in a corner of the sensor, px."""
        corner = 0.5 * hypot(sensor.columns, sensor.rows)
        return hypot(*self.shift_px) + corner * hypot(radians(self.turn_deg), self.scale)

    def of(self, camera: PlenopticCamera) -> PlenopticCamera:
        """The camera whose lattice is that of the white image, with the lattice of now."""
        mm = camera.sensor.pixel_pitch_mm / (1.0 + camera.image_scale)
        right, down = self.shift_px
        lattice = camera.lattice.moved((-right * mm, down * mm), radians(self.turn_deg), self.scale)
        return camera.with_lattice(lattice)

    def moved(self, image: NDArray) -> NDArray[np.float32]:
        """An upright image (rows, columns) of before as it would be now, by linear interpolation; its edge goes on."""
        from scipy.ndimage import affine_transform

        back = 1.0 / ((1.0 + self.scale) * np.exp(1j * radians(self.turn_deg)))
        matrix = np.array([[back.real, -back.imag], [back.imag, back.real]])  # of (row, column)
        middle = 0.5 * (np.array(image.shape) - 1.0)
        offset = middle - matrix @ (middle + self.shift_px[::-1])
        out = affine_transform(image.astype(np.float32), matrix, offset, order=1, mode="nearest")
        return np.asarray(out, np.float32)
