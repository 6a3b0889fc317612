"""CPU kernels for pinhole cameras: the square shadow of each voxel on the pixels of a camera, there and back.

A voxel's light falls evenly on a square about the image of its centre, ``half`` a shadow to each side; a pixel's share
is the area that it covers of it, the product of two lengths. Shares sum to 1. Where a voxel is imaged is computed in
double precision: along columns of thousands of pixels single precision would move shadows by 1e-4 px.

Sums for images run in fixed chunks of rows of voxels, each into an image of its own; the caller adds those in order.
"""

from __future__ import annotations

from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import borrowed, inlined, kernel
from plenopiv.projection.correction import factor_of

F = np.float32
Place = tuple[float, float, float]


class Sight(NamedTuple):
    """A camera before a grid, as kernels take it. In the camera's frame (right, up, forward), mm: ``first``, the centre
    of voxel (0, 0, 0), and the steps ``along_x``, ``along_y``, ``along_z`` from voxel to voxel. ``half_column``,
    ``half_row``: half a voxel's shadow, px. ``columns``, ``rows`` of the sensor."""

    first: Place
    along_x: Place
    along_y: Place
    along_z: Place
    focal: float
    column0: float
    row0: float
    k1: float
    k2: float
    half_column: float
    half_row: float
    columns: int
    rows: int


@inlined
def row_of(sight: Sight, j: int, k: int) -> Place:
    """The first voxel of row j in plane k, in the camera's frame."""
    a, y, z = sight.first, sight.along_y, sight.along_z
    return a[0] + j * y[0] + k * z[0], a[1] + j * y[1] + k * z[1], a[2] + j * y[2] + k * z[2]


@inlined
def image_of(sight: Sight, row: Place, i: int) -> tuple[float, float]:
    """(column, row) of voxel i of a row."""
    step = sight.along_x
    nearness = 1.0 / (row[2] + i * step[2])
    a, b = (row[0] + i * step[0]) * nearness, (row[1] + i * step[1]) * nearness
    squared = a * a + b * b
    stretch = sight.focal * (1.0 + squared * (sight.k1 + squared * sight.k2))
    return sight.column0 + stretch * a, sight.row0 - stretch * b


@inlined
def share_of(pixel: int, middle: float, half: float) -> np.float32:
    """Share of a shadow about ``middle`` that falls on a pixel, along one axis."""
    covered = min(pixel + 0.5, middle + half) - max(pixel - 0.5, middle - half)
    return F(max(covered, 0.0) / (2.0 * half))


@inlined
def shadow_sum(sight: Sight, image: NDArray[np.float32], column: float, row: float) -> np.float32:
    """Sum of ``image`` (pixel,) over the shadow about (column, row), each pixel by its share."""
    total = F(0)
    last_column = min(floor(column + sight.half_column + 0.5), sight.columns - 1)
    last_row = min(floor(row + sight.half_row + 0.5), sight.rows - 1)
    first_column = max(floor(column - sight.half_column + 0.5), 0)
    for r in range(max(floor(row - sight.half_row + 0.5), 0), last_row + 1):
        along = F(0)
        for c in range(first_column, last_column + 1):
            along += share_of(c, column, sight.half_column) * image[r * sight.columns + c]
        total += share_of(r, row, sight.half_row) * along
    return total


@inlined
def add_shadow(sight: Sight, image: NDArray[np.float32], column: float, row: float, light: np.float32) -> None:
    """Add ``light`` to ``image`` (pixel,) over the shadow about (column, row): the transpose of ``shadow_sum``."""
    last_column = min(floor(column + sight.half_column + 0.5), sight.columns - 1)
    last_row = min(floor(row + sight.half_row + 0.5), sight.rows - 1)
    first_column = max(floor(column - sight.half_column + 0.5), 0)
    for r in range(max(floor(row - sight.half_row + 0.5), 0), last_row + 1):
        of_row = share_of(r, row, sight.half_row) * light
        for c in range(first_column, last_column + 1):
            image[r * sight.columns + c] += share_of(c, column, sight.half_column) * of_row


@kernel
def project(
    begin: int,
    end: int,
    sight: Sight,
    ny: int,
    chunks: NDArray[np.int64],
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    partial: NDArray[np.float32],
) -> None:
    """The listed voxels' light in one camera: chunk c of their rows into ``partial[c]`` (pixel,)."""
    chunks, row_start, column, values = borrowed((chunks, row_start, column, values))
    partial = borrowed(partial)
    for chunk in range(begin, end):
        image = partial[chunk]
        image[:] = F(0)
        for of in range(chunks[chunk], chunks[chunk + 1]):
            row = row_of(sight, of % ny, of // ny)
            for v in range(row_start[of], row_start[of + 1]):
                c, r = image_of(sight, row, np.int64(column[v]))
                add_shadow(sight, image, c, r, values[v])


@kernel
def gather(
    begin: int,
    end: int,
    sight: Sight,
    ny: int,
    chunks: NDArray[np.int64],
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: bool,
    out: NDArray[np.float32],
) -> None:
    """Add, for each listed voxel of the chunks, the sum of ``image`` over its shadow to ``out`` (voxel,); or
    ``multiply`` that by what ``factor_of`` makes of the sum, one camera's corrections."""
    row_start, column, image, out = borrowed((row_start, column, image, out))
    for of in range(chunks[begin], chunks[end]):
        row = row_of(sight, of % ny, of // ny)
        for v in range(row_start[of], row_start[of + 1]):
            c, r = image_of(sight, row, np.int64(column[v]))
            total = shadow_sum(sight, image, c, r)
            out[v] = out[v] * factor_of(total, 1) if multiply else out[v] + total


@kernel
def least_along_sight(
    begin: int,
    end: int,
    sight: Sight,
    first_plane: int,
    image: NDArray[np.float32],
    least: NDArray[np.float32],
    product: NDArray[np.float64],
) -> None:
    """Planes ``begin`` to ``end`` of a slab (z, y, x) that starts at ``first_plane``: lower ``least`` to the light of
    ``image`` that meets each voxel, multiply ``product`` by it; both become 0 where the camera does not see it."""
    image, least, product = borrowed((image, least, product))
    _, ny, nx = least.shape
    for k in range(begin, end):
        for j in range(ny):
            row = row_of(sight, j, first_plane + k)
            for i in range(nx):
                if least[k, j, i] <= F(0):
                    continue
                c, r = image_of(sight, row, i)
                inside = (c >= -0.5) & (c <= sight.columns - 0.5) & (r >= -0.5) & (r <= sight.rows - 0.5)
                light = max(shadow_sum(sight, image, c, r), F(0)) if inside else F(0)
                least[k, j, i] = min(least[k, j, i], light)
                product[k, j, i] *= light
