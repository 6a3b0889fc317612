"""The sensor: pixels, orientation, black level, saturation, and the noise that a pixel value carries.

Pixel centres are at integers; the optical axis falls at ((columns - 1)/2, (rows - 1)/2). Inside PlenoPIV every image
is *upright*: columns grow with the object's +x, rows with -y. An image stored as ``"sensor"`` is the inverted one as it
falls on the chip: upright turned by 180 degrees, not mirrored.

The microlens plane's (s, t) is inverted with respect to the object (M < 0), so in an upright image columns grow with
-s and rows with +t.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from numbers import Integral
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError, check_positive

Orientation = Literal["upright", "sensor"]
Alignment = Literal["low", "high"]
MOST_BITS = 16  # of a count in a file


@dataclass(frozen=True)
class Sensor:
    """Pixels of a monochrome sensor. Pitch in mm, black level in counts of ``bit_depth``.

    ``alignment``: whether files hold counts in the lower or the upper bits of 16. Raises PlenoPIVError for values that
    no sensor has.
    """

    columns: int
    rows: int
    pixel_pitch_mm: float
    bit_depth: int = 12
    black_level: float = 0.0
    alignment: Alignment = "low"

    def __post_init__(self) -> None:
        for name in ("columns", "rows", "bit_depth"):
            count = getattr(self, name)
            if not isinstance(count, Integral) or count < 1:
                raise PlenoPIVError(f"sensor: {name} = {count!r}, give a positive whole number")
        check_positive("sensor", pixel_pitch_mm=self.pixel_pitch_mm)
        if not isfinite(self.black_level):
            raise PlenoPIVError(f"sensor: black_level = {self.black_level}, give the counts of a dark pixel")
        if self.bit_depth > MOST_BITS or self.black_level >= self.full_scale:
            raise PlenoPIVError(
                f"sensor: {self.bit_depth} bits and a black level of {self.black_level:g}; files hold {MOST_BITS} bits "
                "at most, and a dark pixel is below full scale"
            )
        if self.alignment not in get_args(Alignment):
            raise PlenoPIVError(f'sensor: alignment = {self.alignment!r}, give "low" or "high"')

    @property
    def full_scale(self) -> int:
        """The count at which a pixel saturates."""
        return 2**self.bit_depth - 1

    @property
    def axis(self) -> tuple[float, float]:
        """(column, row) of the optical axis."""
        return (self.columns - 1) / 2.0, (self.rows - 1) / 2.0

    def plane_from_pixel(self, column: ArrayLike, row: ArrayLike) -> tuple[NDArray, NDArray]:
        """(s, t) in mm on the sensor of (column, row) in an upright image."""
        c0, r0 = self.axis
        return (c0 - np.asarray(column, float)) * self.pixel_pitch_mm, (
            np.asarray(row, float) - r0
        ) * self.pixel_pitch_mm

    def pixel_from_plane(self, s_mm: ArrayLike, t_mm: ArrayLike) -> tuple[NDArray, NDArray]:
        """(column, row) in an upright image of (s, t) in mm on the sensor."""
        c0, r0 = self.axis
        return c0 - np.asarray(s_mm, float) / self.pixel_pitch_mm, r0 + np.asarray(t_mm, float) / self.pixel_pitch_mm


def middle(sensor: Sensor, columns: int, rows: int) -> Sensor:
    """The sensor's middle, at most so many pixels, with the optical axis where it was: a pixel less where one side is
    even and the other odd."""
    columns, rows = min(columns, sensor.columns), min(rows, sensor.rows)
    return replace(sensor, columns=columns - (sensor.columns - columns) % 2, rows=rows - (sensor.rows - rows) % 2)


def middle_of(image: NDArray, part: Sensor) -> NDArray:
    """The pixels (rows, columns) of ``middle`` out of a whole image (a view, no copy)."""
    row, column = (image.shape[0] - part.rows) // 2, (image.shape[1] - part.columns) // 2
    return image[row : row + part.rows, column : column + part.columns]


def at_full_scale(values: NDArray[np.float32], sensor: Sensor) -> NDArray[np.bool_]:
    """Which pixels, in counts above the black level, are saturated."""
    return values >= sensor.full_scale - sensor.black_level - 0.5


def without(image: NDArray, unusable: NDArray[np.bool_] | None, sensor: Sensor) -> NDArray:
    """An image of counts with no light in pixels that are ``unusable``, None for none."""
    return image if unusable is None else np.where(unusable, image.dtype.type(sensor.black_level), image)


def check_pixels(pixels: NDArray, sensor: Sensor, name: str) -> None:
    """Raises PlenoPIVError where an image or mask (rows, columns) is not of the sensor's size."""
    if np.shape(pixels) != (sensor.rows, sensor.columns):
        found = " x ".join(map(str, np.shape(pixels)[::-1])) or "a number, no"
        raise PlenoPIVError(f"{name}: {found} px; give {sensor.columns} x {sensor.rows} px, as the camera's sensor has")


def first_not_finite(values: NDArray) -> tuple[int, ...] | None:
    """The first place of ``values`` (float32) that holds no finite number; None where there is none."""
    if np.isfinite(values.sum(dtype=np.float64)):  # which no sum of finite float32 exceeds
        return None
    return tuple(int(k) for k in np.argwhere(~np.isfinite(values))[0])


def check_orientation(orientation: Orientation) -> None:
    """Raises PlenoPIVError for another word than the two: a wrong one would turn every velocity by 180 degrees."""
    if orientation not in get_args(Orientation):
        raise PlenoPIVError(f'recording.orientation: {orientation!r} is no orientation; give "upright" or "sensor"')


def upright(image: NDArray, orientation: Orientation) -> NDArray:
    """An image as stored, turned upright (a view, no copy). Its own inverse.

    Raises PlenoPIVError for an unknown orientation.
    """
    check_orientation(orientation)
    return image if orientation == "upright" else image[::-1, ::-1]
