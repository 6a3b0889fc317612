"""Where a point's light goes: slow, obvious references, independent of every kernel.

Both give an upright image (rows, columns) whose sum over an unlimited sensor is 1.
"""

from __future__ import annotations

from itertools import pairwise
from math import asin, ceil, cos, floor, pi, sin, sqrt

import numpy as np

from plenopiv.cameras.plenoptic import PlenopticCamera


def arc_primitive(u: float, radius: float) -> float:
    """Integral of sqrt(radius^2 - u^2)."""
    u = min(max(u, -radius), radius)
    return 0.5 * (u * sqrt(radius * radius - u * u) + radius * radius * asin(u / radius))


def disc_rectangle_area(u0: float, u1: float, v0: float, v1: float, radius: float) -> float:
    """Area of the rectangle [u0, u1] x [v0, v1] inside a disc about the origin.

    Cut where the arc crosses v0 or v1; in each strip the top is either v1 or the arc, the bottom v0 or the arc.
    """
    u0, u1 = max(u0, -radius), min(u1, radius)
    if u1 <= u0:
        return 0.0
    cuts = {u0, u1}
    for v in (v0, v1):
        if abs(v) < radius:
            cross = sqrt(radius * radius - v * v)
            cuts |= {c for c in (-cross, cross) if u0 < c < u1}
    cuts = sorted(cuts)
    area = 0.0
    for a, b in pairwise(cuts):
        arc = sqrt(max(radius * radius - (0.5 * (a + b)) ** 2, 0.0))
        top, bottom = min(v1, arc), max(v0, -arc)
        if top <= bottom:
            continue
        area_arc = arc_primitive(b, radius) - arc_primitive(a, radius)
        area += v1 * (b - a) if v1 < arc else area_arc
        area -= v0 * (b - a) if v0 > -arc else -area_arc
    return area


def intervals(camera: PlenopticCamera, x_mm: float, z_mm: float, offset_mm: float, flip: int, axis_px: float):
    """(pixel, u from, u to) along one axis of a square lattice: between breakpoints rays share lens and pixel.

    With s = A u + B x, the lens k holds s within half a pitch of S = offset + k p_l, and its pixel is at
    S + e ((A - 1) u + B x), from the axis in pixels (columns run against s: ``flip`` = -1).
    """
    a, b = float(camera.spread(z_mm)), float(camera.scale(z_mm))
    e, pitch, pixel = camera.image_scale, camera.lattice.pitch_mm, camera.sensor.pixel_pitch_mm
    radius = 0.5 * camera.main_lens.aperture_mm

    def between(f_slope, f_zero, lo, hi):
        """u in [lo, hi] where f = f_slope u + f_zero passes a half-integer, with both ends."""
        ends = sorted((f_slope * lo + f_zero, f_slope * hi + f_zero))
        halves = range(floor(ends[0] - 0.5) - 1, ceil(ends[1] + 0.5) + 2)
        inner = [(k + 0.5 - f_zero) / f_slope for k in halves] if f_slope != 0 else []
        return sorted([lo, hi, *(u for u in inner if lo < u < hi)])

    out = []
    in_lenses = between(a / pitch, (b * x_mm - offset_mm) / pitch, -radius, radius)
    for lo, hi in pairwise(in_lenses):
        middle = 0.5 * (lo + hi)
        lens = offset_mm + round((a * middle + b * x_mm - offset_mm) / pitch) * pitch
        slope, zero = flip * e * (a - 1.0) / pixel, axis_px + flip * (lens + e * b * x_mm) / pixel
        in_pixels = between(slope, zero, lo, hi)
        for u0, u1 in pairwise(in_pixels):
            out.append((round(slope * 0.5 * (u0 + u1) + zero), u0, u1))
    return out


def point_image_square(camera: PlenopticCamera, point_mm) -> np.ndarray:
    """Exact image of a point for a square lattice along the axes, where x and y separate.

    A pixel's light is the area of (u interval) x (v interval) inside the aperture's disc, over the disc's.
    """
    assert camera.lattice.kind == "square"
    assert camera.lattice.rotation_rad == 0.0
    x, y, z = map(float, point_mm)
    column0, row0 = camera.sensor.axis
    radius = 0.5 * camera.main_lens.aperture_mm
    image = np.zeros((camera.sensor.rows, camera.sensor.columns))
    rows = intervals(camera, y, z, camera.lattice.offset_mm[1], +1, row0)
    for column, u0, u1 in intervals(camera, x, z, camera.lattice.offset_mm[0], -1, column0):
        for row, v0, v1 in rows:
            if 0 <= column < camera.sensor.columns and 0 <= row < camera.sensor.rows:
                image[row, column] += disc_rectangle_area(u0, u1, v0, v1, radius) / (pi * radius**2)
    return image


def point_image_quadrature(camera: PlenopticCamera, point_mm, n: int = 2000) -> np.ndarray:
    """Image of a point for any lattice: midpoint rule on an n x n grid over the aperture, cut to the disc.

    The grid is turned by 0.6 rad: parallel to pixel rows its error would be of the order 1/n, not n^-1.5.
    """
    x, y, z = map(float, point_mm)
    a, b, e = float(camera.spread(z)), float(camera.scale(z)), camera.image_scale
    radius = 0.5 * camera.main_lens.aperture_mm
    rows, columns = camera.sensor.rows, camera.sensor.columns
    image = np.zeros(rows * columns)
    nodes = radius * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
    inside = 0
    for v_block in np.array_split(nodes, max(1, n // 200)):
        u, v = np.meshgrid(nodes, v_block)
        disc = u**2 + v**2 < radius**2
        u, v = u[disc], v[disc]
        u, v = cos(0.6) * u - sin(0.6) * v, sin(0.6) * u + cos(0.6) * v
        inside += u.size
        s, t = a * u + b * x, a * v + b * y
        lens_s, lens_t = camera.lattice.centres(*camera.lattice.nearest(s, t))
        column, row = camera.sensor.pixel_from_plane(
            lens_s * (1.0 + e) + e * ((s - lens_s) - u), lens_t * (1.0 + e) + e * ((t - lens_t) - v)
        )
        column, row = np.rint(column).astype(int), np.rint(row).astype(int)
        seen = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        image += np.bincount(row[seen] * columns + column[seen], minlength=rows * columns)
    return image.reshape(rows, columns) / inside
