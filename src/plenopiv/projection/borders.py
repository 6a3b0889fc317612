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

ROWS = 32  # of voxels judged at a time: their microlenses fit in the cache


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
    or the middles of its sides, all moved outward by the blur of half a voxel in depth. Voxels wider than a microlens
    are not judged.
    """
    camera, (x, y, z) = layout.camera, grid.axes()
    out = np.zeros_like(alive)
    depth = z[plane] + grid.voxel_mm[2] * np.array([-0.5, 0.5])
    blur, scale = np.abs(camera.spread(depth)).max() * 0.5 * camera.main_lens.aperture_mm, float(camera.scale(z[plane]))
    half_x, half_y = (0.5 * abs(scale) * size + blur for size in grid.voxel_mm[:2])
    if max(half_x, half_y) > 0.5 * camera.lattice.pitch_mm:
        return out  # a microlens could lie between the points asked
    step_t, step_s = (g.reshape(-1, 1) for g in np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"))
    for lo in range(0, alive.shape[0], ROWS):
        row, column = np.nonzero(alive[lo : lo + ROWS])
        row += lo
        i, j = camera.lattice.nearest(scale * x[column] + half_x * step_s, scale * y[row] + half_y * step_t)
        inside = (i >= layout.i0) & (i < layout.i0 + layout.ni) & (j >= layout.j0) & (j < layout.j0 + layout.nj)
        lens = np.sort(np.where(inside, (j - layout.j0) * layout.ni + i - layout.i0, layout.lenses), axis=0)
        once = np.ones(lens.shape, bool)
        once[1:] = lens[1:] != lens[:-1]
        left = np.flatnonzero((once.sum(0) > 1) & (lens[-1] < layout.lenses))  # beyond them nothing is known
        for view in views:
            dark = np.where(once[:, left], bound[view, lens[:, left]], 0.0).sum(0) < counts
            out[row[left[dark]], column[left[dark]]] = True
            left = left[~dark]
    return out
