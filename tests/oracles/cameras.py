"""Small cameras and the projector's image of one voxel: what the tests of the light's path share."""

from __future__ import annotations

import numpy as np

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.lightfield import Layout
from plenopiv.optics import conjugate_distances
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.sensor import Sensor
from plenopiv.volume import SparseVolume, VoxelGrid

PIXEL_MM = 0.0055
VOXEL_MM = 0.0385


def small_camera(
    kind="square",
    *,
    pmr=14.0,
    microlenses=(13, 11),
    magnification=-1.0,
    rotation_rad=0.0,
    offset_mm=(0.0, 0.0),
    aperture=1.0,
    black_level=0.0,
) -> PlenopticCamera:
    """The paper's optics (f_m 50 mm, f_l 0.308 mm, 5.5 um pixels) on a small sensor; ``aperture`` in matched
    apertures."""
    pitch = pmr * PIXEL_MM
    image_distance = conjugate_distances(50.0, magnification)[1]
    columns, rows = (round(n * pmr) for n in microlenses)
    return PlenopticCamera(
        MainLens(50.0, aperture * image_distance * pitch / 0.308, magnification),
        Lattice(kind, pitch, rotation_rad, offset_mm),
        0.308,
        Sensor(columns, rows, PIXEL_MM, 12, black_level),
    )


def single_voxel(point_mm, voxel_mm=VOXEL_MM) -> tuple[VoxelGrid, SparseVolume]:
    """A grid of one voxel centred on a point, and the volume in which it holds all of the light of a particle of 1."""
    grid = VoxelGrid(tuple(map(float, point_mm)), (voxel_mm,) * 3, (1, 1, 1))
    return grid, SparseVolume.from_mask(grid, np.ones(grid.shape, bool))


def projected_point(where: Layout, point_mm, weights="polygons", voxel_mm=VOXEL_MM, **options) -> np.ndarray:
    """The projector's light (view, lens) of a point at a voxel's centre, float64."""
    grid, volume = single_voxel(point_mm, voxel_mm)
    projector = PlenopticProjector(where, grid, weights, **options)
    return np.array([projector.forward(view, volume) for view in range(projector.views)], float)
