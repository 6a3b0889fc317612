"""The light that a pixel collects, as a few rectangular patches: what both families of kernels share.

A pixel inside the aperture is one square. One at the rim is cut by a circle; it becomes STRIPS rectangles that run
towards the rim, each as long as its middle is lit. Lengths here are pixels of q, the aperture's coordinate in pixels.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from plenopiv.projection import footprint
from plenopiv.projection.geometry import Plane

FAST = {"reassoc", "nsz", "arcp", "contract", "afn"}  # without nnan and ninf
ONE_RAY, NINE_RAYS, EXACT = 0, 1, 2
STRIPS = 4
PATCHES = 9
EDGE, SLOPE = STRIPS, STRIPS + 1  # columns of the rim table behind the strips' own edges
F = np.float32

footprint.corner = njit(footprint.corner, fastmath=FAST, inline="always")
rectangle_in_hexagon = njit(footprint.rectangle_in_hexagon, fastmath=FAST, inline="always")
rectangle_in_square = njit(footprint.rectangle_in_square, fastmath=FAST, inline="always")
point_in_hexagon = njit(footprint.point_in_hexagon, fastmath=FAST, inline="always")
point_in_square = njit(footprint.point_in_square, fastmath=FAST, inline="always")


@njit(cache=True)
def plane_of(table, k):
    """Row k of the table of planes as scalars."""
    t = table[k]
    return Plane(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7], t[8], t[9], t[10], t[11], t[12], t[13])


@njit(cache=True)
def rim_table(m, n, phase, seen, radius, table):
    """Where the aperture's rim cuts the pixels of view (m, n), into ``table`` (lens, STRIPS + 2).

    Distances from the pixel's centre outwards along the axis nearer to the radius: at the middle of each strip, at the
    pixel's middle (EDGE), and how fast that falls along the other axis (SLOPE).
    """
    for lens in range(phase.shape[0]):
        if not seen[lens]:
            continue
        qx, qy = m - phase[lens, 0], phase[lens, 1] - n
        if abs(qx) > abs(qy):
            u, v = abs(qx), qy
        else:
            u, v = abs(qy), qx
        reach = sqrt(max(radius * radius - v * v, F(0.01)))
        table[lens, EDGE] = reach - u
        table[lens, SLOPE] = v / reach
        for k in range(STRIPS):
            w = v + F(k + 0.5) / F(STRIPS) - F(0.5)
            table[lens, k] = sqrt(max(radius * radius - w * w, F(0.01))) - u


@njit(fastmath=FAST, cache=True, inline="always")
def floor_of(x):
    """floor(x) as an integer, without a call."""
    i = np.int64(x)
    return i - 1 if F(i) > x else i


@njit(fastmath=FAST, cache=True)
def patch_count(plane, rule, rim, cut, pixel):
    """Number of patches that stand for a pixel."""
    if rule == NINE_RAYS:
        return 9
    if rule == ONE_RAY or not rim:
        return 1
    shift = plane.spread * cut[pixel, EDGE]
    return 1 if min(cut[pixel, 0], cut[pixel, STRIPS - 1]) - shift >= F(0.5) else STRIPS


@njit(fastmath=FAST, cache=True)
def patch(geo, plane, rule, rim, cut, pixel, share, qx, qy, count, k):
    """Patch k of a pixel at q: (x, y, half_x, half_y, weight, grow_x, grow_y).

    Positions and half widths in cells, along the lattice's axes, from the pixel's centre. ``weight`` times a patch's
    area in a microlens' cell is a share of the pixel; rays are patches without extent. ``grow``: relative growth of a
    patch per cell that the voxel lies off the footprint's centre, since that moves the aperture's disc.
    ``cut`` is the rim table, used where ``rim``; ``share`` (pixel,) the lit share, which weighs a single ray.
    """
    if rule == ONE_RAY:
        return F(0), F(0), F(0), F(0), share[pixel], F(0), F(0)
    scale = F(2) * plane.half
    if rule == EXACT and count == 1:
        return F(0), F(0), plane.half, plane.half, F(1) / (scale * scale), F(0), F(0)
    along_x = abs(qx) > abs(qy)
    outward = F(1) if (qx if along_x else qy) > F(0) else F(-1)
    shift = (
        plane.spread * cut[pixel, EDGE]
    )  # off focus the rim moves towards the pixel's centre by A times its distance
    gu = gv = F(0)
    if rule == NINE_RAYS:
        du, dv = F(k % 3 - 1) / F(3), F(k // 3 - 1) / F(3)
        lit = not rim or du <= cut[pixel, EDGE] - cut[pixel, SLOPE] * dv - shift
        du, hu, hv, weight = outward * du, F(0), F(0), (F(1) / F(9) if lit else F(0))
    else:
        edge = min(cut[pixel, k] - shift, F(0.5))
        length = max(edge + F(0.5), F(0))
        if F(0) < length < F(1):
            gu, gv = -outward * plane.drift / length, -cut[pixel, SLOPE] * plane.drift / length
        du, dv = outward * F(0.5) * (edge - F(0.5)), F(k + 0.5) / F(STRIPS) - F(0.5)
        hu, hv, weight = F(0.5) * length * scale, F(0.5) / F(STRIPS) * scale, F(1) / (scale * scale)
    if not along_x:
        du, dv, hu, hv, gu, gv = dv, du, hv, hu, gv, gu
    return (
        plane.move * (geo.cos * du + geo.sin * dv),
        plane.move * (geo.cos * dv - geo.sin * du),
        hu,
        hv,
        weight,
        geo.cos * gu + geo.sin * gv,
        geo.cos * gv - geo.sin * gu,
    )


@njit(fastmath=FAST, cache=True)
def patch_share(geo, rule, x, y, half_x, half_y):
    """Area of a patch centred at (x, y) cells in the microlens' cell; of a ray, whether it is inside."""
    if rule == EXACT:
        if geo.hexagonal:
            return rectangle_in_hexagon(x, y, half_x, half_y)
        return rectangle_in_square(x, y, half_x, half_y)
    if geo.hexagonal:
        return point_in_hexagon(x, y)
    return point_in_square(x, y)


@njit(fastmath=FAST, cache=True)
def pixel_share(geo, plane, rule, rim, cut, pixel, share, qx, qy, x, y):
    """Share of the pixel at q that a voxel (x, y) cells off its footprint's centre gives."""
    total = F(0)
    count = patch_count(plane, rule, rim, cut, pixel)
    for k in range(count):
        px, py, hx, hy, weight, gx, gy = patch(geo, plane, rule, rim, cut, pixel, share, qx, qy, count, k)
        total += weight * (F(1) + gx * x + gy * y) * patch_share(geo, rule, px + x, py + y, hx, hy)
    return total
