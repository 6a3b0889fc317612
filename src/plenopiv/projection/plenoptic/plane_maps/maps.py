"""Plane maps: what a pixel would collect of a plane of voxels, wherever its footprint were centred.

In a plane every microlens has the same footprint, only elsewhere. So the listed voxels of a plane are first spread into
a map: each adds its value times its weight to the points around it, which stand for pixels whose footprints are centred
there. A view is then read off the map at the places where the footprints of its pixels are centred, between points by
linear interpolation (``reading``). Back, corrections are added to the map at those places, and each voxel sums the
points around it by the same weights. A voxel costs one small rectangle of products, however many microlenses it lights,
and a microlens four points, however wide its footprint is.

A map's points are a voxel apart, closer where a footprint is narrow or has a sharp edge, near focus, and wider far from
it, where its edge is a ramp. Here are the maps' sizes and the weights around a voxel.
"""

from __future__ import annotations

from math import ceil, floor, log2, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import kernel
from plenopiv.projection.plenoptic.blurred import table_weight
from plenopiv.projection.plenoptic.geometry import CameraConstants, column_of
from plenopiv.projection.plenoptic.pixel_weights import CUT, EXACT, area_of, box_of, plane_of, reach_of
from plenopiv.projection.plenoptic.plane_maps.simd import LANES
from plenopiv.threads import in_threads

ACROSS = 7.0  # points of a map across a footprint, at least; with 4, depth is worse by a quarter
BLURRED = 1.7  # times as many where the main lens blurs; with as many as else, depth is worse by a tenth at 20 um
SMOOTH = 9.0  # a step wider than a voxel is sqrt(width of a footprint * width of the ramp at its edge / SMOOTH)
PAIR_SHIFT = 0.05  # of a footprint's width: light moves less between the planes of a pair
MOST_ACROSS = 2 * ACROSS  # points across a footprint with a sharp edge, at most
SHARP = ((3, 1.0), (2, 2.5))  # points to a voxel where the ramp at the edge is shorter than so many voxels
MAX_RANK = 6  # outer products that make up a plane's weights, at most
RANK_TOLERANCE = 3e-4  # of the largest singular value: outer products below it are left out
F = np.float32

MapShape = tuple[int, int, int, int, int, int]  # of a plane, as in ``PlaneMaps.shape``
MapSize = tuple[int, int, np.float32]  # rows and columns of a map, points to a voxel


class PlaneMaps(NamedTuple):
    """The maps of all planes of a grid: their sizes and the weights of a voxel in the points around it.

    ``shape`` (nz, 6): rows and columns of the map; rows and columns of the rectangle of weights around a voxel; points
    to a voxel, 1 where several voxels come to a point; log2 of voxels to a point, 0 where several points come to a
    voxel. ``border`` (nz, 2): points before the first voxel, along x and y. ``weights``: the rectangles of all planes
    one after the other, one for each place of a voxel between points, of which there are voxels-to-a-point along y and
    along x. ``factors``: the same as sums of outer products (``outer_products``). ``start`` (nz, 2): where those of a
    plane begin in ``weights`` and in ``factors``. ``rank`` (nz,): number of a plane's outer products, 0 where it takes
    more than MAX_RANK.
    """

    shape: NDArray[np.int64]
    start: NDArray[np.int64]
    border: NDArray[np.int64]
    weights: NDArray[np.float32]
    rank: NDArray[np.int64]
    factors: NDArray[np.float32]


def plane_maps(
    cam: CameraConstants,
    table: NDArray[np.float32],
    blurred: NDArray[np.float32],
    grid_shape: tuple[int, int, int],
    across: float = ACROSS,
) -> PlaneMaps:
    """The maps of the planes of ``table`` (``geometry.planes``) of a camera ``cam``, with at least ``across`` points
    across a footprint. ``blurred``: ``blurred.tables_of`` the planes."""
    nz, ny, nx = grid_shape
    across *= BLURRED if cam.blur > 0 else 1.0
    shape, start, border = np.zeros((nz, 6), np.int64), np.zeros((nz, 2), np.int64), np.zeros((nz, 2), np.int64)
    reach = np.empty((nz, 5), np.float32)
    footprint_sizes(cam, table, reach)
    total = 0
    for k, (wide, high, ramp, half_x, half_y) in enumerate(reach.tolist()):
        narrow = 2 * min(half_x, half_y)
        step = sqrt(ramp * narrow / SMOOTH) * ACROSS / across  # voxels
        sharp = min(next((n for n, voxels in SHARP if ramp < voxels), 1), ceil(MOST_ACROSS / narrow))
        points = max(ceil(sharp * across / ACROSS), ceil(across / narrow))
        shift = max(0, floor(log2(step))) if points == 1 and step > 0 else 0
        right, down = (floor(points * half / 2**shift) for half in (wide, high))
        more = 2 if shift else 1
        rows, columns = 2 * down + more, LANES * ceil((2 * right + more) / LANES)
        border[k] = right + 2, down + 2
        last_row, last_column = ((points * (n - 1)) >> shift for n in (ny, nx))
        shape[k] = last_row + 2 * down + 6, last_column + columns + 6, rows, columns, points, shift
        start[k, 0] = total
        total += rows * columns * 4**shift
    weights = np.zeros(total, np.float32)
    if cam.blur > 0:
        in_threads(read_weights, len(table), cam, table, blurred, shape, start, border, weights)
    else:
        in_threads(tabulate_weights, len(table), cam, table, shape, start, border, weights)
    rank, factors = np.zeros(nz, np.int64), list[NDArray[np.float64]]()
    for k, (_, _, rows, columns, _, shift) in enumerate(shape):
        voxels = 1 << shift
        of_plane = weights[start[k, 0] :][: rows * columns * voxels**2].reshape(-1, rows, columns)
        of_plane[:] = sharpened(of_plane)
        start[k, 1] = sum(part.size for part in factors)
        found = outer_products(of_plane.reshape(voxels, voxels, rows, columns))
        rank[k] = len(found)
        factors.extend(found)
    return PlaneMaps(shape, start, border, weights, rank, np.concatenate([*factors, np.zeros(1)]).astype(np.float32))


def outer_products(weights: NDArray[np.float32]) -> list[NDArray[np.float64]]:
    """Weights (voxels, voxels, rows, columns) of one plane as a sum of outer products: of each its column for every
    voxel along y (voxels, rows), then its row for every voxel along x (voxels, columns), in one array; none where it
    takes more than MAX_RANK."""
    voxels, _, rows, columns = weights.shape
    matrix = weights.transpose(0, 2, 1, 3).reshape(voxels * rows, voxels * columns).astype(np.float64)
    down, strength, across = np.linalg.svd(matrix, full_matrices=False)
    count = int((strength > RANK_TOLERANCE * strength[0]).sum())
    if count > MAX_RANK:
        return []
    each = np.sqrt(strength[:count])
    return [np.concatenate([down[:, r] * each[r], across[r] * each[r]]) for r in range(count)]


def sharpened(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (n, rows, columns) less the blur that linear interpolation between points adds on average.

    At a fraction f of a step between two points interpolation adds f (1 - f)/2 squared steps of the second derivative:
    1/12 on average over f, which is subtracted here along both axes. The remaining error is 2.5 times as small where
    weights are smooth. Weights stay >= 0 and keep their sum.
    """
    out = weights.astype(np.float64)
    for axis in (1, 2):
        beyond = np.pad(out, [(0, 0), *((int(a == axis),) * 2 for a in (1, 2))])
        before, after = (np.take(beyond, np.arange(out.shape[axis]) + side, axis) for side in (0, 2))
        out = out * (7 / 6) - (before + after) / 12
    out = np.maximum(out, 0.0)
    scale = weights.sum((1, 2), dtype=np.float64) / np.maximum(out.sum((1, 2)), 1e-30)
    return (out * scale[:, None, None]).astype(np.float32)


class PlaneGroups(NamedTuple):
    """Neighbouring planes that share one map. ``first`` (n + 1,): the first plane of each group; ``table`` (n, 14): the
    constants of the plane that a group is taken to lie in (``geometry.planes``)."""

    table: NDArray[np.float32]
    first: NDArray[np.int64]


def single_planes(table: NDArray[np.float32]) -> PlaneGroups:
    """Each plane by itself."""
    return PlaneGroups(table, np.arange(len(table) + 1))


def plane_pairs(cam: CameraConstants, found: PlaneMaps, table: NDArray[np.float32], first: int) -> PlaneGroups:
    """Pairs of neighbouring planes as one group half-way between them, where a map's points are more than a voxel apart
    and light at the aperture's rim moves by less than PAIR_SHIFT from a plane to that middle: planes of even number
    with the next (``first`` 0), or with the one before (1). All others by themselves."""
    steps = column_of(table, "step_x", "step_y")
    moved = np.abs(np.diff(steps, axis=0)) / 2 * cam.radius
    width = 2 * (found.border - 2) * (2.0 ** found.shape[:, 5] / found.shape[:, 4])[:, None]
    joined = (found.shape[1:] == found.shape[:-1]).all(1) & (found.border[1:] == found.border[:-1]).all(1)
    joined &= (found.shape[1:, 5] > 0) & (moved < PAIR_SHIFT * width[1:]).all(1)
    joined &= np.arange(1, len(table)) % 2 != first
    begin = np.flatnonzero(np.append(True, ~joined))
    count = np.diff(np.append(begin, len(table)))
    middle = np.add.reduceat(table.astype(np.float64), begin, 0) / count[:, None]
    return PlaneGroups(middle.astype(np.float32), np.append(begin, len(table)))


def widest_footprint(found: PlaneMaps) -> tuple[float, float]:
    """Upper bound of half the width and height of the largest footprint, voxels."""
    right, down = (found.border * (2.0 ** found.shape[:, 5] / found.shape[:, 4])[:, None]).max(0)
    return float(right), float(down)


@kernel
def footprint_sizes(cam: CameraConstants, table: NDArray[np.float32], reach: NDArray[np.float32]) -> None:
    """Half widths in voxels of the rectangle around a footprint, the width of the ramp at its edge, and the half widths
    without the tails of the main lens' blur, into ``reach`` (nz, 5). A blurred edge counts as the ramp of the same
    variance."""
    for k in range(table.shape[0]):
        plane = plane_of(table, k)
        half = plane.half
        reach[k, 0], reach[k, 1] = box_of(cam, plane, np.int64(EXACT))
        tails_x, tails_y = F(0), F(0)
        if cam.blur > F(0):
            half = sqrt(half * half + F(3) * cam.blur * cam.blur)
            turned = (abs(cam.cos) + abs(cam.sin)) * (plane.half + F(CUT) * cam.blur - half)
            tails_x, tails_y = turned / abs(plane.cell_x), turned / abs(plane.cell_y)
        reach[k, 2] = F(2) * min(half, F(0.5)) / max(abs(plane.cell_x), abs(plane.cell_y))
        reach[k, 3], reach[k, 4] = reach[k, 0] - tails_x, reach[k, 1] - tails_y


@kernel
def tabulate_weights(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    shape: NDArray[np.int64],
    start: NDArray[np.int64],
    border: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    """Fill ``weights`` of planes ``begin`` to ``end``: those of a voxel in the points around it, for a voxel on a point
    and, where several voxels come to a point, for each place between points."""
    for k in range(begin, end):
        plane, at = plane_of(table, k), start[k, 0]
        rows, columns, points, voxels = shape[k, 2], shape[k, 3], shape[k, 4], 1 << shape[k, 5]
        right, down = border[k, 0] - 2, border[k, 1] - 2
        scale, step = F(0.25) / (plane.half * plane.half), F(voxels) / F(points)
        for place in range(voxels * voxels):
            beyond_y, beyond_x = F(place // voxels) / F(voxels), F(place % voxels) / F(voxels)
            for j in range(rows):
                oy = plane.cell_y * step * (F(down - j) + beyond_y)
                for i in range(columns):
                    ox = plane.cell_x * step * (F(right - i) + beyond_x)
                    x, y = cam.cos * ox + cam.sin * oy, cam.cos * oy - cam.sin * ox
                    weights[at] = scale * area_of(cam, x, y, plane.half, plane.half)
                    at += 1


@kernel
def read_weights(
    begin: int,
    end: int,
    cam: CameraConstants,
    table: NDArray[np.float32],
    blurred: NDArray[np.float32],
    shape: NDArray[np.int64],
    start: NDArray[np.int64],
    border: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    """``tabulate_weights`` where the main lens blurs, from ``blurred``, the ``blurred.tables_of`` the planes."""
    for k in range(begin, end):
        plane, at = plane_of(table, k), start[k, 0]
        wide, high = reach_of(cam, plane, np.int64(EXACT))
        step = F(1 << shape[k, 5]) / F(shape[k, 4])
        voxels, middle_j, middle_i = 1 << shape[k, 5], border[k, 1] - 2, border[k, 0] - 2
        for place in range(voxels * voxels):
            beyond_y, beyond_x = F(place // voxels) / F(voxels), F(place % voxels) / F(voxels)
            for j in range(shape[k, 2]):
                oy = plane.cell_y * step * (F(middle_j - j) + beyond_y)
                for i in range(shape[k, 3]):
                    ox = plane.cell_x * step * (F(middle_i - i) + beyond_x)
                    x, y = cam.cos * ox + cam.sin * oy, cam.cos * oy - cam.sin * ox
                    weights[at] = table_weight(blurred[k], wide, high, x, y)
                    at += 1
