"""Reading views off strips of a map, writing them there, and moving a strip on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import part
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.plane_maps.interpolation import read_places, write_places
from plenopiv.projection.plenoptic.plane_maps.maps import MapSize
from plenopiv.projection.plenoptic.plane_maps.placing import pixels_near, place, runs_of
from plenopiv.projection.plenoptic.plane_maps.simd import LANES
from plenopiv.projection.plenoptic.plane_maps.view_pixels import Views

F = np.float32
BLOCK = 1024  # pixels placed at once


@part
def read(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    n: int,
    top: int,
    low: int,
    high: int,
    strip: NDArray[np.float32],
    light: NDArray[np.float32],
) -> None:
    """Add to ``light`` (count,) what the pixels of view n on rows low <= y < high of a map collect, whose rows from
    ``top`` on are ``strip`` (flat)."""
    at = np.empty(BLOCK, np.int32)
    across, along, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixels_near(cam, plane, size, border, views, n, low, high)
    for first, last, inside in runs_of(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place(cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, across, along, lit)
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                read_places(strip, width, at, across, along, lit, c, plane.light, light, begin + c)
            for c in range(whole, count):
                p = np.int64(at[c])
                above = strip[p] + across[c] * (strip[p + 1] - strip[p])
                p += width
                below = strip[p] + across[c] * (strip[p + 1] - strip[p])
                light[begin + c] += plane.light * lit[c] * (above + along[c] * (below - above))


@part
def write(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    n: int,
    top: int,
    low: int,
    high: int,
    image: NDArray[np.float32],
    strip: NDArray[np.float32],
) -> None:
    """The transpose of ``read`` but for ``plane.light``: add ``image`` (count,) to the strip."""
    at = np.empty(BLOCK, np.int32)
    across, along, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixels_near(cam, plane, size, border, views, n, low, high)
    for first, last, inside in runs_of(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place(cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, across, along, lit)
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                write_places(image, begin + c, at, across, along, lit, c, strip, width)
            for c in range(whole, count):
                p, part = np.int64(at[c]), lit[c] * image[begin + c]
                below = along[c] * part
                above = part - below
                above_right, below_right = across[c] * above, across[c] * below
                strip[p] += above - above_right
                strip[p + 1] += above_right
                p += width
                strip[p] += below - below_right
                strip[p + 1] += below_right


@part
def copy(source: NDArray[np.float32], count: int, out: NDArray[np.float32]) -> None:
    """Copy a line: of one array into itself the compiler does so number by number, unless both are told apart."""
    for i in range(count):
        out[i] = source[i]


@part
def roll(strip: NDArray[np.float32], width: int, kept: int, lines: int) -> None:
    """Move the rows of a strip from ``kept`` on to its beginning; the others are dark."""
    if kept > 0:
        for line in range(lines - kept):
            copy(strip[(kept + line) * width :], width, strip[line * width :])
    strip[(lines - kept) * width : lines * width] = F(0)
