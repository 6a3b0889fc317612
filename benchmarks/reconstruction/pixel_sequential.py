"""The paper's MART word for word: weights stored in a matrix, and one pixel corrected after the other.

Only for small cases: the matrix takes some 2 kB a voxel. Its entries are probed from the projector itself, so that any
difference to the view-sequential variants lies in the order of things and not in the weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from variants import Array, Order, of_round, random_order

from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import SparseVolume

APART = 3  # a voxel lights no two microlenses of a view that are so many apart along a row, or across rows


def shares(
    projector: PlenopticProjector, volume: SparseVolume, views: NDArray[np.int64] | None = None
) -> list[sparse.csc_array]:
    """For every view, or each of ``views``, the matrix (voxel, lens) of the share of its pixel that a voxel lights.

    Lenses are probed one of every APART x APART at a time: the pixel that answers is told by how much, once it is lit
    by 1 and once by its number.
    """
    where = projector.layout
    number = np.arange(where.lenses, dtype=np.float32)
    colour = APART * ((number // where.ni) % APART) + (number % where.ni) % APART
    matrices = []
    for view in range(projector.views) if views is None else views:
        voxels, lenses, weights = [], [], []
        for c in range(APART**2):
            one = (colour == c).astype(np.float32)
            share = projector.gather(view, one, volume)
            voxel = np.flatnonzero(share)
            times = projector.gather(view, one * (number + 1), volume)[voxel]
            voxels.append(voxel)
            lenses.append(np.rint(times / share[voxel]).astype(np.int64) - 1)
            weights.append(share[voxel])
        entries = np.concatenate(weights), (np.concatenate(voxels), np.concatenate(lenses))
        matrices.append(sparse.csc_array(entries, shape=(volume.values.size, where.lenses), dtype=np.float32))
    return matrices


def light_of_a_pixel(projector: PlenopticProjector, volume: SparseVolume) -> Array:
    """For each listed voxel the share of its light that a wholly lit pixel collects, (portion/(1 - A))^2 / aperture's
    area."""
    camera, (nz, ny, _) = projector.layout.camera, projector.grid.shape
    a = camera.spread(projector.grid.axes()[2])
    plane = (camera.portion_mm / (1 - a)) ** 2 / (np.pi / 4 * camera.main_lens.aperture_mm**2)
    assert plane.size == nz
    return np.repeat(np.repeat(plane, ny), np.diff(volume.row_start)).astype(np.float32)


@njit
def correct_pixels(pixels, start, voxel, share, light, measured, floor, mu, values):
    """E_j <- E_j (I_i / P_i)^(mu w_ij), one pixel i after the other; ``start``, ``voxel``, ``share`` as in CSC."""
    for i in pixels:
        projected = 0.0
        for n in range(start[i], start[i + 1]):
            projected += share[n] * light[voxel[n]] * values[voxel[n]]
        logarithm = mu * np.log((max(measured[i], 0.0) + floor) / (projected + floor))
        for n in range(start[i], start[i + 1]):
            values[voxel[n]] *= np.exp(share[n] * logarithm)


def pixel_sequential(
    values: Array,
    projector: PlenopticProjector,
    volume: SparseVolume,
    *,
    relaxation: tuple[float, ...] = (0.3,),
    floor: float = 1.0,
    order: Order | None = None,
    shuffled: bool = False,
) -> Iterator[SparseVolume]:
    """One pixel after the other: view by view in the given order, or, ``shuffled``, all pixels in a random order."""
    order, rng = order or random_order(), np.random.default_rng(0)
    seen, lenses = projector.layout.seen, projector.layout.lenses
    matrix = sparse.hstack(shares(projector, volume), format="csc")
    light, light_field = light_of_a_pixel(projector, volume).astype(np.float64), values.ravel().astype(np.float64)
    intensity: NDArray[np.float64] = volume.values.astype(np.float64)
    for k in count():
        pixels = (order(projector, k)[:, None] * lenses + np.arange(lenses)).ravel()
        pixels = pixels[seen.ravel()[pixels]]
        if shuffled:
            pixels = rng.permutation(pixels)
        correct_pixels(
            pixels, matrix.indptr, matrix.indices, matrix.data, light, light_field, floor,
            of_round(relaxation, k), intensity,
        )  # fmt: skip
        yield volume.with_values(intensity.astype(np.float32))
