"""Kernels for pinhole cameras: each voxel's square footprint on the pixels of a camera, forward and back.

A voxel's light is spread evenly over a square about the image of its centre, ``half`` its side to each side. Its weight
in a pixel is the part of the square that the pixel covers, the product of two lengths; a voxel's weights sum to 1.
Where a voxel is imaged is computed in double precision: along columns of thousands of pixels single precision would
move footprints by 1e-4 px.

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
Vector = tuple[float, float, float]


class PinholeConstants(NamedTuple):
    """The constants of a pinhole camera and a grid, as kernels take them.

    In the camera's frame (right, up, forward), mm: ``first``, the centre of voxel (0, 0, 0), and the steps ``along_x``,
    ``along_y``, ``along_z`` from voxel to voxel. ``focal``, ``column0``, ``row0``: focal length and principal point,
    px. ``k1``, ``k2``: radial distortion. ``half_column``, ``half_row``: half the side of a voxel's footprint, px.
    ``columns``, ``rows`` of the sensor.
    """

    first: Vector
    along_x: Vector
    along_y: Vector
    along_z: Vector
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
def first_of_row(cam: PinholeConstants, j: int, k: int) -> Vector:
    """The centre of the first voxel of row j in plane k, in the camera's frame."""
    a, y, z = cam.first, cam.along_y, cam.along_z
    return a[0] + j * y[0] + k * z[0], a[1] + j * y[1] + k * z[1], a[2] + j * y[2] + k * z[2]


@inlined
def image_of(cam: PinholeConstants, row: Vector, i: int) -> tuple[float, float]:
    """(column, row) of the image of voxel i of a row; ``row``: ``first_of_row``."""
    step = cam.along_x
    nearness = 1.0 / (row[2] + i * step[2])
    a, b = (row[0] + i * step[0]) * nearness, (row[1] + i * step[1]) * nearness
    squared = a * a + b * b
    stretch = cam.focal * (1.0 + squared * (cam.k1 + squared * cam.k2))
    return cam.column0 + stretch * a, cam.row0 - stretch * b


@inlined
def weight_along(pixel: int, middle: float, half: float) -> np.float32:
    """Part of a footprint about ``middle`` that a pixel covers, along one axis."""
    covered = min(pixel + 0.5, middle + half) - max(pixel - 0.5, middle - half)
    return F(max(covered, 0.0) / (2.0 * half))


@inlined
def footprint_sum(cam: PinholeConstants, image: NDArray[np.float32], column: float, row: float) -> np.float32:
    """Sum of ``image`` (pixel,) over the footprint about (column, row) by its weights."""
    total = F(0)
    last_column = min(floor(column + cam.half_column + 0.5), cam.columns - 1)
    last_row = min(floor(row + cam.half_row + 0.5), cam.rows - 1)
    first_column = max(floor(column - cam.half_column + 0.5), 0)
    for r in range(max(floor(row - cam.half_row + 0.5), 0), last_row + 1):
        along = F(0)
        for c in range(first_column, last_column + 1):
            along += weight_along(c, column, cam.half_column) * image[r * cam.columns + c]
        total += weight_along(r, row, cam.half_row) * along
    return total


@inlined
def add_footprint(
    cam: PinholeConstants, image: NDArray[np.float32], column: float, row: float, light: np.float32
) -> None:
    """Add ``light`` to ``image`` (pixel,) over the footprint about (column, row): the transpose of
    ``footprint_sum``."""
    last_column = min(floor(column + cam.half_column + 0.5), cam.columns - 1)
    last_row = min(floor(row + cam.half_row + 0.5), cam.rows - 1)
    first_column = max(floor(column - cam.half_column + 0.5), 0)
    for r in range(max(floor(row - cam.half_row + 0.5), 0), last_row + 1):
        of_row = weight_along(r, row, cam.half_row) * light
        for c in range(first_column, last_column + 1):
            image[r * cam.columns + c] += weight_along(c, column, cam.half_column) * of_row


@kernel
def project(
    begin: int,
    end: int,
    cam: PinholeConstants,
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
            row = first_of_row(cam, of % ny, of // ny)
            for v in range(row_start[of], row_start[of + 1]):
                c, r = image_of(cam, row, np.int64(column[v]))
                add_footprint(cam, image, c, r, values[v])


@kernel
def gather(
    begin: int,
    end: int,
    cam: PinholeConstants,
    ny: int,
    chunks: NDArray[np.int64],
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    image: NDArray[np.float32],
    multiply: bool,
    out: NDArray[np.float32],
) -> None:
    """Add, for each listed voxel of the chunks, the sum of ``image`` over its footprint to ``out`` (voxel,). With
    ``multiply`` that sum is of one camera's corrections, and ``out`` is multiplied by ``factor_of`` it."""
    row_start, column, image, out = borrowed((row_start, column, image, out))
    for of in range(chunks[begin], chunks[end]):
        row = first_of_row(cam, of % ny, of // ny)
        for v in range(row_start[of], row_start[of + 1]):
            c, r = image_of(cam, row, np.int64(column[v]))
            total = footprint_sum(cam, image, c, r)
            out[v] = out[v] * factor_of(total, 1) if multiply else out[v] + total


@kernel
def least_along_lines_of_sight(
    begin: int,
    end: int,
    cam: PinholeConstants,
    first_plane: int,
    image: NDArray[np.float32],
    least: NDArray[np.float32],
    product: NDArray[np.float64],
) -> None:
    """Planes ``begin`` to ``end`` of a slab (z, y, x) that starts at ``first_plane``: lower ``least`` to the light of
    ``image`` in each voxel's footprint, multiply ``product`` by it; both become 0 where the camera does not see the
    voxel."""
    image, least, product = borrowed((image, least, product))
    _, ny, nx = least.shape
    for k in range(begin, end):
        for j in range(ny):
            row = first_of_row(cam, j, first_plane + k)
            for i in range(nx):
                if least[k, j, i] <= F(0):
                    continue
                c, r = image_of(cam, row, i)
                inside = (c >= -0.5) & (c <= cam.columns - 0.5) & (r >= -0.5) & (r <= cam.rows - 0.5)
                light = max(footprint_sum(cam, image, c, r), F(0)) if inside else F(0)
                least[k, j, i] = min(least[k, j, i], light)
                product[k, j, i] *= light
