"""Resolution against depth: how far a point moves before another pixel sees it, along x, y and z.

Source: Shi, Ding & New (2016), section 2. At a depth z the boundaries of light columns are at y = (t_n - A v_k)/B, for
the edges t_n of microlenses and v_k of portions, and a block is a gap between two of them. With gaps g in one pitch
p/|B|,

    mean free shift = sum g^2 / (2 sum g)       largest free shift = max g.

The first is the mean, over all places where a particle may be, of its distance to the next boundary: a long gap holds
more places than a short one. The plain mean of the gaps would be p/|B| over their number, about one pixel's width at
every depth and for every PMR: it does not show that boundaries bunch near focus and come close to one another at some
depths.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.design.blocks import Blocks
from plenopiv.design.light_columns import fan_mm, free_shift_mm, portion_edges_mm, square_and_aligned
from plenopiv.lattice import Lattice

Array = NDArray[np.float64]

SAME = 1e-9  # of a pitch: boundaries that fall on one another


class FreeShift(NamedTuple):
    """Mean and largest free shift in mm, each (n,) for n depths."""

    mean_mm: Array
    largest_mm: Array


class BlockSizes(NamedTuple):
    """Size of the block in which a point of a zone lies, in the mean over the zone's area."""

    area_mm2: float
    across_mm: float
    up_mm: float


def gaps_mm(camera: PlenopticCamera, z_mm: float) -> Array:
    """Gaps between boundaries over one pitch p/|B| at a depth, (n,) mm: their sum is the pitch, n <= PMR + 1."""
    pitch = square_and_aligned(camera).pitch_mm
    at = np.sort(np.mod(-float(camera.spread(z_mm)) * portion_edges_mm(camera) / pitch, 1.0))
    gaps = np.diff(np.append(at, at[0] + 1.0))
    return gaps[gaps > SAME] * pitch / abs(float(camera.scale(z_mm)))


def resolution_y(camera: PlenopticCamera, z_mm: ArrayLike) -> FreeShift:
    """Free shift along y at depths ``z_mm`` (n,), in closed form.

    Raises:
        PlenoPIVError: the lattice is not square with rows along x or y (``mean_free_shift`` takes any).
    """
    gaps = [gaps_mm(camera, z) for z in np.atleast_1d(np.asarray(z_mm, np.float64))]
    mean = [0.5 * (g**2).sum() / g.sum() for g in gaps]
    return FreeShift(np.array(mean), np.array([g.max() for g in gaps]))


def resolution_x(camera: PlenopticCamera, z_mm: ArrayLike) -> FreeShift:
    """Free shift along x: that along y, since cells and aperture are the same along both. See ``resolution_y``."""
    return resolution_y(camera, z_mm)


def resolution_z(camera: PlenopticCamera, z_mm: ArrayLike, places: int = 1000) -> FreeShift:
    """Free shift along z at depths ``z_mm`` (n,) for light in the y-z plane, as the paper has it.

    Each shift is exact; means are over ``places`` evenly spaced positions in one pitch. Errors as ``resolution_y``.
    """
    lattice = square_and_aligned(camera)
    t = lattice.offset_mm[1] + (np.arange(places) + 0.5) / places * lattice.pitch_mm
    image = np.stack([np.full(places, lattice.offset_mm[0]), t], 1)
    return mean_free_shift(camera, z_mm, (0.0, 0.0, 1.0), fan_mm(camera), image)


def mean_free_shift(
    camera: PlenopticCamera,
    z_mm: ArrayLike,
    direction: ArrayLike,
    rays_mm: ArrayLike,
    image_mm: ArrayLike | None = None,
) -> FreeShift:
    """Free shift along +- ``direction`` (3,) at depths ``z_mm`` (n,), for any lattice and rays.

    ``rays_mm`` (rays, 2): see ``codes``. The mean is over both senses and over points whose images through the main
    lens' centre are ``image_mm`` (m, 2) on the microlens plane, by default ``places_mm`` of a cell; the largest is the
    longest path through a block.
    """
    e = np.asarray(direction, np.float64)
    image = places_mm(camera.lattice) if image_mm is None else np.asarray(image_mm, np.float64)
    mean, largest = [], []
    for z in np.atleast_1d(np.asarray(z_mm, np.float64)):
        points = np.column_stack([image / float(camera.scale(z)), np.full(len(image), z)])
        length = free_shift_mm(camera, points, e, rays_mm) + free_shift_mm(camera, points, -e, rays_mm)
        mean.append(0.5 * length.mean())
        largest.append(length.max())
    return FreeShift(np.array(mean), np.array(largest))


def places_mm(lattice: Lattice, n: int = 24) -> Array:
    """Positions (n^2, 2) in mm on the microlens plane that sample one cell of the lattice evenly."""
    along, across = ((g.ravel() + 0.5) / n * lattice.pitch_mm for g in np.mgrid[:n, :n])
    if lattice.kind == "hexagonal":  # from one row to the next and half a pitch on
        along, across = along + 0.5 * across, lattice.row_spacing * across
    c, s = cos(lattice.rotation_rad), sin(lattice.rotation_rad)
    return np.stack([c * along - s * across, s * along + c * across], 1) + lattice.offset_mm


def block_sizes(found: Blocks, zone: NDArray[np.bool_]) -> BlockSizes:
    """Means over the raster cells of ``zone`` (as ``found.label``) of their blocks' sizes: area-weighted by that.

    Blocks that do not close count with what is known of them.
    """
    inside = found.label[zone]
    across, up = found.extent_mm[inside].mean(0)
    return BlockSizes(float(found.area_mm2[inside].mean()), float(across), float(up))
