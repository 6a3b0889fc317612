"""Voxels across a border between microlenses, in the plane in focus.

There all views see the same borders. A voxel that lies across one may hold a particle on either side, so that no pixel
by itself is sure of any of its light, and ``pruning`` keeps the voxel whatever the image shows. But the pixels that it
touches collect all of that light together:

    E light <= sum over the microlenses S touched of I_S        in every view.

Away from focus the borders lie elsewhere for each view, and others judge the voxel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.lightfield import Layout
from plenopiv.volume import VoxelGrid


def borders_coincide(layout: Layout, grid: VoxelGrid, plane: int) -> bool:
    """Whether the views' footprints in a plane are less than half a voxel apart from the middle one's."""
    camera, z = layout.camera, grid.axes()[2][plane]
    apart = abs(float(camera.spread(z))) * 0.5 * camera.main_lens.aperture_mm
    return apart < 0.5 * abs(float(camera.scale(z))) * min(grid.voxel_mm[:2])


def too_dark_together(
    layout: Layout,
    grid: VoxelGrid,
    plane: int,
    alive: NDArray[np.bool_],
    bound: NDArray[np.float32],
    counts: float,
    views: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Of the voxels ``alive`` (ny, nx) of a plane, those that touch several microlenses and are ruled out by all
    together, in one of ``views`` (whole pixels inside the aperture).

    ``bound`` (view, lens): most counts that a pixel may have collected, inf where it is no equation. ``counts``: what a
    particle gives a wholly lit pixel in this plane. A voxel touches the microlenses that hold its middle, its corners
    or the middles of its sides, all moved outward by the blur of half a voxel in depth.
    """
    camera, (x, y, z) = layout.camera, grid.axes()
    out, (row, column) = np.zeros_like(alive), np.nonzero(alive)
    if not row.size:
        return out
    depth = z[plane] + grid.voxel_mm[2] * np.array([-0.5, 0.5])
    blur, scale = np.abs(camera.spread(depth)).max() * 0.5 * camera.main_lens.aperture_mm, float(camera.scale(z[plane]))
    half_x, half_y = (0.5 * abs(scale) * size + blur for size in grid.voxel_mm[:2])
    step_t, step_s = (g.reshape(-1, 1) for g in np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"))
    i, j = camera.lattice.nearest(scale * x[column] + half_x * step_s, scale * y[row] + half_y * step_t)
    inside = (i >= layout.i0) & (i < layout.i0 + layout.ni) & (j >= layout.j0) & (j < layout.j0 + layout.nj)
    lens = np.sort(np.where(inside, (j - layout.j0) * layout.ni + i - layout.i0, layout.lenses), axis=0)
    once = np.ones(lens.shape, bool)
    once[1:] = lens[1:] != lens[:-1]
    left = np.flatnonzero(once.sum(0) > 1)
    for view in views:
        most = np.append(bound[view], np.float32(np.inf))[lens[:, left]]
        dark = np.where(once[:, left], most, 0.0).sum(0) < counts
        out[row[left[dark]], column[left[dark]]] = True
        left = left[~dark]
    return out
