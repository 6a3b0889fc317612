"""Where the footprints of a view's pixels are centred on the map of a plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, part
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.plane_maps.maps import MapSize
from plenopiv.projection.plenoptic.plane_maps.view_pixels import Views

F = np.float32
ROUNDING = F(0.01)  # rows that a place may be off by it
OFF = F(1.15)  # px that a pixel's q may be off its view's: its phase, its lit part's middle, drift


@part
def pixels_near(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    n: int,
    low: int,
    high: int,
) -> tuple[int, int, int, int]:
    """Of the pixels of view n, which are sorted by row, four bounds: between the outer ones lie all whose footprints
    may be centred on rows low <= y < high of a map, between the inner ones none whose are not. A pixel's q along y is
    less than OFF away from the view's ``middle``."""
    points, t = size[2], views.pixels[1]
    shift = F(border[1]) - points * cam.y0 + points * plane.step_y * views.middle[n]
    slack = OFF * points * abs(plane.step_y) + ROUNDING
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
def steps_of(
    cam: CameraConstants, plane: Plane, size: MapSize, border: NDArray[np.int64]
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Where lens (0, 0) would have its footprint centred on a map, and the way for a step in s, q, t and q again."""
    points = size[2]
    x0, y0 = F(border[0]) - points * cam.x0, F(border[1]) - points * cam.y0
    return x0, y0, points * plane.voxel_s, points * plane.step_x, points * plane.voxel_t, points * plane.step_y


@part
def places(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    begin: int,
    count: int,
    top: int,
    at: NDArray[np.int32],
    across: NDArray[np.float32],
    along: NDArray[np.float32],
) -> None:
    """Where the footprints of wholly lit pixels ``begin`` onwards are centred on a strip, of a map of ``size`` (rows,
    columns, points to a voxel), whose first row is ``top``: the point above and to the left, the way to the next column
    and row. Those off the map along x go to its border, where it is dark."""
    x0, y0, xs, xq, ys, yq = steps_of(cam, plane, size, border)
    width, first_row, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:]
    for c in range(count):
        x, y = min(max(x0 + xs * s[c] + xq * qx[c], F(0)), right), max(y0 + ys * t[c] + yq * qy[c], F(0))
        i, j = np.int32(x), np.int32(y)
        across[c], along[c] = x - F(i), y - F(j)
        at[c] = (j - first_row) * width + i


@part
def places_at_rim(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    begin: int,
    count: int,
    top: int,
    at: NDArray[np.int32],
    across: NDArray[np.float32],
    along: NDArray[np.float32],
    lit: NDArray[np.float32],
) -> None:
    """The same for pixels that the aperture's rim cuts, and their lit shares."""
    x0, y0, xs, xq, ys, yq = steps_of(cam, plane, size, border)
    width, first_row, right, p = np.int32(size[1]), np.int32(top), F(size[1]) - F(1.01), views.pixels
    s, t, qx, qy, off = p[0, begin:], p[1, begin:], p[2, begin:], p[3, begin:], plane.spread - views.first
    share, qx_off, qy_off, share_off = p[4, begin:], p[5, begin:], p[6, begin:], p[7, begin:]
    for c in range(count):
        x = min(max(x0 + xs * s[c] + xq * (qx[c] + off * qx_off[c]), F(0)), right)
        y = max(y0 + ys * t[c] + yq * (qy[c] + off * qy_off[c]), F(0))
        i, j = np.int32(x), np.int32(y)
        across[c], along[c] = x - F(i), y - F(j)
        at[c] = (j - first_row) * width + i
        lit[c] = share[c] + off * share_off[c]


@part
def only_within(first: int, last: int, count: int, at: NDArray[np.int32], lit: NDArray[np.float32]) -> None:
    """Pixels that are not at points first <= at < last take no part."""
    begin, end = np.int32(first), np.int32(last)
    for c in range(count):
        here = (at[c] >= begin) & (at[c] < end)
        at[c] = at[c] if here else 0
        lit[c] = lit[c] if here else F(0)


@inlined
def place(
    cam: CameraConstants,
    plane: Plane,
    size: MapSize,
    border: NDArray[np.int64],
    views: Views,
    n: int,
    begin: int,
    count: int,
    top: int,
    low: int,
    high: int,
    inside: bool,
    at: NDArray[np.int32],
    across: NDArray[np.float32],
    along: NDArray[np.float32],
    lit: NDArray[np.float32],
) -> None:
    """``places`` of pixels of view n and their lit shares, which are 0 off the rows low <= y < high; of those that are
    wholly lit and ``inside`` for certain, ``lit`` stays as it is. Inlined, as a call would pass a hundred arguments."""
    if views.rim[n]:
        places_at_rim(cam, plane, size, border, views, begin, count, top, at, across, along, lit)
    else:
        places(cam, plane, size, border, views, begin, count, top, at, across, along)
        if not inside:
            lit[:] = F(1)
    if not inside:
        only_within((low - top) * size[1], (high - top) * size[1], count, at, lit)


@inlined
def runs_of(
    rim: bool, bounds: tuple[int, int, int, int]
) -> tuple[tuple[int, int, bool], tuple[int, int, bool], tuple[int, int, bool]]:
    """Runs of pixels (begin, end, whether they need no test): all but those near the strip's ends, and none where the
    rim cuts pixels."""
    inside = bounds[2] if not rim else bounds[1]
    return (bounds[0], bounds[1], False), (inside, bounds[3], False), (bounds[1], inside, True)
