"""The rule of dense ray tracing, plane by plane: a voxel stays unless a pixel of one of the judging views rules it out.

Neighbouring views carry nearly the same information, so every other one judges. Exact weights are the least
within a voxel; voxels in focus that lie across microlenses are judged by all of their pixels together (``in_focus``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.blurred import blurred
from plenopiv.projection.plenoptic.candidates import kernels
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide, rule_out_together
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.projection.plenoptic.pixel_weights import EXACT
from plenopiv.threads import in_threads, in_turn

SLAB = 16  # planes judged at once


def judging_views(camera: CameraOnGrid) -> NDArray[np.int64]:
    """The views that judge, in order: every other one, as the fields of one colour of a chessboard; those inside the
    aperture before those at its rim, the outermost of them, which differ most, first."""
    offsets = camera.layout.offsets
    order = np.lexsort((-np.hypot(*offsets.T), camera.rim))
    return order[offsets[order].sum(1) % 2 == 0]


def weight_sums(camera: CameraOnGrid) -> NDArray[np.float64]:
    """Of each plane, (nz, 3): the sum of the exact weights of its voxels in one pixel, were the plane without borders;
    the sum of their squares; and the largest weight."""
    out = np.empty((camera.grid.shape[0], 3))
    in_threads(kernels.weight_sums_of_planes, len(out), camera.cam, camera.planes, blurred(camera), out)
    cells = camera.column("cell_x", "cell_y")
    out[:, :2] /= np.abs(cells[:, :1] * cells[:, 1:])
    return out


def candidate_planes(
    camera: CameraOnGrid, rule: int, most: NDArray[np.float32], particle: float
) -> Iterator[NDArray[np.bool_]]:
    """Plane by plane the visible voxels (ny, nx) in which a particle of ``particle`` counts gives no pixel more than
    ``most`` (view, lens). ``rule``: of ``pixel_weights``."""
    where, grid, order = camera.layout, camera.grid, judging_views(camera)
    most = np.where(where.seen, most, np.float32(np.inf))
    if where.light is not None:  # a pixel that gets less light allows for as much more of a particle
        most = most / where.light
    exact = rule == EXACT
    largest = weight_sums(camera)[:, 2].astype(np.float32)
    if not exact:
        largest[:] = 1.0
    move = camera.column("move")
    blur = 0.5 * np.abs(np.gradient(move)) if move.size > 1 else np.zeros(1)
    whole = order[~camera.rim[order]]
    places = camera.lens_mm[None]
    if camera.shifts is not None:
        places = np.stack([camera.places_mm(view) for view in range(where.views)])
    pixels = where.offsets, order, places, where.phase, where.fill, most, np.float32(particle)
    nz, ny, nx = grid.shape
    visible = camera.visible_planes()
    for lo in range(0, nz, SLAB):
        slab = slice(lo, min(lo + SLAB, nz))
        alive = np.zeros((slab.stop - lo, ny, nx + kernels.LANES), np.uint8)
        for plane in alive:
            plane[:, :nx] = next(visible)
        planes = camera.planes[slab], blurred(camera)[slab], largest[slab], rule, camera.rim
        half_step = blur[slab].astype(np.float32)
        in_threads(kernels.rule_out, len(alive), in_turn(len(alive)), camera.cam, *planes, *pixels, half_step, alive)
        for k, plane in enumerate(alive[:, :, :nx], lo):
            if exact and borders_coincide(where, grid, k):
                counts = particle * float(camera.column("light")[k])
                rule_out_together(where, grid, k, plane, most, counts, whole)
            yield plane > 0
