"""What a pixel gets of a point *through one microlens*: plain Python, float64, straight from the paper's equations.

``oracles.light`` says what a pixel gets in all; a pixel of a decoded light field belongs to one microlens, and this
says what that one sends it. Nothing here uses the projector's coordinates ("cells"): rays are u on the main lens.
"""

from __future__ import annotations

import itertools
from math import asin, cos, hypot, pi, sin, sqrt

import numpy as np

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.lightfield import Layout

Polygon = list[tuple[float, float]]


def cell(camera: PlenopticCamera) -> Polygon:
    """Corners of a microlens' cell about its centre, mm on the microlens plane, counter-clockwise."""
    lattice, r = camera.lattice, camera.lattice.rotation_rad
    if lattice.kind == "square":
        corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    else:
        corners = [(cos(k * pi / 3 - pi / 6) / sqrt(3), sin(k * pi / 3 - pi / 6) / sqrt(3)) for k in range(6)]
    p = lattice.pitch_mm
    return [(p * (cos(r) * a - sin(r) * b), p * (sin(r) * a + cos(r) * b)) for a, b in corners]


def clip(polygon: Polygon, by: Polygon) -> Polygon:
    """Sutherland & Hodgman: the part of a polygon inside a convex one (counter-clockwise)."""
    for (ax, ay), (bx, by_) in zip(by, by[1:] + by[:1], strict=True):
        side = [(bx - ax) * (y - ay) - (by_ - ay) * (x - ax) for x, y in polygon]
        kept: Polygon = []
        for k, (x, y) in enumerate(polygon):
            px, py = polygon[k - 1]
            d, before = side[k], side[k - 1]
            if (d >= 0) != (before >= 0):
                f = before / (before - d)
                kept.append((px + f * (x - px), py + f * (y - py)))
            if d >= 0:
                kept.append((x, y))
        polygon = kept
    return polygon


def area_in_disc(polygon: Polygon, radius: float) -> float:
    """Area that a polygon shares with a disc about the origin: a triangle or a sector for each piece of each edge."""
    total = 0.0
    for (ax, ay), (bx, by) in zip(polygon[-1:] + polygon[:-1], polygon, strict=True):
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        if length2 == 0.0:
            continue
        middle, apart = -(ax * dx + ay * dy) / length2, (ax * dy - ay * dx) ** 2 / length2
        half = sqrt(max(radius * radius - apart, 0.0) / length2)
        cuts = [0.0, *(f for f in (middle - half, middle + half) if half and 0.0 < f < 1.0), 1.0]
        for f, g in itertools.pairwise(cuts):
            (px, py), (qx, qy) = (ax + f * dx, ay + f * dy), (ax + g * dx, ay + g * dy)
            cross = px * qy - py * qx
            if hypot(0.5 * (px + qx), 0.5 * (py + qy)) <= radius:
                total += 0.5 * cross
            else:
                angle = cross / (hypot(px, py) * hypot(qx, qy))
                acute = px * qx + py * qy > 0
                turn = asin(max(-1.0, min(1.0, angle)))
                total += 0.5 * radius * radius * (turn if acute else (pi if cross > 0 else -pi) - turn)
    return total


def pixel_polygon(camera: PlenopticCamera, point_mm, lens_mm, column, row) -> Polygon:
    """Where on the main lens the rays of a point go through that reach a pixel through the microlens at ``lens_mm``.

    The sensor position S + e ((A - 1) u + B x) solved for u, at the pixel's four corners.
    """
    x, y, z = point_mm
    a, b, e = float(camera.spread(z)), float(camera.scale(z)), camera.image_scale
    corners = []
    for dc, dr in ((0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
        s, t = camera.sensor.plane_from_pixel(column + dc, row + dr)
        corners.append((((s - lens_mm[0]) / e - b * x) / (a - 1), ((t - lens_mm[1]) / e - b * y) / (a - 1)))
    area2 = sum(p[0] * q[1] - p[1] * q[0] for p, q in zip(corners[-1:] + corners[:-1], corners, strict=True))
    return corners if area2 > 0 else corners[::-1]


def light_through(camera: PlenopticCamera, point_mm, lens_mm, column, row, cell_mm: Polygon) -> float:
    """Share of a point's light that reaches a pixel through one microlens: area on the main lens over the
    aperture's."""
    x, y, z = point_mm
    a, b, radius = float(camera.spread(z)), float(camera.scale(z)), 0.5 * camera.main_lens.aperture_mm
    pixel = pixel_polygon(camera, point_mm, lens_mm, column, row)
    # s = A u + B x lies in the microlens' cell
    onto = [(a * u + b * x - lens_mm[0], a * v + b * y - lens_mm[1]) for u, v in pixel]
    if max(p[0] for p in onto) < min(c[0] for c in cell_mm) or min(p[0] for p in onto) > max(c[0] for c in cell_mm):
        return 0.0
    if max(p[1] for p in onto) < min(c[1] for c in cell_mm) or min(p[1] for p in onto) > max(c[1] for c in cell_mm):
        return 0.0
    if a == 0.0:
        inside = clip([onto[0]], cell_mm)
        part = pixel if inside else []
    else:
        under = [((s + lens_mm[0] - b * x) / a, (t + lens_mm[1] - b * y) / a) for s, t in cell_mm]
        part = clip(pixel, under)
    return area_in_disc(part, radius) / (pi * radius**2) if len(part) > 2 else 0.0


def candidates_of(where: Layout, point_mm):
    """(view, lens, centre of the lens in mm, column, row) of the seen pixels that a point can possibly light."""
    camera = where.camera
    x, y, z = point_mm
    a, b = float(camera.spread(z)), float(camera.scale(z))
    j, i = np.mgrid[where.j0 : where.j0 + where.nj, where.i0 : where.i0 + where.ni]
    centres = np.stack(camera.lattice.centres(i.ravel(), j.ravel()), -1)
    reach = abs(a) * 0.5 * camera.main_lens.aperture_mm + 0.8 * camera.lattice.pitch_mm
    near = np.flatnonzero(np.hypot(centres[:, 0] - b * x, centres[:, 1] - b * y) <= reach)
    for lens in near:
        # a pixel sees the point through u = (its nominal portion + B x - S)/(1 - A), which must come near the cell
        views = np.flatnonzero(where.seen[:, lens])
        m, n = where.offsets[views].T
        q = np.stack([m - where.phase[lens, 0], where.phase[lens, 1] - n], -1) * camera.portion_mm
        s = (a * q + b * np.array([x, y]) - centres[lens]) / (1 - a)
        close = np.hypot(*s.T) <= 0.71 * (camera.lattice.pitch_mm + abs(a / (1 - a)) * camera.portion_mm)
        column, row = (where.pixel[lens] + where.offsets[views]).T
        for k in np.flatnonzero(close):
            yield int(views[k]), int(lens), tuple(centres[lens]), column[k], row[k]


def exact_light(where: Layout, point_mm) -> np.ndarray:
    """A point's light (view, lens), each pixel's through its own microlens, as a share of all its light."""
    camera, cell_mm = where.camera, cell(where.camera)
    out = np.zeros((where.views, where.lenses))
    for view, lens, centre, column, row in candidates_of(where, point_mm):
        out[view, lens] = light_through(camera, point_mm, centre, column, row, cell_mm)
    return out


def ray_light(where: Layout, point_mm, rays: int) -> np.ndarray:
    """The same by rays through a pixel's centre (1) or 3 x 3 points of it (9), each traced by Eqs. 1-5.

    One ray stands for the part of its pixel that the aperture lights; nine stand for a ninth each and are lost if they
    miss the aperture.
    """
    camera = where.camera
    x, y, z = point_mm
    a, b, e = float(camera.spread(z)), float(camera.scale(z)), camera.image_scale
    radius = 0.5 * camera.main_lens.aperture_mm
    pixel_light = (camera.portion_mm / (1 - a)) ** 2 / (pi * radius**2)
    offsets = [0.0] if rays == 1 else [-1 / 3, 0.0, 1 / 3]
    out = np.zeros((where.views, where.lenses))
    for view, lens, centre, column, row in candidates_of(where, point_mm):
        for dc in offsets:
            for dr in offsets:
                s, t = camera.sensor.plane_from_pixel(column + dc, row + dr)
                u, v = ((s - centre[0]) / e - b * x) / (a - 1), ((t - centre[1]) / e - b * y) / (a - 1)
                i, j = camera.lattice.nearest(a * u + b * x, a * v + b * y)
                if (int(j) - where.j0) * where.ni + int(i) - where.i0 != lens:
                    continue
                if rays == 1:
                    out[view, lens] += pixel_light * where.fill[view, lens]
                elif hypot(u, v) <= radius:
                    out[view, lens] += pixel_light / rays
    return out
