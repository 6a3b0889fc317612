"""Weights where the main lens blurs: those of ``pixel_weights``, tabulated plane by plane, and convolved.

A main lens that is not sharp displaces a ray on the microlens plane by a random (ds, dt), its direction kept: a
Gaussian here, of standard deviation ``blur_mm`` along each axis. The ray lies under the microlens S where A q + B x - S
+ (ds, dt) is in its cell. In cells the place of a voxel relative to a footprint's centre is so displaced by (ds, dt) /
pitch, in every plane by the same standard deviation (``CameraConstants.blur``), and the weight is the exact area
convolved with that Gaussian. It is smooth, so that a table of POINTS x POINTS places holds it.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import inlined, kernel
from plenopiv.projection.plenoptic.geometry import CameraConstants, CameraOnGrid, column_of
from plenopiv.projection.plenoptic.pixel_weights import CUT, EXACT, area_of, plane_of, reach_of
from plenopiv.threads import in_threads

POINTS = 64  # across a footprint: less than half the standard deviation of its edge apart, from .05 cells of blur on
F = np.float32


def blurred(camera: CameraOnGrid) -> NDArray[np.float32]:
    """``tables_of`` a camera's planes, kept with the camera."""
    if camera.blurred is None:
        camera.blurred = tables_of(camera.cam, camera.planes)
    return camera.blurred


def tables_of(cam: CameraConstants, planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weights of a voxel in a pixel of each of ``planes`` (``geometry.planes``), float32 (nz, POINTS, POINTS): row
    by row at places across the lattice's rows, column by column along them, from -``reach_of`` to +``reach_of``; (nz,
    0, 0) where nothing blurs."""
    if not cam.blur > 0:
        return np.zeros((len(planes), 0, 0), np.float32)
    from scipy.ndimage import gaussian_filter1d

    reach = np.array([reach_of.py_func(cam, plane_of.py_func(planes, k), EXACT) for k in range(len(planes))])
    steps = (2 / (POINTS - 1) * reach).astype(np.float32)
    tables = sharp_tables(cam, planes, steps, POINTS)
    halves = column_of(planes, "half").tolist()
    for table, size, half in zip(tables, steps.tolist(), halves, strict=True):
        total = table.sum(dtype=np.float64)
        for axis, step in ((1, size[0]), (0, size[1])):  # less what averaging over a step has blurred already
            sigma = sqrt(max((float(cam.blur) / step) ** 2 - (1 / 12 if half < step / 2 else 0.0), 0.0))
            if sigma > 0:
                table[:] = gaussian_filter1d(table, sigma, axis=axis, mode="constant", truncate=CUT + 1)
        table *= total / table.sum(dtype=np.float64)  # the Gaussian's tails beyond the table
    return tables


def sharp_tables(
    cam: CameraConstants, planes: NDArray[np.float32], steps: NDArray[np.float32], points: int
) -> NDArray[np.float32]:
    """The weights without blur of a voxel in a pixel of each of ``planes``, (nz, points, points), at places ``steps``
    (nz, 2) apart, cells along and across the rows, about the footprint's centre; averaged over a step where a pixel's
    square is smaller than that."""
    tables = np.empty((len(planes), points, points), np.float32)
    in_threads(fill_sharp_tables, len(planes), cam, planes, steps, tables)
    return tables


@kernel
def fill_sharp_tables(
    begin: int,
    end: int,
    cam: CameraConstants,
    planes: NDArray[np.float32],
    steps: NDArray[np.float32],
    tables: NDArray[np.float32],
) -> None:
    """``sharp_tables`` of planes ``begin`` to ``end``."""
    points = tables.shape[1]
    middle = F(0.5) * F(points - 1)
    for k in range(begin, end):
        plane, step_x, step_y = plane_of(planes, k), steps[k, 0], steps[k, 1]
        half_x, half_y = max(plane.half, F(0.5) * step_x), max(plane.half, F(0.5) * step_y)
        for j in range(points):
            for i in range(points):
                area = area_of(cam, (F(i) - middle) * step_x, (F(j) - middle) * step_y, half_x, half_y)
                tables[k, j, i] = area * F(0.25) / (half_x * half_y)


@inlined
def table_weight(
    table: NDArray[np.float32], wide: np.float32, high: np.float32, x: np.float32, y: np.float32
) -> np.float32:
    """The weight of a voxel (x, y) cells from a footprint's centre, read from the plane's ``table`` by linear
    interpolation; 0 beyond it. ``wide`` and ``high``: ``reach_of`` the plane."""
    last = F(POINTS - 1)
    at_x, at_y = (x / wide + F(1)) * (F(0.5) * last), (y / high + F(1)) * (F(0.5) * last)
    inside = (at_x >= F(0)) & (at_x < last) & (at_y >= F(0)) & (at_y < last)
    at_x, at_y = at_x if inside else F(0), at_y if inside else F(0)
    i, j = np.int64(at_x), np.int64(at_y)
    along, across = at_x - F(i), at_y - F(j)
    upper = table[j, i] + along * (table[j, i + 1] - table[j, i])
    lower = table[j + 1, i] + along * (table[j + 1, i + 1] - table[j + 1, i])
    return upper + across * (lower - upper) if inside else F(0)
