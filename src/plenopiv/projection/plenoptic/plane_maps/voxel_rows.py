"""Kernels that spread rows of listed voxels into a strip of a plane's map, and gather them from it.

A voxel costs one product for each weight in the rectangle around it. Where those weights are nearly a sum of a few
outer products of columns and rows (``PlaneMaps.factors``; a single one for square microlenses), a row of many voxels
costs less when it is first spread along x into one line, and that line then into the rows of the map. Which of the two
is done is decided row by row, by the number of products.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, part, part_with_way_in
from plenopiv.projection.correction import factor_of
from plenopiv.projection.plenoptic.plane_maps.maps import MapShape
from plenopiv.projection.plenoptic.plane_maps.simd import add_products, row_products

F = np.float32
LINE_COST = F(0.8)  # cost of a product along a line, where a product of a voxel's rectangle costs 1


@inlined
def separable_is_cheaper(shape: MapShape, rank: int, listed: int) -> bool | np.bool_:
    """Whether a row with so many ``listed`` voxels costs less by ``rank`` outer products. Forward and back decide
    alike, so that they stay transposes of one another."""
    _, width, rows, columns, _, shift = shape
    lines = rows + columns * (1 << shift)
    return rank > 0 and LINE_COST * F(rank * lines * width) < F(listed * rows * columns)


@part
def add_scaled(source: NDArray[np.float32], factor: np.float32, count: int, out: NDArray[np.float32]) -> None:
    """Add ``factor`` times the first ``count`` numbers of ``source`` to ``out``."""
    for x in range(count):
        out[x] += factor * source[x]


@part
def outer_product(
    factors: NDArray[np.float32], shape: MapShape, j: int, r: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The r-th outer product of a plane: its column for the voxels of row j, and its rows for all voxels along x."""
    _, _, rows, columns, points, shift = shape
    voxels = 1 << shift
    at = r * voxels * (rows + columns)
    return factors[at + ((points * j) & (voxels - 1)) * rows :], factors[at + voxels * rows :]


@inlined
def first_map_row(shape: MapShape, j: int) -> int:
    """The first row of the map that the voxels of row j of a plane reach."""
    return ((shape[4] * j) >> shape[5]) + 2


@inlined
def interleaved(n: int, count: int) -> int:
    """The n-th of ``count`` voxels in the order of spreading, which takes from the four quarters of the list in turn:
    neighbours in the list write to the same points, and the second would wait until the first is stored."""
    quarter = count // 4
    return n if n >= 4 * quarter else n // 4 + (n & 3) * quarter


@part
def spread_separable(
    factors: NDArray[np.float32],
    rank: int,
    shape: MapShape,
    j: int,
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    first: int,
    last: int,
    strip: NDArray[np.float32],
    origin: int,
    buffer: NDArray[np.float32],
) -> None:
    """Spread the listed voxels ``first`` to ``last`` of row j of a plane by its outer products. ``origin``: where the
    weights of the voxel in column 0 begin in ``strip``. ``buffer``: working memory for a few lines."""
    _, width, rows, columns, points, shift = shape
    among = (1 << shift) - 1
    for r in range(rank):
        down, across = outer_product(factors, shape, j, r)
        buffer[0, :width] = F(0)
        for n in range(last - first):
            v = first + interleaved(n, last - first)
            i = points * np.int64(column[v])
            add_products(across, (i & among) * columns, columns, values[v], buffer[0], i >> shift, width, 1)
        for n in range(rows):
            add_scaled(buffer[0], down[n], width - 2, strip[origin + n * width :])


@part_with_way_in
def spread_rows(
    plane_weights: tuple[NDArray[np.float32], NDArray[np.float32], int],
    shape: MapShape,
    begin: int,
    end: int,
    top: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    strip: NDArray[np.float32],
    buffer: NDArray[np.float32],
) -> None:
    """Spread the listed voxels of rows ``begin`` to ``end`` of a plane into the strip of its map that begins with row
    ``top``. ``plane_weights``: of the plane, its weights, its outer products and their number."""
    weights, factors, rank = plane_weights
    _, width, rows, columns, points, shift = shape
    among, size = (1 << shift) - 1, rows * columns
    for j in range(begin, end):
        first, last = row_start[j], row_start[j + 1]
        if first == last:
            continue
        origin = (first_map_row(shape, j) - top) * width + 2
        if separable_is_cheaper(shape, rank, last - first):
            spread_separable(factors, rank, shape, j, column, values, first, last, strip, origin, buffer)
            continue
        of_row = ((points * j) & among) * (among + 1) * size
        for n in range(last - first):
            v = first + interleaved(n, last - first)
            i = points * np.int64(column[v])
            add_products(
                weights, of_row + (i & among) * size, columns, values[v], strip, origin + (i >> shift), width, rows
            )


@part
def sum_separable(
    factors: NDArray[np.float32],
    rank: int,
    shape: MapShape,
    j: int,
    column: NDArray[np.uint16],
    first: int,
    last: int,
    strip: NDArray[np.float32],
    origin: int,
    buffer: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """The transpose of ``spread_separable``, into ``out`` as ``sum_rows``."""
    _, width, rows, columns, points, shift = shape
    voxels = 1 << shift
    for p in range(voxels):
        buffer[1 + p, :width] = F(0)
    for r in range(rank):
        down, across = outer_product(factors, shape, j, r)
        buffer[0, :width] = F(0)
        for n in range(rows):
            add_scaled(strip[origin + n * width :], down[n], width - 2, buffer[0])
        for p in range(voxels):
            for n in range(columns):
                add_scaled(buffer[0, n:], across[p * columns + n], width - 2 - n, buffer[1 + p])
    for v in range(first, last):
        i = points * np.int64(column[v])
        total = buffer[1 + (i & (voxels - 1)), i >> shift]
        out[v] = out[v] * factor_of(total, multiply) if multiply else total


@part_with_way_in
def sum_rows(
    plane_weights: tuple[NDArray[np.float32], NDArray[np.float32], int],
    shape: MapShape,
    begin: int,
    end: int,
    top: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    strip: NDArray[np.float32],
    buffer: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """For each listed voxel of rows ``begin`` to ``end`` of a plane the sum of the points around it by its weights, the
    transpose of ``spread_rows``, into ``out``; with ``multiply``, a number of views, ``out`` times ``factor_of`` that
    sum."""
    weights, factors, rank = plane_weights
    _, width, rows, columns, points, shift = shape
    among, size = (1 << shift) - 1, rows * columns
    for j in range(begin, end):
        first, last = row_start[j], row_start[j + 1]
        if first == last:
            continue
        origin = (first_map_row(shape, j) - top) * width + 2
        if separable_is_cheaper(shape, rank, last - first):
            sum_separable(factors, rank, shape, j, column, first, last, strip, origin, buffer, multiply, out)
            continue
        of_row = ((points * j) & among) * (among + 1) * size
        for v in range(first, last):
            i = points * np.int64(column[v])
            total = row_products(
                weights, of_row + (i & among) * size, columns, strip, origin + (i >> shift), width, rows
            )
            out[v] = out[v] * factor_of(total, multiply) if multiply else total
