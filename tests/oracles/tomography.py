"""Pinhole cameras around a volume, and where a voxel's light goes: slow and obvious, without any kernel."""

from __future__ import annotations

import numpy as np

from plenopiv.cameras.pinhole import PinholeCamera, looking_at
from plenopiv.sensor import Sensor
from plenopiv.volume import VoxelGrid

SCALE_MM_PX = 0.074  # of the paper's cameras


def four_cameras(size=64, angle_deg=20.0, distance_mm=300.0, black_level=0.0) -> list[PinholeCamera]:
    """Cameras of size x size px at the corners of a square, turned by +-angle about y and about x."""
    return [
        looking_at(
            (0, 0, 0),
            Sensor(size, size, 0.0055, 16, black_level),
            scale_mm_px=SCALE_MM_PX,
            distance_mm=distance_mm,
            about_y_deg=y,
            about_x_deg=x,
        )
        for y in (-angle_deg, angle_deg)
        for x in (-angle_deg, angle_deg)
    ]


def cubes(nx, ny, nz, voxel_mm=(SCALE_MM_PX,) * 3) -> VoxelGrid:
    """A grid about the origin."""
    half = [0.5 * n * d for n, d in zip((nx, ny, nz), voxel_mm, strict=True)]
    return VoxelGrid.covering(*((-h, h) for h in half), voxel_mm)


def overlap(lo_a, hi_a, lo_b, hi_b):
    """Length that two intervals share."""
    return max(min(hi_a, hi_b) - max(lo_a, lo_b), 0.0)


def shadow_shares(camera: PinholeCamera, grid: VoxelGrid) -> np.ndarray:
    """Share of every voxel's light in every pixel, (pixel, voxel) float64, for the square that stands for its shadow.

    Pixel by pixel, where the square's sides come from the projected ends of the middle voxel's edges.
    """
    middle = np.array([0.5 * (lo + hi) for lo, hi in grid.limits_mm()])
    sides = np.zeros(2)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 0.5 * grid.voxel_mm[axis]
        sides += (camera.project(middle + step) - camera.project(middle - step)) ** 2
    half_c, half_r = 0.5 * np.sqrt(sides)
    x, y, z = grid.axes()
    rows, columns = camera.sensor.rows, camera.sensor.columns
    shares = np.zeros((rows * columns, grid.size))
    for n, (k, j, i) in enumerate(np.ndindex(grid.shape)):
        c, r = camera.project((x[i], y[j], z[k]))
        for row in range(rows):
            high = overlap(row - 0.5, row + 0.5, r - half_r, r + half_r)
            if high:
                for column in range(columns):
                    wide = overlap(column - 0.5, column + 0.5, c - half_c, c + half_c)
                    shares[row * columns + column, n] = wide * high / (4 * half_c * half_r)
    return shares
