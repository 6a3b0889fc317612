"""Views read off a strip of a plane's map, corrections written there, and the strip moved on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import part
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.plane_maps.interpolation import read_places, write_places
from plenopiv.projection.plenoptic.plane_maps.maps import MapSize
from plenopiv.projection.plenoptic.plane_maps.placing import pixel_bounds, pixel_runs, place_pixels
from plenopiv.projection.plenoptic.plane_maps.simd import LANES
from plenopiv.projection.plenoptic.plane_maps.view_pixels import ViewPixels

F = np.float32
BLOCK = 1024  # pixels worked on at once


@part
def read_view(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    n: int,
    top: int,
    low: int,
    high: int,
    strip: NDArray[np.float32],
    light: NDArray[np.float32],
) -> None:
    """Add to ``light`` (count,) what the pixels of view n on rows low <= y < high of a map collect; ``strip`` (flat)
    holds the map's rows from ``top`` on."""
    at = np.empty(BLOCK, np.int32)
    frac_x, frac_y, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixel_bounds(cam, plane, size, border, views, n, low, high)
    for first, last, inside in pixel_runs(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place_pixels(
                cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, frac_x, frac_y, lit
            )
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                read_places(strip, width, at, frac_x, frac_y, lit, c, plane.light, light, begin + c)
            for c in range(whole, count):
                p = np.int64(at[c])
                above = strip[p] + frac_x[c] * (strip[p + 1] - strip[p])
                p += width
                below = strip[p] + frac_x[c] * (strip[p + 1] - strip[p])
                light[begin + c] += plane.light * lit[c] * (above + frac_y[c] * (below - above))


@part
def write_view(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    n: int,
    top: int,
    low: int,
    high: int,
    image: NDArray[np.float32],
    strip: NDArray[np.float32],
) -> None:
    """The transpose of ``read_view`` but for the factor ``plane.light``: add ``image`` (count,) to the strip."""
    at = np.empty(BLOCK, np.int32)
    frac_x, frac_y, lit = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    width, bounds = size[1], pixel_bounds(cam, plane, size, border, views, n, low, high)
    for first, last, inside in pixel_runs(views.rim[n], bounds):
        lit[:] = F(1)
        for begin in range(first, last, BLOCK):
            count = min(BLOCK, last - begin)
            place_pixels(
                cam, plane, size, border, views, n, begin, count, top, low, high, inside, at, frac_x, frac_y, lit
            )
            whole = count - count % LANES
            for c in range(0, whole, LANES):
                write_places(image, begin + c, at, frac_x, frac_y, lit, c, strip, width)
            for c in range(whole, count):
                p, part = np.int64(at[c]), lit[c] * image[begin + c]
                below = frac_y[c] * part
                above = part - below
                above_right, below_right = frac_x[c] * above, frac_x[c] * below
                strip[p] += above - above_right
                strip[p + 1] += above_right
                p += width
                strip[p] += below - below_right
                strip[p + 1] += below_right


@part
def copy_line(source: NDArray[np.float32], count: int, out: NDArray[np.float32]) -> None:
    """Copy ``count`` numbers. A function of its own: the compiler copies an array into itself number by number, unless
    source and target are different arguments."""
    for i in range(count):
        out[i] = source[i]


@part
def move_up(strip: NDArray[np.float32], width: int, kept: int, lines: int) -> None:
    """Move the rows of a strip from ``kept`` on to its beginning; the rows after them become dark."""
    if kept > 0:
        for line in range(lines - kept):
            copy_line(strip[(kept + line) * width :], width, strip[line * width :])
    strip[(lines - kept) * width : lines * width] = F(0)
