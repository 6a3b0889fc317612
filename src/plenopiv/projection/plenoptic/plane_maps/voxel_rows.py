"""CPU kernels that spread rows of listed voxels into a map, and gather them from it (``strips``).

A voxel costs the rectangle of its shares. Where a footprint's shares are nearly the outer products of a few columns and
rows (``maps.factors``; a single one for square microlenses), a row of many voxels is cheaper spread along x into one
line first, and that line then into the rows of the map: which is taken is decided row by row, by their products.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, kernel, part
from plenopiv.projection.correction import factor_of
from plenopiv.projection.plenoptic.plane_maps.maps import MapShape
from plenopiv.projection.plenoptic.plane_maps.simd import add_products, row_products

F = np.float32
LINE = F(0.8)  # of a product of a voxel, what one along a line costs


@inlined
def pays(shape: MapShape, rank: int, listed: int) -> bool | np.bool_:
    """Whether a row with so many listed voxels is cheaper by ``rank`` outer products; forward and back alike, so that
    they stay transposes of one another."""
    _, width, rows, columns, _, shift = shape
    lines = rows + columns * (1 << shift)
    return rank > 0 and LINE * F(rank * lines * width) < F(listed * rows * columns)


@part
def add_line(source: NDArray[np.float32], factor: np.float32, count: int, out: NDArray[np.float32]) -> None:
    """Add ``factor`` times a line to ``out``."""
    for x in range(count):
        out[x] += factor * source[x]


@part
def parts_of(
    factors: NDArray[np.float32], shape: MapShape, j: int, r: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The r-th outer product of a plane: its column for the voxels of row j, and its rows."""
    _, _, rows, columns, points, shift = shape
    voxels = 1 << shift
    at = r * voxels * (rows + columns)
    return factors[at + ((points * j) & (voxels - 1)) * rows :], factors[at + voxels * rows :]


@inlined
def first_line(shape: MapShape, j: int) -> int:
    """The first row of its map that the voxels of row j of a plane reach."""
    return ((shape[4] * j) >> shape[5]) + 2


@inlined
def apart(n: int, count: int) -> int:
    """The n-th of so many voxels to spread: neighbours in the list come one after the other in time only once in four,
    as what one has just stored the other would wait for."""
    quarter = count // 4
    return n if n >= 4 * quarter else n // 4 + (n & 3) * quarter


@part
def spread_lines(
    factors: NDArray[np.float32],
    rank: int,
    shape: MapShape,
    j: int,
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    first: int,
    last: int,
    strip: NDArray[np.float32],
    line: int,
    spare: NDArray[np.float32],
) -> None:
    """Spread the listed voxels ``first`` to ``last`` of row j of a plane by its outer products; ``line``: where the
    shares of the voxel in column 0 begin; ``spare``: working memory for a few lines."""
    _, width, rows, columns, points, shift = shape
    among = (1 << shift) - 1
    for r in range(rank):
        down, across = parts_of(factors, shape, j, r)
        spare[0, :width] = F(0)
        for n in range(last - first):
            v = first + apart(n, last - first)
            i = points * np.int64(column[v])
            add_products(across, (i & among) * columns, columns, values[v], spare[0], i >> shift, width, 1)
        for n in range(rows):
            add_line(spare[0], down[n], width - 2, strip[line + n * width :])


@kernel
def spread_rows(
    own: tuple[NDArray[np.float32], NDArray[np.float32], int],
    shape: MapShape,
    begin: int,
    end: int,
    top: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    strip: NDArray[np.float32],
    spare: NDArray[np.float32],
) -> None:
    """Spread the listed voxels of rows ``begin`` to ``end`` of a plane into the strip of its map that begins with row
    ``top``. ``own``: the plane's shares, its outer products and their number."""
    shares, factors, rank = own
    _, width, rows, columns, points, shift = shape
    among, size = (1 << shift) - 1, rows * columns
    for j in range(begin, end):
        first, last = row_start[j], row_start[j + 1]
        if first == last:
            continue
        line = (first_line(shape, j) - top) * width + 2
        if pays(shape, rank, last - first):
            spread_lines(factors, rank, shape, j, column, values, first, last, strip, line, spare)
            continue
        of_row = ((points * j) & among) * (among + 1) * size
        for n in range(last - first):
            v = first + apart(n, last - first)
            i = points * np.int64(column[v])
            add_products(
                shares, of_row + (i & among) * size, columns, values[v], strip, line + (i >> shift), width, rows
            )


@part
def sum_lines(
    factors: NDArray[np.float32],
    rank: int,
    shape: MapShape,
    j: int,
    column: NDArray[np.uint16],
    first: int,
    last: int,
    strip: NDArray[np.float32],
    line: int,
    spare: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """The transpose of ``spread_lines``, into ``out`` as ``sum_rows``."""
    _, width, rows, columns, points, shift = shape
    voxels = 1 << shift
    for p in range(voxels):
        spare[1 + p, :width] = F(0)
    for r in range(rank):
        down, across = parts_of(factors, shape, j, r)
        spare[0, :width] = F(0)
        for n in range(rows):
            add_line(strip[line + n * width :], down[n], width - 2, spare[0])
        for p in range(voxels):
            for n in range(columns):
                add_line(spare[0, n:], across[p * columns + n], width - 2 - n, spare[1 + p])
    for v in range(first, last):
        i = points * np.int64(column[v])
        total = spare[1 + (i & (voxels - 1)), i >> shift]
        out[v] = out[v] * factor_of(total, multiply) if multiply else total


@kernel
def sum_rows(
    own: tuple[NDArray[np.float32], NDArray[np.float32], int],
    shape: MapShape,
    begin: int,
    end: int,
    top: int,
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    strip: NDArray[np.float32],
    spare: NDArray[np.float32],
    multiply: int,
    out: NDArray[np.float32],
) -> None:
    """Sum around the listed voxels of rows of a plane, the transpose of ``spread_rows``, into ``out``; with
    ``multiply``, a number of views, ``out`` times ``factor_of`` it."""
    shares, factors, rank = own
    _, width, rows, columns, points, shift = shape
    among, size = (1 << shift) - 1, rows * columns
    for j in range(begin, end):
        first, last = row_start[j], row_start[j + 1]
        if first == last:
            continue
        line = (first_line(shape, j) - top) * width + 2
        if pays(shape, rank, last - first):
            sum_lines(factors, rank, shape, j, column, first, last, strip, line, spare, multiply, out)
            continue
        of_row = ((points * j) & among) * (among + 1) * size
        for v in range(first, last):
            i = points * np.int64(column[v])
            total = row_products(shares, of_row + (i & among) * size, columns, strip, line + (i >> shift), width, rows)
            out[v] = out[v] * factor_of(total, multiply) if multiply else total
