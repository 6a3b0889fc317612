"""The pixels of one or several views, as the kernels of plane maps take them.

A pixel that the aperture's rim cuts is taken as a whole one at the middle of its lit part, whose light is multiplied by
the lit share.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, kernel, part
from plenopiv.projection.plenoptic.geometry import CameraConstants
from plenopiv.projection.plenoptic.pixel_weights import plane_of

F = np.float32
GAUSS = F(0.28867513)  # of a pixel: the two points at which its lit length is taken


class ViewPixels(NamedTuple):
    """The pixels of some views, one view after the other, each view's sorted by the rows of voxels that they see.

    ``pixels`` (8, count): s and t of the microlens, q along x and y and lit share in the first plane, and the change of
    these three per unit of A (``fill_view_pixels``). ``start`` (views + 1,): where the pixels of each view begin.
    ``first``: A of the first plane. ``middle`` (views,): q along y of each view's nominal portion. ``rim`` (views,):
    whether the aperture's rim cuts pixels of the view.
    """

    pixels: NDArray[np.float32]
    start: NDArray[np.int64]
    first: np.float32
    middle: NDArray[np.float32]
    rim: NDArray[np.bool_]


@inlined
def lit_length(radius: np.float32, base: np.float32, v: np.float32) -> np.float32:
    """Length of a pixel's line at ``v`` that lies inside the rim, px. ``base``: distance of the pixel's middle from the
    middle of the aperture."""
    edge = sqrt(max(radius * radius - v * v, F(0.01))) - base
    return max(min(edge, F(0.5)), F(-0.5)) + F(0.5)


@part
def lit_part(
    radius: np.float32, spread: np.float32, qx: np.float32, qy: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Lit share of a pixel at q that the rim may cut, and q of the middle of its lit part, in a plane where A is
    ``spread``."""
    along_x = abs(qx) > abs(qy)
    u, v = abs(qx) if along_x else abs(qy), qy if along_x else qx
    outward = F(1) if (qx if along_x else qy) > F(0) else F(-1)
    base = u + spread * (sqrt(max(radius * radius - v * v, F(0.01))) - u)
    one, two = lit_length(radius, base, v - GAUSS), lit_length(radius, base, v + GAUSS)
    lit = F(0.5) * (one + two)
    du, dv = outward * F(0.5) * (lit - F(1)), GAUSS * (two - one) / max(one + two, F(1e-6))
    return lit, qx + (du if along_x else dv), qy + (dv if along_x else du)


@kernel
def lenses_seeing_grid(
    cam: CameraConstants,
    plane_ends: NDArray[np.float32],
    seen: NDArray[np.bool_],
    by_row: NDArray[np.int64],
    lens_mm: NDArray[np.float32],
    phase: NDArray[np.float32],
    m: np.float32,
    n: np.float32,
    size: NDArray[np.float32],
    found: NDArray[np.int32],
) -> int:
    """The lenses whose pixel at (m, n) is an equation and may see a voxel of the grid, into ``found`` in the order
    ``by_row``; returns their number. ``plane_ends``: the first and the last plane, between which rays are straight.
    ``size``: columns and rows of voxels, and half the width and height of the widest footprint."""
    first, last = plane_of(plane_ends, 0), plane_of(plane_ends, 1)
    nx, ny, wide, high = size
    count = 0
    for k in range(by_row.size):
        lens = by_row[k]
        if not seen[lens]:
            continue
        s, t, qx, qy = lens_mm[lens, 0], lens_mm[lens, 1], m - phase[lens, 0], phase[lens, 1] - n
        x_1, x_2 = first.voxel_s * s + first.step_x * qx, last.voxel_s * s + last.step_x * qx
        y_1, y_2 = first.voxel_t * t + first.step_y * qy, last.voxel_t * t + last.step_y * qy
        found[count] = lens
        count += (
            (min(x_1, x_2) - cam.x0 < nx + wide)
            & (max(x_1, x_2) - cam.x0 > -wide - F(1))
            & (min(y_1, y_2) - cam.y0 < ny + high)
            & (max(y_1, y_2) - cam.y0 > -high - F(1))
        )
    return count


@kernel
def fill_view_pixels(
    cam: CameraConstants,
    lenses: NDArray[np.int32],
    m: np.float32,
    n: np.float32,
    rim: bool,
    lens_mm: NDArray[np.float32],
    phase: NDArray[np.float32],
    first: np.float32,
    last: np.float32,
    begin: int,
    end: int,
    pixels: NDArray[np.float32],
) -> None:
    """Fill ``pixels`` (8, begin : end) with the pixels of view (m, n) under ``lenses``: s, t; q along x and y and lit
    share where A is ``first``; the change of these three per unit of A, taken as linear up to A = ``last``."""
    per_unit = F(1) / (last - first) if last != first else F(0)
    for c in range(begin, end):
        lens = lenses[c - begin]
        qx, qy = m - phase[lens, 0], phase[lens, 1] - n
        pixels[0, c], pixels[1, c] = lens_mm[lens, 0], lens_mm[lens, 1]
        pixels[2, c], pixels[3, c], pixels[4, c] = qx, qy, F(1)
        pixels[5, c] = pixels[6, c] = pixels[7, c] = F(0)
        if rim:
            lit_1, x_1, y_1 = lit_part(cam.radius, first, qx, qy)
            lit_2, x_2, y_2 = lit_part(cam.radius, last, qx, qy)
            pixels[2, c], pixels[3, c], pixels[4, c] = x_1, y_1, lit_1
            pixels[5, c], pixels[6, c] = (x_2 - x_1) * per_unit, (y_2 - y_1) * per_unit
            pixels[7, c] = (lit_2 - lit_1) * per_unit
