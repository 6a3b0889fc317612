"""What each plane's listed voxels need to ask the microlenses about them. NumPy alone.

The light that a voxel has in a pixel is its weights in the points of its plane's map (``plane_tables``), read where the
pixel's footprint is centred. Seen from the voxel that is a table of its own, the same for all voxels of a plane that
lie alike between points, read at the place of the footprint less that of the voxel. Planes whose voxels ask windows of
nearly as many microlenses share a program.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.device.plane_tables import irregularity, place_of, reach_in_lattice
from plenopiv.projection.plenoptic.geometry import column_of
from plenopiv.projection.plenoptic.plane_maps.maps import PlaneGroups
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews

BEFORE, BEHIND = 1, 2  # zeros around a table of weights, so that places beside it can be read too
NOTHING = 1e-7  # of the largest weight: no light
ALIKE = 0.7  # of the largest window of a bucket, the least

Ends = list[NDArray[np.int64]]


class Asking(NamedTuple):
    """What a program is compiled for: ``planes`` in a bucket, and the ``window`` of microlenses (rows of them,
    microlenses along them) that their voxels ask."""

    planes: int
    window: tuple[int, int]


class VoxelTable(NamedTuple):
    """Of the planes of a bucket, (planes, ...) each.

    ``number`` of the plane in the volume; ``points`` to a voxel; ``shift``: voxels to a point along an axis are 2 to
    that; ``weights``: tables (y, x) of ``size`` (2,) one after the other, of voxels at each place between points, along
    y and then x, with zeros around; ``centre`` (2, places): point in the middle of a voxel's weights, along y and x,
    counted from its first; ``reach`` (2,): half the window of microlenses. Of each variant of the groups of planes,
    (planes, variants, ...): ``place`` (6,), and ``off``, as of ``PlaneTable``."""

    number: NDArray[np.int32]
    points: NDArray[np.int32]
    shift: NDArray[np.int32]
    size: NDArray[np.int32]
    weights: NDArray[np.float32]
    centre: NDArray[np.float32]
    reach: NDArray[np.float32]
    place: NDArray[np.float32]
    off: NDArray[np.float32]


def voxel_tables(
    mapped: MappedViews,
    variants: Sequence[PlaneGroups],
    weights: Sequence[NDArray[np.float32]],
    q_half: NDArray[np.float64],
) -> list[tuple[Asking, VoxelTable]]:
    """The tables of all planes in buckets; arguments as of ``plane_tables.buckets``, with the planes' ``weights``."""
    shape = mapped.maps.shape
    each = [_table_of(one) for one in weights]
    place, off = (np.stack(parts, 1) for parts in zip(*(_places(mapped, groups) for groups in variants), strict=True))
    half = np.array([[(high - low + 2).max() / 2 for low, high in zip(*ends, strict=True)] for _, ends in each])
    lattice = mapped.layout.camera.lattice
    wide, high = (
        ((half[:, 1 - a, None] + np.abs(place[:, :, 3 * a + 2]) * q_half[a]) / np.abs(place[:, :, 3 * a + 1])).max(1)
        for a in (0, 1)
    )
    moved = irregularity(mapped.camera)
    reach = reach_in_lattice(lattice.rotation_rad, lattice.pitch_mm, lattice.row_spacing, wide, high, moved)
    longest, places = max(table.size for table, _ in each), max(len(low[0]) for _, (low, _) in each)
    flat, centre = np.zeros((len(each), longest), np.float32), np.zeros((len(each), 2, places), np.float32)
    for k, (table, (low, last)) in enumerate(each):
        flat[k, : table.size] = table.ravel()
        for a in (0, 1):
            centre[k, a, : len(low[a])] = (low[a] + last[a]) / 2
    found = VoxelTable(
        np.arange(len(each), dtype=np.int32),
        shape[:, 4].astype(np.int32),
        shape[:, 5].astype(np.int32),
        np.array([table.shape[2:] for table, _ in each], np.int32),
        flat,
        centre,
        reach.astype(np.float32),
        place.astype(np.float32),
        off.astype(np.float32),
    )
    return [_bucket(found, reach, some) for some in _alike(reach)]


def _table_of(both: NDArray[np.float32]) -> tuple[NDArray[np.float32], tuple[Ends, Ends]]:
    """The tables of a plane, (place along y, along x, y, x), with zeros around; and the first and the last point of
    the weights of voxels at each place, along y and x."""
    lit = np.abs(both) > NOTHING * np.abs(both).max()
    along = lit.any((1, 3)), lit.any((0, 2))  # (place, point) along y, along x
    ends = [each.argmax(1) for each in along], [each.shape[1] - 1 - each[:, ::-1].argmax(1) for each in along]
    around = (BEFORE, BEHIND)
    return np.pad(both, ((0, 0), (0, 0), around, around)), ends


def _places(mapped: MappedViews, groups: PlaneGroups) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of each plane ``place`` and ``off`` of the group that it is in."""
    place, off = np.ones((len(mapped.planes), 6)), np.zeros(len(mapped.planes))
    spread = column_of(mapped.planes, "spread")
    for g, constants in enumerate(groups.table):
        group = slice(*groups.first[g : g + 2])
        place[group] = place_of(mapped, group.start, constants)
        off[group] = column_of(constants[None], "spread")[0] - spread[0]
    return place, off


def _alike(reach: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Planes of nearly equal windows."""
    windows, out = (np.floor(2 * reach) + 1).prod(1), []
    left = np.argsort(-windows, kind="stable")
    while left.size:
        alike = windows[left] >= ALIKE * windows[left[0]]
        out.append(np.sort(left[alike]))
        left = left[~alike]
    return out


def _bucket(found: VoxelTable, reach: NDArray[np.float64], some: NDArray[np.int64]) -> tuple[Asking, VoxelTable]:
    rows, along = (floor(2 * most) + 1 for most in reach[some].max(0))
    return Asking(some.size, (rows, along)), VoxelTable._make(each[some] for each in found)
