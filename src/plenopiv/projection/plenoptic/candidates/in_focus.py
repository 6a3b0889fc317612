"""Voxels across a border between microlenses, in the plane in focus.

There all views see the same borders. A voxel that lies across one may hold a particle on either side, so that no pixel
by itself is sure of any of its light, and ``kernels.rule_out`` keeps the voxel whatever the image shows. But the pixels
that it touches collect all of that light together:

    E light <= sum over the microlenses S touched of I_S        in every view.

Away from focus the borders lie elsewhere for each view, and others judge the voxel.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, kernel
from plenopiv.lattice import nearest_lens
from plenopiv.lightfield import Layout
from plenopiv.projection.plenoptic.pixel_weights import CUT
from plenopiv.threads import in_threads
from plenopiv.volume import VoxelGrid

nearest = inlined(nearest_lens)


def borders_coincide(layout: Layout, grid: VoxelGrid, plane: int) -> bool:
    """Whether the footprints of all views in a plane lie less than half a voxel from the middle view's."""
    camera, z = layout.camera, grid.axes()[2][plane]
    separation_mm = abs(float(camera.spread(z))) * 0.5 * camera.main_lens.aperture_mm
    return separation_mm < 0.5 * abs(float(camera.scale(z))) * min(grid.voxel_mm[:2])


def rule_out_together(
    layout: Layout,
    grid: VoxelGrid,
    plane: int,
    alive: NDArray[np.uint8],
    bound: NDArray[np.float32],
    counts: float,
    views: NDArray[np.int64],
) -> None:
    """Of the voxels ``alive`` (ny, nx) of a plane, set those to 0 that touch several microlenses and are ruled out by
    all together, in one of ``views`` (whole pixels inside the aperture).

    ``bound`` (view, lens): most counts that a pixel may have collected, inf where it is no equation. ``counts``: what a
    particle gives a wholly lit pixel in this plane. A voxel touches the microlenses that hold its middle, its corners
    or the middles of its sides, all moved outward by the blur of half a voxel in depth and that of the main lens.
    Voxels wider than a microlens are not judged.
    """
    camera, (x, y, z) = layout.camera, grid.axes()
    depth = z[plane] + grid.voxel_mm[2] * np.array([-0.5, 0.5])
    blur, scale = np.abs(camera.spread(depth)).max() * 0.5 * camera.main_lens.aperture_mm, float(camera.scale(z[plane]))
    blur += CUT * camera.blur_mm
    half_x, half_y = (float(0.5 * abs(scale) * size + blur) for size in grid.voxel_mm[:2])
    lattice = camera.lattice
    if max(half_x, half_y) > 0.5 * lattice.pitch_mm:
        return  # a microlens could lie between the points that are checked
    turned = cos(lattice.rotation_rad) / lattice.pitch_mm, sin(lattice.rotation_rad) / lattice.pitch_mm
    about = lattice.kind == "hexagonal", lattice.row_spacing, *turned
    box = layout.i0, layout.j0, layout.ni, layout.nj
    s, t = scale * x[None], scale * y[:, None]
    across, up = (half_x, 0.0), (0.0, half_y)
    if lattice.map is not None:  # to the regular lattice; half a voxel by the map's change near the axis
        s, t = lattice.map.regular(*np.broadcast_arrays(s, t))
        (a, b), (c, d) = lattice.map.regular(*across), lattice.map.regular(*up)
        across, up = (float(a), float(b)), (float(c), float(d))
    at = s - lattice.offset_mm[0], t - lattice.offset_mm[1]
    in_threads(judge_together, alive.shape[0], *about, box, *at, across, up, bound, counts, views, alive)


@kernel
def judge_together(
    begin: int,
    end: int,
    hexagonal: bool,
    row: float,
    c: float,
    s: float,
    box: tuple[int, int, int, int],
    at_s: NDArray[np.float64],
    at_t: NDArray[np.float64],
    across: tuple[float, float],
    up: tuple[float, float],
    bound: NDArray[np.float32],
    counts: float,
    views: NDArray[np.int64],
    alive: NDArray[np.uint8],
) -> None:
    """``rule_out_together`` for rows ``begin`` to ``end``. ``at_s`` and ``at_t``: a plane's voxels on the microlens
    plane, mm from lens (0, 0) on the regular lattice; (1, nx) and (ny, 1), or both (ny, nx). ``across`` and ``up``:
    half a voxel along x and y there, (s, t). ``c`` and ``s``: cosine and sine of the lattice's rotation divided by its
    pitch."""
    lenses = np.empty(9, np.int64)
    for r in range(begin, end):
        for k in range(at_s.shape[1]):
            if alive[r, k] == 0:
                continue
            touched, known = 0, True
            for point in range(9):
                m, n = point % 3 - 1, point // 3 - 1
                u = at_s[r % at_s.shape[0], k] + across[0] * m + up[0] * n
                v = at_t[r, k % at_t.shape[1]] + across[1] * m + up[1] * n
                at_i, at_j = nearest(hexagonal, row, c * u + s * v, c * v - s * u)
                i, j = int(at_i) - box[0], int(at_j) - box[1]
                known &= 0 <= i < box[2] and 0 <= j < box[3]  # beyond them nothing is known
                new, lens = True, j * box[2] + i
                for n in range(touched):
                    new &= lenses[n] != lens
                if new:
                    lenses[touched] = lens
                    touched += 1
            if touched < 2 or not known:
                continue
            for view in views:
                together = 0.0
                for n in range(touched):
                    together += bound[view, lenses[n]]
                if together < counts:
                    alive[r, k] = 0
                    break
