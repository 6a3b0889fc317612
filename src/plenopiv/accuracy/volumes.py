"""How like the truth a reconstructed volume is, and where it puts a particle."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from plenopiv.errors import PlenoPIVError
from plenopiv.volume import SAME, DenseVolume, Volume, VoxelGrid

PLANES = 16  # of a volume that are dense in memory at a time
REACH = 4.0  # standard deviations of a particle's Gaussian


def reconstruction_quality(reconstructed: Volume, exact: Volume) -> float:
    """Q = sum(E1 E0) / sqrt(sum(E1^2) sum(E0^2)), between 0 and 1; 1 where one volume is a multiple of the other.

    The normalised correlation coefficient of Elsinga et al. (2006, Exp. Fluids 41:933-947, section 3), without means
    taken off. E1 is the reconstructed intensity, E0 the exact one (``exact_volume``). Q depends on how large E0 makes a
    particle: numbers compare only where E0 was made alike. NaN where a volume is empty.

    Raises:
        PlenoPIVError: the volumes have different grids.
    """
    if not reconstructed.grid.agrees_with(exact.grid):
        raise PlenoPIVError(
            f"accuracy: volumes of {reconstructed.grid!r} and {exact.grid!r} cannot be compared; make both on one grid"
        )
    product = squares_1 = squares_0 = 0.0
    for lo in range(0, exact.grid.shape[0], PLANES):
        hi = min(lo + PLANES, exact.grid.shape[0])
        e1 = reconstructed.slab(lo, hi).astype(np.float64)
        e0 = exact.slab(lo, hi).astype(np.float64)
        product += float(np.vdot(e1, e0))
        squares_1 += float(np.vdot(e1, e1))
        squares_0 += float(np.vdot(e0, e0))
    return product / sqrt(squares_1 * squares_0) if squares_1 * squares_0 > 0 else float("nan")


def exact_volume(
    position_mm: ArrayLike, light: ArrayLike, grid: VoxelGrid, diameter_voxels: float | tuple[float, float, float] = 3.0
) -> DenseVolume:
    """E0: every particle a Gaussian of e^-2 diameter ``diameter_voxels`` (4 standard deviations) along each axis, or
    of one for each of x, y and z.

    ``position_mm`` (n, 3) as x, y, z; ``light`` (n,) or one number, the sum over a particle's voxels. The Gaussian is
    integrated over each voxel and cut at 4 standard deviations. It is as wide along z as in the plane *in voxels*: with
    voxels longer in depth, the exact particle is longer in depth too. Three voxels are Elsinga's particle.
    """
    nz, ny, nx = grid.shape
    sigmas = np.broadcast_to(np.asarray(diameter_voxels, np.float64) / 4.0, 3)
    index = (np.asarray(position_mm, np.float64) - grid.first_mm) / grid.voxel_mm
    light = np.broadcast_to(np.asarray(light, np.float64), index.shape[:1])
    values = np.zeros(grid.shape, np.float32)
    for place, brightness in zip(index, light, strict=True):
        spans, shares = [], []
        for centre, sigma, n in zip(place[::-1], sigmas[::-1], (nz, ny, nx), strict=True):
            lo = max(int(np.ceil(centre - REACH * sigma - 0.5)), 0)
            hi = min(int(np.floor(centre + REACH * sigma + 0.5)) + 1, n)
            faces = np.arange(lo, max(hi, lo) + 1) - 0.5 - centre
            spans.append(slice(lo, max(hi, lo)))
            shares.append(np.diff(0.5 * erf(faces / (sigma * sqrt(2.0)))))
        z, y, x = shares
        values[tuple(spans)] += (brightness * z[:, None, None] * y[:, None] * x).astype(np.float32)
    return DenseVolume(grid, values)


def ghost_light(reconstructed: Volume, position_mm: ArrayLike, reach_voxels: float = 3.0) -> float:
    """Share of the light that is further than ``reach_voxels`` from every particle at ``position_mm`` (n, 3), 0 to 1.

    Light where several lines of sight cross without a particle is called a ghost (Elsinga et al. 2006, section 3); what
    is counted here is its intensity, not the number of its peaks. Distances are in voxels, from the particle to the
    voxels' centres; the default is one particle of three voxels away. NaN where the volume is empty.
    """
    near = near_particles(reconstructed.grid, position_mm, reach_voxels)
    total = ghosts = 0.0
    for lo in range(0, len(near), PLANES):
        values = reconstructed.slab(lo, min(lo + PLANES, len(near))).astype(np.float64)
        total += float(values.sum())
        ghosts += float(values[~near[lo : lo + PLANES]].sum())
    return ghosts / total if total > 0 else float("nan")


def near_particles(grid: VoxelGrid, position_mm: ArrayLike, reach_voxels: float = 3.0) -> NDArray[np.bool_]:
    """Voxels (nz, ny, nx) whose centre is within ``reach_voxels`` of a particle at ``position_mm`` (n, 3)."""
    shape = np.array(grid.shape)
    index = ((np.asarray(position_mm, np.float64) - grid.first_mm) / grid.voxel_mm)[:, ::-1]
    near = np.zeros(grid.shape, bool)
    reach = int(np.ceil(reach_voxels + 0.5))
    for offset in np.ndindex(*[2 * reach + 1] * 3):
        voxel = np.rint(index).astype(np.int64) + offset - reach
        close = ((voxel - index) ** 2).sum(1) <= reach_voxels**2
        inside = close & (voxel >= 0).all(1) & (voxel < shape).all(1)
        near[tuple(voxel[inside].T)] = True
    return near


def intensity_centre_mm(
    volume: Volume, near_mm: tuple[float, float, float], reach_mm: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Intensity-weighted centre (x, y, z) in mm of the voxels whose centres are within ``reach_mm`` of ``near_mm``
    along each axis, those at both ends included.

    NaN where they are empty. The paper's Fig. 9a compares this centre with the particle's.
    """
    spans = []
    for axis, side, near, reach in zip(volume.grid.axes(), volume.grid.voxel_mm, near_mm, reach_mm, strict=True):
        far = reach + SAME * side  # a voxel at either end counts, whichever way its place is rounded
        spans.append(slice(*np.searchsorted(axis, [near - far, near + far])))
    x, y, z = (axis[span] for axis, span in zip(volume.grid.axes(), spans, strict=True))
    box = volume.slab(spans[2].start, spans[2].stop)[:, spans[1], spans[0]].astype(np.float64)
    total = box.sum()
    if not total > 0:
        return np.full(3, np.nan)
    along_z, along_y, along_x = box.sum((1, 2)), box.sum((0, 2)), box.sum((0, 1))
    return np.array([x @ along_x, y @ along_y, z @ along_z]) / total
