"""CPU kernels that spread voxels into the maps of their planes (``maps``) and read views off them, and back.

A map is worked on strip by strip, each some rows that stay in the second-level cache. Threads own planes; forward, a
fixed number of images is summed in order, so that no sum depends on the number of threads.

Kernels are kept small on purpose: inlined into one large function the innermost loops take twice as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import borrowed, inlined, kernel
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.pixel_weights import plane_of
from plenopiv.projection.plenoptic.plane_maps.maps import Maps, MapShape, MapSize
from plenopiv.projection.plenoptic.plane_maps.reading import read, roll, write
from plenopiv.projection.plenoptic.plane_maps.view_pixels import Views
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import first_line, spread_rows, sum_rows
from plenopiv.threads import in_turn

F = np.float32
ZERO = np.int64(0)  # of a plain 0 Numba makes a type of its own, and compiles twice what takes it
STRIP = 1 << 17  # points worked on at once: they stay in the second-level cache
RUNS = 16  # of planes, shared out among threads; forward, as many partial images are summed in order
FIRST = in_turn(RUNS)  # group of planes of a run, which takes every RUNS-th


@inlined
def rows_before(shape: MapShape, line: int, ny: int) -> int:
    """The number of rows of voxels that reach only rows of a map before ``line``."""
    return min((((line - 1 - shape[2]) << shape[5]) - 1) // shape[4] + 1, ny)


@inlined
def shape_of(shapes: NDArray[np.int64], k: int) -> MapShape:
    """What ``Maps.shape`` says of plane k, as numbers: an array is dear to take apart."""
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
    maps: Maps,
    ny: int,
    views: Views,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    strip: NDArray[np.float32],
    spare: NDArray[np.float32],
    light: NDArray[np.float32],
) -> None:
    """Add to ``light`` (count,) what the pixels of some views collect of the listed voxels of ``planes`` (first, end),
    which share one map.

    The map is made strip by strip from above: rows of voxels are spread while they fit in, pixels read from the rows
    that no other voxel reaches, and what is left rolled to the strip's beginning."""
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
            spread_rows(of_plane(maps, k), shape, j, stop, top, rows, column, values, strip, spare)
        j = stop
        finished = first_line(shape, j) if j < ny else bottom
        for n in range(views.start.size - 1):
            read(cam, plane, size, border, views, n, top, top, finished - 1, strip, light)
        if bottom == height:
            return
        roll(strip, width, finished - 1 - top, lines)
        top = finished - 1


@inlined
def gather_planes(
    cam: CameraConstants,
    plane: Plane,
    shape: MapShape,
    border: NDArray[np.int64],
    planes: tuple[int, int],
    maps: Maps,
    ny: int,
    views: Views,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: int,
    strip: NDArray[np.float32],
    spare: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """What ``gather`` does for ``planes`` that share one map: it is made strip by strip from above, and rows of voxels
    are summed once all pixels around them are in."""
    size = size_of(shape)
    height, width, _ = size
    lines = strip.size // width
    strip[: lines * width] = F(0)
    top = written = j = ZERO
    while True:
        bottom = min(top + lines, height)
        for n in range(views.start.size - 1):
            write(cam, plane, size, border, views, n, top, written, bottom - 1, image, strip)
        written = bottom - 1
        stop = rows_before(shape, written, ny)
        for k in range(planes[0], planes[1]):
            rows = row_start[k * ny : (k + 1) * ny + 1]
            sum_rows(of_plane(maps, k), shape, j, stop, top, rows, column, strip, spare, multiply, out)
        j = stop
        if j == ny:
            return
        roll(strip, width, first_line(shape, j) - top, lines)
        top = first_line(shape, j)


def workspace_of(shape: NDArray[np.int64], size: int) -> tuple[int, int, int]:
    """Points of a strip of any plane's map: ``size``, or what two rows of voxels reach if that is more; and number and
    length of the lines of a row, as ``rows`` needs them."""
    most = 0
    for height, width, rows, _, points, _ in shape.tolist():
        most = max(most, max(min(size // width, height), 2 * rows + points + 2) * width)
    return most, 1 + (1 << int(shape[:, 5].max())), int(shape[:, 1].max())


@inlined
def of_plane(maps: Maps, k: int) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """A plane's shares, their outer products and the number of these."""
    return maps.shares[maps.start[k, 0] :], maps.parts[maps.start[k, 1] :], maps.rank[k]


@kernel
def forward(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    first: NDArray[np.int64],
    maps: Maps,
    workspace: tuple[int, int, int],
    views: Views,
    ny: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    partial: NDArray[np.float32],
) -> None:
    """Light of the listed voxels in the pixels of views. Planes ``first[g]`` to ``first[g + 1]`` share one map, seen
    as ``table[g]`` is (``maps.Read``). Each row of ``partial`` (RUNS, count) takes that of some of them; rows ``begin``
    to ``end`` are filled. ``workspace``: as ``workspace_of`` tells it."""
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, values, partial = borrowed((row_start, column, values, partial))
    for c in range(begin, end):
        partial[c] = F(0)
        strip, spare = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST[c], count, RUNS):  # far from focus and near it alike
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, size, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                forward_planes(
                    cam, plane, size, edge, planes, maps, ny, views, row_start, column, values, strip, spare, partial[c]
                )


@kernel
def gather(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    first: NDArray[np.int64],
    maps: Maps,
    workspace: tuple[int, int, int],
    views: Views,
    ny: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """For each listed voxel the sum of ``image`` (count,) over the pixels of views, each by the share of a wholly lit
    pixel that the voxel gives it, into ``out``; with ``multiply``, their number, ``out`` times ``factor_of`` it.
    ``table``, ``first``: as for ``forward``."""
    count, maps, views = first.size - 1, borrowed(maps), borrowed(views)
    row_start, column, image, out = borrowed((row_start, column, image, out))
    for c in range(begin, end):
        strip, spare = np.empty(workspace[0], np.float32), np.empty((workspace[1], workspace[2]), np.float32)
        for g in range(FIRST[c], count, RUNS):
            planes = first[g], first[g + 1]
            if row_start[planes[0] * ny] < row_start[planes[1] * ny]:
                plane, size, edge = plane_of(table, g), shape_of(maps.shape, planes[0]), maps.border[planes[0]]
                gather_planes(
                    cam, plane, size, edge, planes, maps, ny, views, row_start, column, image, multiply, strip, spare,
                    out,
                )  # fmt: skip
