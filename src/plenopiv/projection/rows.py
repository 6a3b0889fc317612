"""CPU kernels that spread rows of listed voxels into a map, and gather them from it (``strips``).

A voxel costs the rectangle of its shares. Where a footprint's shares are nearly the outer products of a few columns and
rows (``maps.factors``; a single one for square microlenses), a row of many voxels is cheaper spread along x into one
line first, and that line then into the rows of the map: which is taken is decided row by row, by their products.
"""

from __future__ import annotations

import numpy as np

from plenopiv.kernels import inlined, kernel
from plenopiv.projection.simd import add_products, row_products

F = np.float32
LINE = F(0.8)  # of a product of a voxel, what one along a line costs


@inlined
def factor_of(total, views):
    """What a voxel is multiplied by when the corrections of so many views sum to ``total``: 1 + total where they add
    light, and where they take it (1 + total / views)^views, which the product of 1 + each never exceeds; >= 0."""
    if total >= F(0):
        return F(1) + total
    each = max(F(1) + total / F(views), F(0))
    factor = each
    for _ in range(views - 1):
        factor *= each
    return factor


@inlined
def pays(shape, rank, listed):
    """Whether a row with so many listed voxels is cheaper by ``rank`` outer products; forward and back alike, so that
    they stay transposes of one another."""
    _, width, rows, columns, _, shift = shape
    lines = rows + columns * (1 << shift)
    return rank > 0 and LINE * F(rank * lines * width) < F(listed * rows * columns)


@kernel
def spread_voxels(shares, shape, rows, column, values, first, last, strip, line):
    """Spread listed voxels one by one, each over so many rows; ``line``: where the shares of the voxel in column 0
    would go. Neighbours in the list come one after the other in time only once in four: what one has just stored the
    other would wait for."""
    _, width, _, columns, points, shift = shape
    among, size = (1 << shift) - 1, rows * columns
    quarter = (last - first) // 4
    for n in range(last - first):
        v = first + n if n >= 4 * quarter else first + n // 4 + (n & 3) * quarter
        i = points * np.int64(column[v])
        add_products(shares, (i & among) * size, columns, values[v], strip, line + (i >> shift), width, rows)


@kernel
def add_line(source, factor, count, out):
    """Add ``factor`` times a line to ``out``."""
    for x in range(count):
        out[x] += factor * source[x]


@kernel
def parts_of(factors, shape, j, r):
    """The r-th outer product of a plane: its column for the voxels of row j, and its rows."""
    _, _, rows, columns, points, shift = shape
    voxels = 1 << shift
    at = r * voxels * (rows + columns)
    return factors[at + ((points * j) & (voxels - 1)) * rows :], factors[at + voxels * rows :]


@kernel
def spread_row(own, shape, j, column, values, first, last, strip, line, spare):
    """Spread the listed voxels ``first`` to ``last`` of row j of a plane. ``own``: its shares, its outer products and
    their number; ``line``: where the shares of the voxel in column 0 begin; ``spare``: room for a few lines."""
    shares, factors, rank = own
    _, width, rows, columns, points, shift = shape
    voxels = 1 << shift
    if not pays(shape, rank, last - first):
        of_row = shares[((points * j) & (voxels - 1)) * voxels * rows * columns :]
        spread_voxels(of_row, shape, rows, column, values, first, last, strip, line)
        return
    for r in range(rank):
        down, across = parts_of(factors, shape, j, r)
        spare[0, :width] = F(0)
        spread_voxels(across, shape, 1, column, values, first, last, spare[0], 0)
        for n in range(rows):
            add_line(spare[0], down[n], width - 2, strip[line + n * width :])


@kernel
def sum_row(own, shape, j, column, first, last, strip, line, spare, multiply, out):
    """Sum around the listed voxels of row j, the transpose of ``spread_row``, into ``out``; with ``multiply``, a number
    of views, ``out`` times ``factor_of`` it."""
    shares, factors, rank = own
    _, width, rows, columns, points, shift = shape
    voxels, size = 1 << shift, rows * columns
    if not pays(shape, rank, last - first):
        of_row = shares[((points * j) & (voxels - 1)) * voxels * size :]
        for v in range(first, last):
            i = points * np.int64(column[v])
            total = row_products(of_row, (i & (voxels - 1)) * size, columns, strip, line + (i >> shift), width, rows)
            out[v] = out[v] * factor_of(total, multiply) if multiply else total
        return
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
