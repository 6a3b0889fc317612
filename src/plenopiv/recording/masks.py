"""Masks: pixels that are no equations, from an image or from polygons.

Both are in the orientation of the *files*: what is masked in the corner of a frame as it is stored is masked there,
whatever ``orientation`` says. Pixel centres are at integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.recording.sources import only_source
from plenopiv.sensor import Sensor

Polygon = Sequence[tuple[float, float]]
ON_THE_LINE = 1e-9  # px: rounding of where an edge crosses a row


def mask_of_image(path: Path, sensor: Sensor) -> NDArray[np.bool_]:
    """The pixels (rows, columns) that are 0 in an image of the sensor's size, of any bit depth.

    Raises:
        PlenoPIVError: no image that can be read, of another size, or it masks no pixel or every one.
    """
    source = only_source(path)
    size = source.size()
    if size != (sensor.columns, sensor.rows):
        raise PlenoPIVError(
            f"{source}: is {size[0]} x {size[1]} pixels (columns x rows); recording.mask must be of a frame's size, "
            f"{sensor.columns} x {sensor.rows}"
        )
    return _some(source.values() == 0, f"{source}: recording.mask", "0 is masked, any other value is used")


def mask_of_polygons(polygons: Sequence[Polygon], sensor: Sensor) -> NDArray[np.bool_]:
    """The pixels (rows, columns) whose centres lie in one of the polygons, or on its border. A polygon's corners are
    (column, row); what is outside the sensor is cut off.

    Raises:
        PlenoPIVError: a polygon holds no pixel of the sensor, or together they hold all.
    """
    masked = np.zeros((sensor.rows, sensor.columns), bool)
    for number, corners in enumerate(polygons):
        inside = _filled(np.asarray(corners, float), sensor)
        if not inside.any():
            raise PlenoPIVError(
                f"recording.mask[{number}]: this polygon holds no pixel of the sensor; corners are [column, row] in "
                f"pixels of the files' images, from [0, 0] to [{sensor.columns - 1}, {sensor.rows - 1}]"
            )
        masked |= inside
    return _some(masked, "recording.mask", "polygons enclose what is left out")


def _some(masked: NDArray[np.bool_], what: str, meaning: str) -> NDArray[np.bool_]:
    """``masked``, if that is neither no pixel nor every one."""
    if masked.all() or not masked.any():
        raise PlenoPIVError(f"{what}: masks {'every' if masked.all() else 'no'} pixel; {meaning}")
    return masked


def _filled(corners: NDArray[np.float64], sensor: Sensor) -> NDArray[np.bool_]:
    """Pixels (rows, columns) in a polygon of ``corners`` (n, 2) or on its border: row by row, between the edges that
    cross the row, taken in twos (even-odd rule)."""
    filled = np.zeros((sensor.rows, sensor.columns), bool)
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, 0).T
    low, high = np.minimum(y0, y1), np.maximum(y0, y1)
    first, last = max(int(np.ceil(low.min())), 0), min(int(np.floor(high.max())), sensor.rows - 1)
    for row in range(first, last + 1):
        met = (low <= row) & (row <= high)
        flat = met & (low == high)
        sloped = met & ~flat
        a, b, c, d = x0[sloped], y0[sloped], x1[sloped], y1[sloped]
        at = a + (row - b) * ((c - a) / (d - b))
        crossing = np.sort(at[row < high[sloped]])  # an edge without its upper end: two edges that meet count once
        spans = [*zip(crossing[::2], crossing[1::2], strict=True), *zip(at, at, strict=True)]
        spans += zip(np.minimum(x0, x1)[flat], np.maximum(x0, x1)[flat], strict=True)
        for lo, hi in spans:
            begin, end = np.ceil(lo - ON_THE_LINE), np.floor(hi + ON_THE_LINE)
            filled[row, int(np.clip(begin, 0, sensor.columns)) : int(np.clip(end, -1, sensor.columns - 1)) + 1] = True
    return filled
