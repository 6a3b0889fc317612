"""What the figures show, cut out of images and volumes so that those need not be kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.volume import Volume

LENSES_ACROSS = 9
PLANES_AT_ONCE = 8


@dataclass(frozen=True)
class RawCrop:
    """Part of an upright raw image, with the circles that micro-images should fill.

    ``counts`` (rows, columns); ``corner`` the (column, row) of its first pixel; ``centres_px`` (n, 2) columns and rows
    of micro-image centres in the whole image; ``radius_px`` of the micro-images.
    """

    name: str
    counts: NDArray[np.uint16]
    corner: tuple[int, int]
    centres_px: NDArray[np.float64]
    radius_px: float


def raw_crops(image: NDArray[np.uint16], camera: PlenopticCamera, name: str) -> list[RawCrop]:
    """The middle and the lower right corner of an upright image (rows, columns): a wrong pitch shows at the corner."""
    rows, columns = image.shape
    side = min(round(LENSES_ACROSS * camera.image_pitch_px), rows, columns)
    places = {"middle": ((columns - side) // 2, (rows - side) // 2), "corner": (columns - side, rows - side)}
    return [
        RawCrop(
            f"{name}, {where}",
            image[row : row + side, column : column + side].copy(),
            (column, row),
            _centres_within(camera, column, row, side),
            camera.aperture_radius_px,
        )
        for where, (column, row) in places.items()
    ]


def _centres_within(camera: PlenopticCamera, column: int, row: int, side: int) -> NDArray[np.float64]:
    """Micro-image centres (column, row) in a square of the image."""
    magnified = 1.0 + camera.image_scale
    s, t = camera.sensor.plane_from_pixel(column + side / 2, row + side / 2)
    i0, j0 = (int(n) for n in camera.lattice.nearest(s / magnified, t / magnified))
    around = np.arange(-LENSES_ACROSS - 2, LENSES_ACROSS + 3)
    i, j = np.meshgrid(i0 + around, j0 + around)
    s, t = camera.lattice.centres(i, j)
    columns, rows = camera.sensor.pixel_from_plane(s * magnified, t * magnified)
    inside = (abs(columns - column - (side - 1) / 2) < side / 2) & (abs(rows - row - (side - 1) / 2) < side / 2)
    return np.stack([columns[inside], rows[inside]], -1)


@dataclass(frozen=True)
class Projections:
    """Brightest voxel along z, ``xy`` (ny, nx), and along y, ``xz`` (nz, nx); ``limits_mm`` of the volume's faces."""

    xy: NDArray[np.float32]
    xz: NDArray[np.float32]
    limits_mm: tuple[tuple[float, float], ...]


def projections(volume: Volume) -> Projections:
    """Maximum projections of a volume, read a few planes at a time."""
    nz, ny, nx = volume.grid.shape
    xy, xz = np.zeros((ny, nx), np.float32), np.zeros((nz, nx), np.float32)
    for lo in range(0, nz, PLANES_AT_ONCE):
        slab = volume.slab(lo, min(lo + PLANES_AT_ONCE, nz))
        np.maximum(xy, slab.max(axis=0), out=xy)
        xz[lo : lo + slab.shape[0]] = slab.max(axis=1)
    return Projections(xy, xz, volume.grid.limits_mm())
