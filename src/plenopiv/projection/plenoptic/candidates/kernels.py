"""Kernel of dense ray tracing: which voxels of a slab of planes could hold a particle at all.

It goes through the pixels: one that collected little light rules out every voxel that would give it more. Only such
pixels cost time, and no two threads work on the same plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import borrowed, inlined, kernel, part
from plenopiv.projection.plenoptic.blurred import table_weight
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.pixel_weights import (
    EXACT,
    ONE_RAY,
    area_of,
    box_of,
    floor_of,
    pixel_weight,
    plane_of,
    ray_inside,
    ray_weight,
    reach_of,
)
from plenopiv.projection.plenoptic.plane_maps.view_pixels import lit_part

LANES = 16  # voxels of a row computed at once: the widest float32 vector
F = np.float32
LEAST_WEIGHT = 0.05  # of the largest in the plane: smaller ones, at a footprint's rim, do not judge a voxel
INTEGRATION = 64  # samples across a pixel's footprint
TOGETHER = 4  # rows of voxels checked together, and views between one summary of what is left and the next


@inlined
def outward(x: np.float32, by: np.float32) -> np.float32:
    """``x`` moved away from 0."""
    return x + by if x >= F(0) else x - by


@part
def row_weights(
    cam: CameraConstants,
    plane: Plane,
    blurred: NDArray[np.float32],
    rule: int,
    rim: bool,
    lit: np.float32,
    qx: np.float32,
    qy: np.float32,
    x0: np.float32,
    y0: np.float32,
    step_x: np.float32,
    step_y: np.float32,
    out_x: np.float32,
    out_y: np.float32,
    n: int,
    weight: NDArray[np.float32],
) -> None:
    """Weights of the voxels of a row in a pixel: voxel i lies (x0 + i step_x, y0 + i step_y) cells from its footprint's
    centre.

    Computes whole vectors of LANES voxels, so that no scalar remainder is left: n is a multiple of LANES. Voxels
    outside the footprint get 0. ``lit``: share of the pixel that is lit, for a single ray. ``out_x``, ``out_y``: cells
    by which a voxel is taken further from the footprint's centre than its own centre, for exact areas. ``blurred``: of
    the plane, ``blurred.tables_of``.
    """
    wide, high = reach_of(cam, plane, np.int64(EXACT))
    for b in range(0, n, LANES):
        part = weight[b : b + LANES]
        if rule == EXACT and cam.blur > F(0):
            for i in range(LANES):
                f = F(b + i)
                x, y = outward(x0 + f * step_x, out_x), outward(y0 + f * step_y, out_y)
                part[i] = table_weight(blurred, wide, high, x, y)
        elif rule == EXACT:
            for i in range(LANES):
                f = F(b + i)
                x, y = outward(x0 + f * step_x, out_x), outward(y0 + f * step_y, out_y)
                part[i] = pixel_weight(cam, plane, x, y)
        elif rule == ONE_RAY:
            for i in range(LANES):
                f = F(b + i)
                part[i] = lit * ray_inside(cam, x0 + f * step_x, y0 + f * step_y)
        else:
            part[:] = F(0)
            for ray in range(9):
                for i in range(LANES):
                    f = F(b + i)
                    part[i] += ray_weight(cam, plane, rim, qx, qy, ray, x0 + f * step_x, y0 + f * step_y)


@part
def footprint_centre(
    cam: CameraConstants, plane: Plane, s: np.float32, t: np.float32, qx: np.float32, qy: np.float32
) -> tuple[np.float32, np.float32]:
    """The centre of a pixel's footprint in a plane, voxels along x and y."""
    cx = plane.voxel_s * s + plane.step_x * qx - cam.x0
    cy = plane.voxel_t * t + plane.step_y * qy - cam.y0
    return cx, cy


@part
def weight_sums(cam: CameraConstants, plane: Plane, blurred: NDArray[np.float32]) -> tuple[float, float, np.float32]:
    """Over all places of a voxel in a plane, the integrals of its weight in a pixel and of the weight's square
    (cells^2), and the largest weight."""
    wide, high = reach_of(cam, plane, np.int64(EXACT))
    total, squares, most, scale = 0.0, 0.0, F(0), F(0.25) / (plane.half * plane.half)
    for j in range(INTEGRATION):
        for i in range(INTEGRATION):
            x = F((i + 0.5) * (2.0 / INTEGRATION) - 1.0) * wide
            y = F((j + 0.5) * (2.0 / INTEGRATION) - 1.0) * high
            if cam.blur > F(0):
                weight = table_weight(blurred, wide, high, x, y)
            else:
                weight = area_of(cam, x, y, plane.half, plane.half) * scale
            total += weight
            squares += weight * weight
            most = max(most, weight)
    area = 4.0 * wide * high / INTEGRATION**2
    return total * area, squares * area, most


@kernel
def weight_sums_of_planes(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    blurred: NDArray[np.float32],
    out: NDArray[np.float64],
) -> None:
    """``weight_sums`` of planes ``begin`` to ``end`` of ``table`` into ``out`` (nz, 3)."""
    for k in range(begin, end):
        out[k, 0], out[k, 1], out[k, 2] = weight_sums(cam, plane_of(table, k), blurred[k])


@part
def any_alive(row: NDArray[np.uint8]) -> np.bool_:
    """Whether a stretch of a row holds a voxel that is not ruled out."""
    found = np.uint8(0)
    for i in range(row.size):
        found = np.uint8(found | row[i])
    return found > 0


@part
def summarise(where: NDArray[np.uint8], left: NDArray[np.uint8]) -> None:
    """``left`` (ceil(ny / TOGETHER), nx): where any of TOGETHER rows of ``where`` (ny, nx) holds a voxel."""
    left[:] = np.uint8(0)
    for j in range(where.shape[0]):
        group = left[j // TOGETHER]
        for i in range(where.shape[1]):
            group[i] |= where[j, i]


@kernel
def rule_out(
    begin: int,
    end: int,
    turns: NDArray[np.int64],
    cam: CameraConstants,
    table: NDArray[np.float32],
    blurred: NDArray[np.float32],
    largest: NDArray[np.float32],
    rule: int,
    rim: NDArray[np.bool_],
    offsets: NDArray[np.int32],
    order: NDArray[np.int64],
    places_mm: NDArray[np.float32],
    phase: NDArray[np.float32],
    fill: NDArray[np.float32],
    bound: NDArray[np.float32],
    particle: np.float32,
    blur: NDArray[np.float32],
    alive: NDArray[np.uint8],
) -> None:
    """Rule out voxels in which a particle would give a pixel more than ``bound`` (view, lens), counts.

    Of planes ``turns[begin:end]``. ``alive``: uint8 (planes, ny, nx + LANES), 1 for voxels not ruled out. ``table``,
    ``blurred`` (``blurred.tables_of``) and ``largest`` (planes,), the largest weight, are those of its planes.
    ``particle``: light of a particle in counts, all pixels together. ``places_mm`` (views, lens, 2): where the
    microlenses are in each view; (1, lens, 2) where that is the same in all. ``blur`` (planes,): cells that half a
    voxel in depth moves a footprint, per pixel of q. A voxel's weight is the least over the places within it (for exact
    areas). A pixel that the aperture's rim cuts is taken as in ``plane_maps.view_pixels``. Views are tried in
    ``order``.
    """
    _, ny, nx = alive.shape
    alive, bound, places_mm, phase = borrowed((alive, bound, places_mm, phase))
    for k in turns[begin:end]:
        weight, left = np.empty(nx + LANES, np.float32), np.empty(((ny - 1) // TOGETHER + 1, nx), np.uint8)
        plane, where = plane_of(table, k), alive[k]
        counts = particle * plane.light
        step_x, step_y = plane.cell_x * cam.cos, -plane.cell_x * cam.sin
        half_x, half_y = F(0), F(0)
        if rule == EXACT:
            half_x = F(0.5) * (abs(plane.cell_x * cam.cos) + abs(plane.cell_y * cam.sin))
            half_y = F(0.5) * (abs(plane.cell_y * cam.cos) + abs(plane.cell_x * cam.sin))
        least = F(LEAST_WEIGHT) * largest[k]
        reach_x, reach_y = box_of(cam, plane, rule)
        for tried, view in enumerate(order):
            if tried % TOGETHER == 0:
                summarise(where, left)
            m, n = F(offsets[view, 0]), F(offsets[view, 1])
            seen_in = view if places_mm.shape[0] > 1 else np.int64(0)
            for lens in range(places_mm.shape[1]):
                limit = max(bound[view, lens] / counts, least)
                if limit >= largest[k]:
                    continue
                qx, qy, lit = m - phase[lens, 0], phase[lens, 1] - n, F(1)
                along, across = (abs(qy), abs(qx)) if cam.swapped else (abs(qx), abs(qy))  # rows of microlenses
                out_x, out_y = half_x + along * blur[k], half_y + across * blur[k]
                if rim[view] and rule == EXACT:
                    lit, qx, qy = lit_part(cam.radius, plane.spread, qx, qy)
                    limit /= max(lit, F(1e-3))
                    if limit >= largest[k]:
                        continue
                cx, cy = footprint_centre(cam, plane, places_mm[seen_in, lens, 0], places_mm[seen_in, lens, 1], qx, qy)
                i0, i1 = max(floor_of(cx - reach_x) + 1, 0), min(floor_of(cx + reach_x) + 1, nx - LANES)
                j0, j1 = max(floor_of(cy - reach_y) + 1, 0), min(floor_of(cy + reach_y) + 1, ny)
                if i0 >= i1 or j0 >= j1:
                    continue
                lanes = (i1 - i0 + LANES - 1) // LANES * LANES
                for group in range(j0 // TOGETHER, (j1 - 1) // TOGETHER + 1):
                    if not any_alive(left[group, i0 : i0 + lanes]):
                        continue
                    for j in range(max(j0, group * TOGETHER), min(j1, (group + 1) * TOGETHER)):
                        row = where[j, i0 : i0 + lanes]
                        if not any_alive(row):
                            continue
                        ox, oy = plane.cell_x * (F(i0) - cx), plane.cell_y * (F(j) - cy)
                        x0, y0 = cam.cos * ox + cam.sin * oy, cam.cos * oy - cam.sin * ox
                        row_weights(
                            cam,
                            plane,
                            blurred[k],
                            rule,
                            rim[view],
                            fill[view, lens],
                            qx,
                            qy,
                            x0,
                            y0,
                            step_x,
                            step_y,
                            out_x,
                            out_y,
                            lanes,
                            weight,
                        )
                        for i in range(lanes):
                            row[i] = row[i] if weight[i] <= limit else np.uint8(0)
