"""Where the footprints of a view's pixels are centred on the map of a plane.

A *place* on a strip of a map is the number of the point above and to the left of it (``at``), and the fractions of a
step from there to the next column and row (``frac_x``, ``frac_y``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, part
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.plane_maps.maps import MapSize
from plenopiv.projection.plenoptic.plane_maps.view_pixels import ViewPixels

F = np.float32
ROUNDING = F(0.01)  # rows by which rounding may move a place
Q_MARGIN = F(1.15)  # px by which a pixel's q may differ from its view's: phase, middle of its lit part, drift


@part
def pixel_bounds(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    n: int,
    low: int,
    high: int,
) -> tuple[int, int, int, int]:
    """Which pixels of view n, sorted by row, have footprints centred on rows low <= y < high of a map: four bounds. All
    that do lie between the first and the last, and all between the second and the third do. A pixel's q along y differs
    by less than Q_MARGIN from its view's ``middle``."""
    points, t = size[2], views.pixels[1]
    shift = F(border[1]) - points * cam.y0 + points * plane.step_y * views.middle[n]
    slack = Q_MARGIN * points * abs(plane.step_y) + ROUNDING
    found = (0, 0, 0, 0)
    for bound in range(4):
        row = (F(low) if bound < 2 else F(high)) + (slack if bound % 2 else -slack) - shift
        a, b = max(views.start[n], found[3]), views.start[n + 1]
        while a < b:
            c = (a + b) // 2
            if points * plane.voxel_t * t[c] < row:
                a = c + 1
            else:
                b = c
        found = found[1], found[2], found[3], a
    return found


@inlined
def map_steps(
    cam: CameraConstants, plane: Plane, size: MapSize, border: NDArray[np.int64]
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Where the footprint of lens (0, 0) at q = 0 is centred on a map, column and row, and how far the centre moves per
    mm of s, px of q, mm of t and px of q."""
    points = size[2]
    x0, y0 = F(border[0]) - points * cam.x0, F(border[1]) - points * cam.y0
    return x0, y0, points * plane.voxel_s, points * plane.step_x, points * plane.voxel_t, points * plane.step_y


@part
def place_whole_pixels(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    begin: int,
    count: int,
    top: int,
    at: NDArray[np.int32],
    frac_x: NDArray[np.float32],
    frac_y: NDArray[np.float32],
) -> None:
    """Places, on a strip whose first row is row ``top`` of the map, of the footprints of ``count`` wholly lit pixels
    from ``begin`` on. Those beyond the map along x are put on its border, where it is dark."""
    x0, y0, xs, xq, ys, yq = map_steps(cam, plane, size, border)
    width, first_row, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:]
    for c in range(count):
        x, y = min(max(x0 + xs * s[c] + xq * qx[c], F(0)), right), max(y0 + ys * t[c] + yq * qy[c], F(0))
        i, j = np.int32(x), np.int32(y)
        frac_x[c], frac_y[c] = x - F(i), y - F(j)
        at[c] = (j - first_row) * width + i


@part
def place_rim_pixels(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    begin: int,
    count: int,
    top: int,
    at: NDArray[np.int32],
    frac_x: NDArray[np.float32],
    frac_y: NDArray[np.float32],
    lit: NDArray[np.float32],
) -> None:
    """The same for pixels that the aperture's rim cuts, and their lit shares."""
    x0, y0, xs, xq, ys, yq = map_steps(cam, plane, size, border)
    width, first_row, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy, off = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:], plane.spread - views.first
    share, qx_off, qy_off, share_off = p[4, begin:], p[5, begin:], p[6, begin:], p[7, begin:]
    for c in range(count):
        x = min(max(x0 + xs * s[c] + xq * (qx[c] + off * qx_off[c]), F(0)), right)
        y = max(y0 + ys * t[c] + yq * (qy[c] + off * qy_off[c]), F(0))
        i, j = np.int32(x), np.int32(y)
        frac_x[c], frac_y[c] = x - F(i), y - F(j)
        at[c] = (j - first_row) * width + i
        lit[c] = share[c] + off * share_off[c]


@part
def mask_outside(first: int, last: int, count: int, at: NDArray[np.int32], lit: NDArray[np.float32]) -> None:
    """Set ``lit`` to 0 for pixels that are not at points first <= at < last, and put them at point 0."""
    begin, end = np.int32(first), np.int32(last)
    for c in range(count):
        here = (at[c] >= begin) & (at[c] < end)
        at[c] = at[c] if here else 0
        lit[c] = lit[c] if here else F(0)


@inlined
def place_pixels(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: ViewPixels,
    n: int,
    begin: int,
    count: int,
    top: int,
    low: int,
    high: int,
    inside: bool,
    at: NDArray[np.int32],
    frac_x: NDArray[np.float32],
    frac_y: NDArray[np.float32],
    lit: NDArray[np.float32],
) -> None:
    """Places of pixels of view n and their lit shares, which are 0 off the rows low <= y < high. Where all are wholly
    lit and known to lie ``inside``, ``lit`` stays as it is. Inlined, as a call would pass a hundred arguments."""
    if views.rim[n]:
        place_rim_pixels(cam, plane, size, border, views, begin, count, top, at, frac_x, frac_y, lit)
    else:
        place_whole_pixels(cam, plane, size, border, views, begin, count, top, at, frac_x, frac_y)
        if not inside:
            lit[:] = F(1)
    if not inside:
        mask_outside((low - top) * size[1], (high - top) * size[1], count, at, lit)


@inlined
def pixel_runs(
    rim: bool, bounds: tuple[int, int, int, int]
) -> tuple[tuple[int, int, bool], tuple[int, int, bool], tuple[int, int, bool]]:
    """Runs of pixels (begin, end, known to lie inside) by ``pixel_bounds``: those near the strip's first row, those
    near its last, those between; the last run is empty where the rim cuts pixels."""
    inside = bounds[2] if not rim else bounds[1]
    return (bounds[0], bounds[1], False), (inside, bounds[3], False), (bounds[1], inside, True)
