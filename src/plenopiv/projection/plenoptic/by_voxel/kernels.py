"""Kernels that go through the listed voxels: for each the microlenses that it lights in a view.

A block of listed voxels of one plane is worked on at once. The microlenses that a voxel may light in a view are a small
window of lattice indices, as many slots for every voxel of the plane. Slot by slot, positions are plain arithmetic on
whole vectors of voxels but for the lenses' phases and places, which are read from tables. Pairs of a voxel and a lens
that it does light, a quarter to a half of them, are collected; their weights are again vector arithmetic, and only then
are images read or added to.

The list is cut into fixed chunks; each sums into an image of its own and the caller adds those in order, so results do
not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel, part
from plenopiv.projection.plenoptic.blurred import table_weight
from plenopiv.projection.plenoptic.by_voxel.slots import (
    block_centres,
    first_lenses,
    first_rows,
    move_block,
    slot_places,
)
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.pixel_weights import (
    EXACT,
    ONE_RAY,
    pixel_weight,
    plane_of,
    ray_inside,
    ray_weight,
    reach_of,
    rim_weight,
)
from plenopiv.projection.plenoptic.plane_maps.view_pixels import lit_part

BLOCK = 128  # voxels worked on at once
PAIRS = 512  # pairs of a voxel and a lens worked on at once
F = np.float32


@part
def collect_pairs(
    count: int,
    reach_x: np.float32,
    reach_y: np.float32,
    lens: NDArray[np.int64],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    qx: NDArray[np.float32],
    qy: NDArray[np.float32],
    pairs: int,
    pair_voxel: NDArray[np.int32],
    pair_lens: NDArray[np.int64],
    pair_x: NDArray[np.float32],
    pair_y: NDArray[np.float32],
    pair_qx: NDArray[np.float32],
    pair_qy: NDArray[np.float32],
) -> int:
    """Append to the pairs those voxels of a slot that light their lens; returns the new number of pairs."""
    for k in range(count):
        pair_voxel[pairs], pair_lens[pairs] = k, lens[k]
        pair_x[pairs], pair_y[pairs], pair_qx[pairs], pair_qy[pairs] = x[k], y[k], qx[k], qy[k]
        pairs += (lens[k] >= 0) & (abs(x[k]) < reach_x) & (abs(y[k]) < reach_y)
    return pairs


@part
def blurred_weights(
    cam: CameraConstants,
    plane: Plane,
    blurred: NDArray[np.float32],
    rim: bool,
    pairs: int,
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    qx: NDArray[np.float32],
    qy: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """``pair_weights`` where the main lens blurs. A pixel that the rim cuts has the footprint of a whole one at the
    middle of its lit part."""
    wide, high = reach_of(cam, plane, np.int64(EXACT))
    for k in range(pairs):
        lit, px, py = F(1), x[k], y[k]
        if rim:
            lit, u, v = lit_part(cam.radius, plane.spread, qx[k], qy[k])
            u, v = plane.move * (u - qx[k]), plane.move * (v - qy[k])
            px, py = px + cam.cos * u + cam.sin * v, py + cam.cos * v - cam.sin * u
        weight[k] = lit * table_weight(blurred, wide, high, px, py)


@part
def pair_weights(
    cam: CameraConstants,
    plane: Plane,
    blurred: NDArray[np.float32],
    rule: int,
    rim: bool,
    share: NDArray[np.float32],
    pairs: int,
    lens: NDArray[np.int64],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    qx: NDArray[np.float32],
    qy: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """The weight of the voxel of each pair in its lens' pixel, into ``weight``. ``share``: lit share of the pixels
    (lens,). ``blurred``: of the plane, ``blurred.tables_of``."""
    if rule == EXACT and cam.blur > F(0):
        blurred_weights(cam, plane, blurred, rim, pairs, x, y, qx, qy, weight)
    elif rule == ONE_RAY:
        for k in range(pairs):
            weight[k] = share[lens[k]] * ray_inside(cam, x[k], y[k])
    elif rule == EXACT and not rim:
        for k in range(pairs):
            weight[k] = pixel_weight(cam, plane, x[k], y[k])
    elif rule == EXACT:
        for k in range(pairs):
            weight[k] = rim_weight(cam, plane, qx[k], qy[k], x[k], y[k])
    else:
        for k in range(pairs):
            weight[k] = F(0)
        for ray in range(9):
            for k in range(pairs):
                weight[k] += ray_weight(cam, plane, rim, qx[k], qy[k], ray, x[k], y[k])


@part
def fill_block(
    plane_end: int,
    start: int,
    row: int,
    ny: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    block_column: NDArray[np.int32],
    block_row: NDArray[np.int32],
) -> tuple[int, int]:
    """The next block of listed voxels of a plane from voxel ``start`` in ``row``; returns their number and the row
    reached."""
    count = 0
    while count < BLOCK and start + count < plane_end:
        while row_start[row + 1] <= start + count:
            row += 1
        block_column[count] = column[start + count]
        block_row[count] = row % ny
        count += 1
    return count, row


@kernel
def project(
    begin: int,
    end: int,
    cam: CameraConstants,
    box: tuple[int, int, int, int],
    phase: NDArray[np.float32],
    moved: NDArray[np.float32],
    change: np.float32,
    table: NDArray[np.float32],
    blurred: NDArray[np.float32],
    ny: int,
    rule: int,
    rim: bool,
    m: np.float32,
    n: np.float32,
    share: NDArray[np.float32],
    chunks: NDArray[np.int64],
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    image: NDArray[np.float32],
    partial: NDArray[np.float32],
    out: NDArray[np.float32],
    scatter: bool,
) -> None:
    """Project the listed voxels to one view, or an image of it back to the voxels.

    ``scatter``: add the voxels' light to ``partial`` (chunk, lens). Otherwise: the sum of ``image`` (lens,) for each
    voxel by its weights, into ``out``. ``phase`` (lens, 2) of the lenses, and ``moved`` (lens, 2) how far the array
    moves them along and across the rows, in pitches; (1, 2) of a regular one; ``change``: how much this changes at most
    from one lens to the next. ``chunks``: bounds of runs of rows, of which ``begin`` to ``end`` are worked on.
    """
    for c in range(begin, end):
        block_column, block_row = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
        j_of, first_i, lens = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
        by = np.empty(BLOCK, np.int64)
        cx, cy, total = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        x, y = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        qx, qy = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        pair_voxel, pair_lens = np.empty(PAIRS, np.int32), np.empty(PAIRS, np.int64)
        pair_x, pair_y = np.empty(PAIRS, np.float32), np.empty(PAIRS, np.float32)
        pair_qx, pair_qy, weight = np.empty(PAIRS, np.float32), np.empty(PAIRS, np.float32), np.empty(PAIRS, np.float32)
        if scatter:
            partial[c, :] = F(0)
        row = chunks[c]
        while row < chunks[c + 1]:
            plane, of_plane = plane_of(table, row // ny), blurred[row // ny]
            last_row = min((row // ny + 1) * ny, chunks[c + 1])
            start, plane_end = row_start[row], row_start[last_row]
            reach_x, reach_y = reach_of(cam, plane, rule)
            slack = F(0.5) * abs(plane.move) * (abs(cam.cos) + abs(cam.sin))  # what a phase of half a pixel can move
            if moved.shape[0] > 1:
                slack += change * (max(reach_x, reach_y) + slack + plane.pitch)
            wide, high = reach_x + slack, reach_y + slack
            lenses, lens_rows = (
                np.int64(F(2) * wide / plane.pitch) + 1,
                np.int64(F(2) * high / (plane.pitch * cam.row)) + 1,
            )
            slots = lenses * lens_rows
            while start < plane_end:
                count, row = fill_block(plane_end, start, row, ny, row_start, column, block_column, block_row)
                block_centres(cam, plane, m, n, count, block_column, block_row, cx, cy)
                if moved.shape[0] > 1:
                    move_block(cam, box, plane, moved, count, cx, cy, by)
                first_rows(cam, plane, count, cy, j_of, high)
                for k in range(count):
                    total[k] = values[start + k] * plane.light if scatter else F(0)
                pairs = 0
                for slot in range(slots):
                    dj, di = slot // lenses, slot % lenses
                    if di == 0:
                        first_lenses(cam, plane, count, cx, j_of, dj, wide, first_i)
                    lenses_of = box, phase, moved
                    slot_places(
                        cam, *lenses_of, plane, count, cx, cy, by, first_i, j_of, dj, di, lens, x, y, qx, qy, m, n
                    )
                    pairs = collect_pairs(
                        count,
                        reach_x,
                        reach_y,
                        lens,
                        x,
                        y,
                        qx,
                        qy,
                        pairs,
                        pair_voxel,
                        pair_lens,
                        pair_x,
                        pair_y,
                        pair_qx,
                        pair_qy,
                    )
                    if pairs < PAIRS - BLOCK and slot < slots - 1:
                        continue
                    pair_weights(
                        cam,
                        plane,
                        of_plane,
                        rule,
                        rim,
                        share,
                        pairs,
                        pair_lens,
                        pair_x,
                        pair_y,
                        pair_qx,
                        pair_qy,
                        weight,
                    )
                    if scatter:
                        for k in range(pairs):
                            partial[c, pair_lens[k]] += weight[k] * total[pair_voxel[k]]
                    else:
                        for k in range(pairs):
                            total[pair_voxel[k]] += weight[k] * image[pair_lens[k]]
                    pairs = 0
                if not scatter:
                    for k in range(count):
                        out[start + k] = total[k]
                start += count
            row = last_row
