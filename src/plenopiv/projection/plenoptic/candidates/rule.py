"""The rule of dense ray tracing, plane by plane: a voxel stays unless a pixel of one of the judging views rules it out.

Views near one another say nearly the same, so every other one judges. Exact weights are the least within a voxel;
voxels in focus that lie across microlenses are judged by all of their pixels together (``in_focus``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.candidates import kernels
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide, rule_out_together
from plenopiv.projection.plenoptic.geometry import column_of
from plenopiv.projection.plenoptic.pixel_weights import EXACT
from plenopiv.threads import in_threads, in_turn

if TYPE_CHECKING:
    from plenopiv.projection.plenoptic.projector import PlenopticProjector

SLAB = 16  # planes judged at once


def judging_views(projector: PlenopticProjector) -> NDArray[np.int64]:
    """The views that judge, in order: every other one, as the fields of one colour of a chessboard; those inside the
    aperture before those at its rim, the outermost of them, which differ most, first."""
    offsets = projector.layout.offsets
    order = np.lexsort((-np.hypot(*offsets.T), projector.rim))
    return order[offsets[order].sum(1) % 2 == 0]


def candidate_planes(
    projector: PlenopticProjector, most: NDArray[np.float32], particle: float
) -> Iterator[NDArray[np.bool_]]:
    """Plane by plane the visible voxels (ny, nx) in which a particle of ``particle`` counts gives no pixel more than
    ``most`` (view, lens)."""
    where, grid, order = projector.layout, projector.grid, judging_views(projector)
    most = np.where(where.seen, most, np.float32(np.inf))
    exact = projector.rule == EXACT
    largest = projector.weight_sums()[:, 2].astype(np.float32)
    if not exact:
        largest[:] = 1.0
    move = column_of(projector.planes, "move")
    blur = 0.5 * np.abs(np.gradient(move)) if move.size > 1 else np.zeros(1)
    whole = order[~projector.rim[order]]
    pixels = where.offsets, order, projector.lens_mm, where.phase, where.fill, most, np.float32(particle)
    nz, ny, nx = grid.shape
    visible = projector.visible_planes()
    for lo in range(0, nz, SLAB):
        slab = slice(lo, min(lo + SLAB, nz))
        alive = np.zeros((slab.stop - lo, ny, nx + kernels.LANES), np.uint8)
        for plane in alive:
            plane[:, :nx] = next(visible)
        planes = projector.planes[slab], largest[slab], projector.rule, projector.rim
        half_step = blur[slab].astype(np.float32)
        in_threads(kernels.rule_out, len(alive), in_turn(len(alive)), projector.cam, *planes, *pixels, half_step, alive)
        for k, plane in enumerate(alive[:, :, :nx], lo):
            if exact and borders_coincide(where, grid, k):
                counts = particle * float(projector.light_of_planes()[k])
                rule_out_together(where, grid, k, plane, most, counts, whole)
            yield plane > 0
