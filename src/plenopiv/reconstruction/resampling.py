"""Voxels of lens space for a grid of the laboratory, and a volume's light from these to that, plane by plane.

The light of each listed voxel is shared among the 8 laboratory voxels about the image of its centre by the weights of a
linear interpolation, which keep light and centre. Along a row of voxels the map is a polynomial in x alone, so that
images are exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.space_map import Polynomial, SpaceMap, powers
from plenopiv.kernels import kernel
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume, VoxelGrid

TOGETHER = 16  # planes of the laboratory held at once


def lens_grid(space: SpaceMap, grid: VoxelGrid) -> VoxelGrid:
    """Voxels of lens space that give light to those of ``grid``, in the laboratory: of the size that these have there
    in the middle of the volume, and one more on each side."""
    limits = grid.limits_mm()
    middle = [0.5 * (lo + hi) for lo, hi in limits]
    sides = np.linalg.norm(space.to_lens.jacobian(middle) * grid.voxel_mm, axis=1)
    x, y, z = ((lo - side, hi + side) for (lo, hi), side in zip(space.lens_limits(limits), sides.tolist(), strict=True))
    return VoxelGrid.covering(x, y, z, tuple(sides.tolist()))


def resampled(volume: SparseVolume, to_grid: Polynomial, grid: VoxelGrid) -> SparseVolume:
    """``volume`` on another ``grid``; ``to_grid`` carries positions in mm from the space of the volume to that of the
    grid. Intensities are sums of light: where voxels of the grid are larger, they hold more. What lies outside the grid
    is left out, and so are voxels without light. The same bits on any number of threads."""
    nz, ny, nx = grid.shape
    rows = _Rows(volume.grid, to_grid, grid)
    counts, columns, values = [np.zeros(1, np.int64)], [], []
    planes = np.empty((min(TOGETHER, nz), ny, nx), np.float32)
    arguments = (rows.coefficients, rows.y, rows.x0, rows.dx, rows.low, rows.high)
    for first in range(0, nz, TOGETHER):
        part = planes[: min(TOGETHER, nz - first)]
        listed = np.empty(len(part) * ny, np.int64)
        in_threads(_spread, len(part), first, part, listed, volume.row_start, volume.column, volume.values, *arguments)
        start = np.concatenate([[0], np.cumsum(listed)])
        column, value = np.empty(start[-1], np.uint16), np.empty(start[-1], np.float32)
        in_threads(_list, listed.size, part.reshape(-1, nx), start, column, value)
        counts.append(listed)
        columns.append(column)
        values.append(value)
    row_start = np.cumsum(np.concatenate(counts))
    return SparseVolume(grid, row_start, np.concatenate(columns), np.concatenate(values))


class _Rows:
    """The map along each row of voxels of ``source``, in voxels of ``grid`` from its first one.

    ``coefficients`` (nz, 3, px, py): of plane k, coordinate a, and powers of x and y, these in the polynomial's own
    units: ``y`` (ny,), and ``x0 + dx * column``. ``low``, ``high`` (nz, ny): bounds of z on each row.
    """

    def __init__(self, source: VoxelGrid, to_grid: Polynomial, grid: VoxelGrid) -> None:
        order = to_grid.degree + 1
        found = np.zeros((3, order, order, order))  # a, x, y, z
        for (px, py, pz), terms in zip(powers(to_grid.degree), to_grid.coefficients, strict=True):
            found[:, px, py, pz] = terms
        found[:, 0, 0, 0] -= grid.first_mm
        found /= np.reshape(grid.voxel_mm, (3, 1, 1, 1))
        axes = zip(source.axes(), to_grid.centre_mm, to_grid.half_mm, strict=True)
        x, y, z = ((axis - centre) / half for axis, centre, half in axes)
        self.coefficients = np.einsum("axyp,pk->kaxy", found, z ** np.arange(order)[:, None])
        self.y, self.x0, self.dx = y, float(x[0]), source.voxel_mm[0] / to_grid.half_mm[0]
        along = np.einsum("kxp,pj->kjx", self.coefficients[:, 2], y ** np.arange(order)[:, None])
        most = np.abs(along[..., 1:]) @ np.abs(x).max() ** np.arange(1, order)
        self.low, self.high = along[..., 0] - most, along[..., 0] + most


@kernel
def _spread(
    begin: int,
    end: int,
    first: int,
    planes: NDArray[np.float32],
    listed: NDArray[np.int64],
    row_start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
    coefficients: NDArray[np.float64],
    y: NDArray[np.float64],
    x0: float,
    dx: float,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """Fill planes ``first + begin`` to ``first + end`` of the laboratory, and count the voxels with light of each of
    their rows."""
    _, ny, nx = planes.shape
    nz, rows, order = coefficients.shape[0], y.size, coefficients.shape[2]
    along = np.empty((3, order))
    for number in range(begin, end):
        plane, at = planes[number], first + number
        plane[:] = np.float32(0.0)
        for k in range(nz):
            for j in range(rows):
                r = k * rows + j
                if row_start[r] == row_start[r + 1] or high[k, j] <= at - 1 or low[k, j] >= at + 1:
                    continue
                for a in range(3):
                    for p in range(order):
                        total = 0.0
                        for q in range(order - 1 - p, -1, -1):
                            total = total * y[j] + coefficients[k, a, p, q]
                        along[a, p] = total
                for v in range(row_start[r], row_start[r + 1]):
                    x = x0 + dx * column[v]
                    fz = along[2, order - 1]
                    for p in range(order - 2, -1, -1):
                        fz = fz * x + along[2, p]
                    share = (1.0 - abs(fz - at)) * values[v]
                    if share <= 0.0:
                        continue
                    fx, fy = along[0, order - 1], along[1, order - 1]
                    for p in range(order - 2, -1, -1):
                        fx, fy = fx * x + along[0, p], fy * x + along[1, p]
                    ix, iy = int(np.floor(fx)), int(np.floor(fy))
                    for n in range(max(iy, 0), min(iy + 2, ny)):
                        in_row = share * (1.0 - abs(fy - n))
                        for m in range(max(ix, 0), min(ix + 2, nx)):
                            plane[n, m] += np.float32(in_row * (1.0 - abs(fx - m)))
        for n in range(ny):
            count = 0
            for m in range(nx):
                count += plane[n, m] > np.float32(0.0)
            listed[number * ny + n] = count


@kernel
def _list(
    begin: int,
    end: int,
    rows: NDArray[np.float32],
    start: NDArray[np.int64],
    column: NDArray[np.uint16],
    values: NDArray[np.float32],
) -> None:
    """List the voxels with light of rows ``begin`` to ``end``, each from ``start`` on."""
    for row in range(begin, end):
        to = start[row]
        for m in range(rows.shape[1]):
            if rows[row, m] > np.float32(0.0):
                column[to], values[to] = np.uint16(m), rows[row, m]
                to += 1
