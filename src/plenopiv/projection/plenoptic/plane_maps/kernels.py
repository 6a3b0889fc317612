"""Kernels: listed voxels of each plane are spread into its map, views are read off the maps, and back.

A map is worked on in *strips*: some consecutive rows of it that fit into the second-level cache. A *group* is the
planes that share one map (``maps.PlaneGroups``). Each thread has groups of its own; forward, a fixed number of partial
images is summed in order, so that no sum depends on the number of threads.

Kernels are kept small on purpose: inlined into one large function the innermost loops take twice as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import borrowed, inlined, kernel
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.pixel_weights import plane_of
from plenopiv.projection.plenoptic.plane_maps.maps import MapShape, MapSize, PlaneMaps
from plenopiv.projection.plenoptic.plane_maps.reading import move_up, read_view, write_view
from plenopiv.projection.plenoptic.plane_maps.view_pixels import ViewPixels
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import first_map_row, spread_rows, sum_rows
from plenopiv.threads import in_turn

F = np.float32
ZERO = np.int64(0)  # of a plain 0 Numba makes a type of its own, and compiles twice what takes it
STRIP = 1 << 17  # points worked on at once: they stay in the second-level cache
RUNS = 16  # of groups of planes, distributed among threads; forward, as many partial images are summed in order
FIRST_GROUP = in_turn(RUNS)  # of a run, which takes every RUNS-th group of planes


@inlined
def rows_before(shape: MapShape, map_row: int, ny: int) -> int:
    """The number of rows of voxels that reach only rows of the map before ``map_row``."""
    return min((((map_row - 1 - shape[2]) << shape[5]) - 1) // shape[4] + 1, ny)


@inlined
def shape_of(shapes: NDArray[np.int64], k: int) -> MapShape:
    """``PlaneMaps.shape`` of plane k as numbers: taking an array apart again and again costs time."""
    return shapes[k, 0], shapes[k, 1], shapes[k, 2], shapes[k, 3], shapes[k, 4], shapes[k, 5]


@inlined
def size_of(shape: MapShape) -> MapSize:
    """Rows and columns of a map, and points to a voxel."""
    return shape[0], shape[1], F(shape[4]) / F(1 << shape[5])


@inlined
def forward_planes(
    cam: CameraConstants,
    plane: Plane,
    shape: MapShape,
    border: NDArray[np.int64],
    planes: tuple[int, int],
    maps: PlaneMaps,
    ny: int,
    views: ViewPixels,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    strip: NDArray[np.float32],
    buffer: NDArray[np.float32],
    light: NDArray[np.float32],
) -> None:
    """Add to ``light`` (count,) what the pixels of the views collect of the listed voxels of ``planes`` (first, end),
    one group.

    The map is made strip by strip from above: rows of voxels are spread as long as the strip holds all that they reach;
    pixels are read from the rows that no further voxel reaches; the remaining rows move to the beginning of the strip.
    """
    size = size_of(shape)
    height, width, _ = size
    lines = strip.size // width
    strip[: lines * width] = F(0)
    top = j = ZERO
    while True:
        bottom = min(top + lines, height)
        stop = rows_before(shape, bottom, ny)
        for k in range(planes[0], planes[1]):
            rows = row_start[k * ny : (k + 1) * ny + 1]
            spread_rows(weights_of(maps, k), shape, j, stop, top, rows, column, values, strip, buffer)
        j = stop
        finished = first_map_row(shape, j) if j < ny else bottom
        for n in range(views.start.size - 1):
            read_view(cam, plane, size, border, views, n, top, top, finished - 1, strip, light)
        if bottom == height:
            return
        move_up(strip, width, finished - 1 - top, lines)
        top = finished - 1


@inlined
def gather_planes(
    cam: CameraConstants,
    plane: Plane,
    shape: MapShape,
    border: NDArray[np.int64],
    planes: tuple[int, int],
    maps: PlaneMaps,
    ny: int,
    views: ViewPixels,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: int,
    strip: NDArray[np.float32],
    buffer: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """``gather`` for ``planes``, one group. The map is made strip by strip from above, and rows of voxels are summed as
    soon as the strip holds the corrections of all pixels around them."""
    size = size_of(shape)
    height, width, _ = size
    lines = strip.size // width
    strip[: lines * width] = F(0)
    top = written = j = ZERO
    while True:
        bottom = min(top + lines, height)
        for n in range(views.start.size - 1):
            write_view(cam, plane, size, border, views, n, top, written, bottom - 1, image, strip)
        written = bottom - 1
        stop = rows_before(shape, written, ny)
        for k in range(planes[0], planes[1]):
            rows = row_start[k * ny : (k + 1) * ny + 1]
            sum_rows(weights_of(maps, k), shape, j, stop, top, rows, column, strip, buffer, multiply, out)
        j = stop
        if j == ny:
            return
        move_up(strip, width, first_map_row(shape, j) - top, lines)
        top = first_map_row(shape, j)


def workspace_size(shape: NDArray[np.int64], size: int) -> tuple[int, int, int]:
    """Sizes of a thread's working memory: points of the largest strip, which is ``size``, or what two rows of voxels
    reach where that is more; number and length of the lines that ``voxel_rows`` needs."""
    most = 0
    for height, width, rows, _, points, _ in shape.tolist():
        most = max(most, max(min(size // width, height), 2 * rows + points + 2) * width)
    return most, 1 + (1 << int(shape[:, 5].max())), int(shape[:, 1].max())


@inlined
def weights_of(maps: PlaneMaps, k: int) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """The weights of a plane, its outer products and their number."""
    return maps.weights[maps.start[k, 0] :], maps.factors[maps.start[k, 1] :], maps.rank[k]


@kernel
def forward(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    first: NDArray[np.int64],
    maps: PlaneMaps,
    workspace: tuple[int, int, int],
    views: ViewPixels,
    ny: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    partial: NDArray[np.float32],
) -> None:
    """Light of the listed voxels in the pixels of ``views``.

    Planes ``first[g]`` to ``first[g + 1]`` are group g, with the constants ``table[g]``. Each row of ``partial`` (RUNS,
    count) takes the light of every RUNS-th group; rows ``begin`` to ``end`` are filled. ``workspace``:
    ``workspace_size``.
    """
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, values, partial = borrowed((row_start, column, values, partial))
    for c in range(begin, end):
        partial[c] = F(0)
        strip, buffer = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST_GROUP[c], count, RUNS):  # so that each run has planes near focus and far from it
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, shape, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                forward_planes(
                    cam,
                    plane,
                    shape,
                    edge,
                    planes,
                    maps,
                    ny,
                    views,
                    row_start,
                    column,
                    values,
                    strip,
                    buffer,
                    partial[c],
                )


@kernel
def gather(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    first: NDArray[np.int64],
    maps: PlaneMaps,
    workspace: tuple[int, int, int],
    views: ViewPixels,
    ny: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """For each listed voxel the sum of ``image`` (count,) over the pixels of ``views`` by its weights, into ``out``;
    with ``multiply``, the number of views, ``out`` times ``factor_of`` that sum. ``table``, ``first``, ``workspace`` as
    in ``forward``."""
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, image, out = borrowed((row_start, column, image, out))
    for c in range(begin, end):
        strip, buffer = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST_GROUP[c], count, RUNS):
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, shape, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                gather_planes(
                    cam, plane, shape, edge, planes, maps, ny, views, row_start, column, image, multiply, strip, buffer,
                    out,
                )  # fmt: skip
