"""Weights: the share of a pixel that a voxel's light covers, as a few rectangles. Both plane maps and ``by_voxel`` use
them.

The light of a pixel inside the aperture is one square. A pixel at the aperture's rim is cut by a circle; its light is
taken as RECTANGLES rectangles side by side that run towards the rim, each as long as its middle is lit. A single ray
covers no area: its weight is the lit share of its pixel. Lengths here are pixels of q, the aperture's coordinate in
pixels.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, part
from plenopiv.projection.plenoptic.cell_areas import (
    TIP,
    point_in_hexagon,
    point_in_square,
    rectangle_in_hexagon,
    rectangle_in_square,
)
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane

ONE_RAY, NINE_RAYS, EXACT = 0, 1, 2
CUT = 3.0  # standard deviations of the main lens' blur after which it is cut off
RECTANGLES = 6  # written out one by one in rim_weight, so that common terms are computed once
F = np.float32


@part
def plane_of(table: NDArray[np.float32], k: int) -> Plane:
    """Row k of the table of planes as scalars."""
    t = table[k]
    return Plane(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7], t[8], t[9], t[10], t[11], t[12], t[13])


@inlined
def floor_of(x: np.float32) -> np.int64:
    """floor(x) as an integer, without a function call."""
    i = np.int64(x)
    return i - 1 if F(i) > x else i


@part
def reach_of(cam: CameraConstants, plane: Plane, rule: int) -> tuple[np.float32, np.float32]:
    """Farthest that a patch of light may be centred from a microlens' centre, in cells along and across the rows, and
    still meet its cell."""
    half = plane.half + F(CUT) * cam.blur if rule == EXACT else F(0.67) * plane.half * (abs(cam.cos) + abs(cam.sin))
    half += abs(cam.turn) * (half + F(0.6))
    return F(0.5) + half, (TIP if cam.hexagonal else F(0.5)) + half


@part
def box_of(cam: CameraConstants, plane: Plane, rule: int) -> tuple[np.float32, np.float32]:
    """Half widths in voxels, along x and y, of the rectangle that encloses the footprint of a pixel."""
    wide, high = reach_of(cam, plane, rule)
    c, s = abs(cam.cos), abs(cam.sin)
    return (c * wide + s * high) / abs(plane.cell_x), (c * high + s * wide) / abs(plane.cell_y)


@inlined
def patch_area(
    cam: CameraConstants, x: np.float32, y: np.float32, half_x: np.float32, half_y: np.float32
) -> np.float32:
    """Area of a rectangle of light centred at (x, y) cells inside the microlens' cell.

    The rectangle is turned against the lattice by the rotation. To first order its sides are where those of the turned
    one are at the middle of the overlap with the cell.
    """
    high = TIP if cam.hexagonal else F(0.5)
    across = F(0.5) * (max(y - half_y, -high) + min(y + half_y, high)) - y
    along = F(0.5) * (max(x - half_x, F(-0.5)) + min(x + half_x, F(0.5))) - x
    x, y = x + cam.turn * across, y - cam.turn * along
    return rectangle_in_hexagon(x, y, half_x, half_y) if cam.hexagonal else rectangle_in_square(x, y, half_x, half_y)


area_of = part(patch_area.py_func)  # compiled once for all that do not need it in vectors


@inlined
def pixel_weight(cam: CameraConstants, plane: Plane, x: np.float32, y: np.float32) -> np.float32:
    """Weight of a voxel (x, y) cells from the centre of a pixel's footprint, for a pixel wholly inside the aperture."""
    return patch_area(cam, x, y, plane.half, plane.half) * (F(0.25) / (plane.half * plane.half))


@inlined
def rectangle_area(
    cam: CameraConstants,
    plane: Plane,
    x: np.float32,
    y: np.float32,
    u: np.float32,
    v: np.float32,
    base: np.float32,
    outward: np.float32,
    along_x: bool,
    dv: np.float32,
) -> np.float32:
    """Area inside the cell of the rectangle whose middle is ``dv`` px beside the pixel's middle, and which ends at the
    rim. ``base``: ``rim_base``."""
    edge = sqrt(max(cam.radius * cam.radius - (v + dv) * (v + dv), F(0.01))) - base
    edge = max(min(edge, F(0.5)), F(-0.5))
    du = outward * F(0.5) * (edge - F(0.5))
    dx, dy = du if along_x else dv, dv if along_x else du
    half_u, half_v = (edge + F(0.5)) * plane.half, F(1.0 / RECTANGLES) * plane.half
    along_rows = along_x != cam.swapped
    hx, hy = half_u if along_rows else half_v, half_v if along_rows else half_u
    px, py = plane.move * (cam.cos * dx + cam.sin * dy), plane.move * (cam.cos * dy - cam.sin * dx)
    return patch_area(cam, x + px, y + py, hx, hy)


@inlined
def rim_base(
    cam: CameraConstants,
    plane: Plane,
    u: np.float32,
    v: np.float32,
    outward: np.float32,
    along_x: bool,
    x: np.float32,
    y: np.float32,
) -> np.float32:
    """How far from the middle of the aperture's disc, in px towards the rim, the middle of a pixel at (u, v) is, u
    running towards the rim.

    In focus that is u. Out of focus the rim moves towards the pixel's centre by A times its distance, and for a voxel
    away from the footprint's centre the disc has moved by ``drift`` pixels per cell.
    """
    reach = sqrt(max(cam.radius * cam.radius - v * v, F(0.01)))
    off_x, off_y = plane.drift * (cam.cos * x - cam.sin * y), plane.drift * (cam.cos * y + cam.sin * x)
    off_u, off_v = off_x if along_x else off_y, off_y if along_x else off_x
    return u + plane.spread * (reach - u) + outward * off_u + v / reach * off_v


@inlined
def rim_weight(
    cam: CameraConstants, plane: Plane, qx: np.float32, qy: np.float32, x: np.float32, y: np.float32
) -> np.float32:
    """``pixel_weight`` of a pixel at q that the aperture's rim may cut: the sum over RECTANGLES rectangles that run
    towards the rim, each from the pixel's inner side to where the rim cuts its middle."""
    along_x = abs(qx) > abs(qy)
    u, v = abs(qx) if along_x else abs(qy), qy if along_x else qx
    outward = F(1) if (qx if along_x else qy) > F(0) else F(-1)
    base = rim_base(cam, plane, u, v, outward, along_x, x, y)
    total = rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(-2.5 / RECTANGLES))
    total += rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(-1.5 / RECTANGLES))
    total += rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(-0.5 / RECTANGLES))
    total += rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(0.5 / RECTANGLES))
    total += rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(1.5 / RECTANGLES))
    total += rectangle_area(cam, plane, x, y, u, v, base, outward, along_x, F(2.5 / RECTANGLES))
    return total * (F(0.25) / (plane.half * plane.half))


@inlined
def ray_inside(cam: CameraConstants, x: np.float32, y: np.float32) -> np.float32:
    """1 where a ray at (x, y) cells meets the microlens, else 0."""
    return point_in_hexagon(x, y) if cam.hexagonal else point_in_square(x, y)


@inlined
def ray_weight(
    cam: CameraConstants, plane: Plane, rim: bool, qx: np.float32, qy: np.float32, k: int, x: np.float32, y: np.float32
) -> np.float32:
    """Weight by ray k of nine through a pixel at q; 0 where the aperture stops the ray."""
    dx, dy = F(k % 3 - 1) / F(3), F(k // 3 - 1) / F(3)
    ux, uy = qx * (F(1) - plane.spread) + dx, qy * (F(1) - plane.spread) + dy
    radius = cam.radius * (F(1) - plane.spread)
    lit = F(1.0 / 9.0) if (not rim) or (ux * ux + uy * uy <= radius * radius) else F(0)
    px, py = plane.move * (cam.cos * dx + cam.sin * dy), plane.move * (cam.cos * dy - cam.sin * dx)
    return lit * ray_inside(cam, x + px, y + py)
