"""Planes of voxels sorted into buckets of equal shapes, and what the device needs of each plane. NumPy alone.

A program is compiled for shapes. All planes of a bucket share one: as many points of their maps to a voxel or voxels to
a point, and arrays as long as the longest of them needs. The weights of a plane are its outer products
(``PlaneMaps.factors``), cut into *units*: V voxels, which are P points, along each axis; one of P and V is 1. Tap a of
a unit is its weight in the points of the a-th unit after it."""

from __future__ import annotations

from math import ceil, cos, floor, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.geometry import CameraOnGrid, Plane, column_of
from plenopiv.projection.plenoptic.plane_maps.maps import PlaneMaps
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import LINE_COST

EXACT = 1e-5  # of the largest singular value: outer products of planes whose weights are not left out
MARGIN = 0.02  # microlenses: rounding of a point's place among them
SPLIT = 24  # planes of a bucket that may be cut in two for the sake of ranks and windows, at least
GAIN = 0.8  # of the work, that a bucket cut in two may at most take to be worth another program


class Bucket(NamedTuple):
    """What the program for a bucket is compiled for: its number of ``planes``, ``points`` to a voxel and ``voxels`` to
    a point along an axis, outer products (``ranks``), taps and microlenses that may light a point, both along y and
    x."""

    planes: int
    points: int
    voxels: int
    ranks: int
    taps: tuple[int, int]
    window: tuple[int, int]


class PlaneTable(NamedTuple):
    """Of the planes of a bucket, (planes, ...) each.

    ``number``: of the plane in the volume. ``down`` and ``across`` (ranks, voxels, taps, points): its weights along y
    and x. ``place`` (6,): point of lens (0, 0) at q = 0, and points per mm of s or t and per px of q, of x, then of y;
    a map's first point is number 1. ``off``: A less that of the first plane of all. ``spread``: A. ``light``: share of
    a voxel's light that a wholly lit pixel collects. ``reach`` (2,): half the window of microlenses about a point, in
    rows, and in microlenses along them."""

    number: NDArray[np.int32]
    down: NDArray[np.float32]
    across: NDArray[np.float32]
    place: NDArray[np.float32]
    off: NDArray[np.float32]
    spread: NDArray[np.float32]
    light: NDArray[np.float32]
    reach: NDArray[np.float32]


class Taps(NamedTuple):
    """Weights of one plane, (ranks, voxels, taps, points) along y and x."""

    down: NDArray[np.float64]
    across: NDArray[np.float64]


def buckets(mapped: MappedViews, q_half: NDArray[np.float64]) -> list[tuple[Bucket, PlaneTable]]:
    """The buckets of all planes. ``q_half`` (2,): half of what q of one view's pixels ranges over, along x and y, px,
    at the most."""
    shape, nx = mapped.maps.shape, mapped.grid.shape[2]
    weights = [taps_of(mapped.maps, k, nx) for k in range(len(shape))]
    reach = window_reach(mapped, q_half)
    groups: dict[tuple[int, int], list[int]] = {}
    for k, (_, _, _, _, points, shift) in enumerate(shape.tolist()):
        groups.setdefault((points, 1 << shift), []).append(k)
    found = []
    for (points, voxels), numbers in groups.items():
        for part in _split(numbers, weights, reach):
            planes = np.sort(part)
            down, across = (_padded([weights[k][axis] for k in planes]) for axis in (0, 1))
            rows, along = (floor(2 * most) + 1 for most in reach[planes].max(0))
            taps = down.shape[3], across.shape[3]
            form = Bucket(planes.size, points, voxels, down.shape[1], taps, (rows, along))
            found.append((form, _table(mapped, planes, down, across, reach)))
    return found


def taps_of(maps: PlaneMaps, k: int, nx: int) -> Taps:
    """The weights of plane k. As the kernels take them for a row of ``nx`` listed voxels: by the outer products that
    are there where these are cheaper than the rectangle around each voxel, else by as many as are that rectangle."""
    _, width, rows, columns, points, shift = maps.shape[k].tolist()
    voxels, rank = 1 << shift, int(maps.rank[k])
    if rank and LINE_COST * rank * (rows + columns * voxels) * width < nx * rows * columns:
        size = rank * voxels * (rows + columns)
        each = maps.factors[maps.start[k, 1] :][:size].reshape(rank, -1).astype(np.float64)
        down, across = each[:, : voxels * rows], each[:, voxels * rows :]
    else:
        of_plane = maps.weights[maps.start[k, 0] :][: rows * columns * voxels**2]
        matrix = of_plane.reshape(voxels, voxels, rows, columns).transpose(0, 2, 1, 3).reshape(voxels * rows, -1)
        left, strength, right = np.linalg.svd(matrix.astype(np.float64), full_matrices=False)
        rank = int((strength > EXACT * strength[0]).sum())
        root = np.sqrt(strength[:rank])
        down, across = (left[:, :rank] * root).T, right[:rank] * root[:, None]
    return Taps(_taps(down, voxels, points), _taps(across, voxels, points))


def _taps(weights: NDArray[np.float64], voxels: int, points: int) -> NDArray[np.float64]:
    """Weights (ranks, voxels * length) as (ranks, voxels, taps, points), without what is 0 in all at the end."""
    each = weights.reshape(len(weights), voxels, -1)
    length = 1 + int(np.flatnonzero(np.abs(each).max((0, 1)) > 0).max(initial=0))
    taps = ceil(length / points)
    out = np.zeros((len(weights), voxels, taps * points))
    out[:, :, :length] = each[:, :, :length]
    return out.reshape(len(weights), voxels, taps, points)


def _padded(parts: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Stacked; ranks and taps that a plane has not are 0."""
    ranks, taps = max(p.shape[0] for p in parts), max(p.shape[2] for p in parts)
    out = np.zeros((len(parts), ranks, parts[0].shape[1], taps, parts[0].shape[3]), np.float32)
    for of_plane, p in zip(out, parts, strict=True):
        of_plane[: p.shape[0], :, : p.shape[2]] = p
    return out


def window_reach(mapped: MappedViews, q_half: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half the window of microlenses that may light a point of a plane's map, (nz, 2): rows of them, and microlenses
    along the rows. A microlens does so if its place is less than a step from the point, along x and y."""
    lattice, steps = mapped.layout.camera.lattice, _points_per(mapped)
    wide, high = ((1 + np.abs(steps[:, 2 * a + 1]) * q_half[a]) / np.abs(steps[:, 2 * a]) for a in (0, 1))
    moved = irregularity(mapped.camera)
    return reach_in_lattice(lattice.rotation_rad, lattice.pitch_mm, lattice.row_spacing, wide, high, moved)


def reach_in_lattice(
    rotation_rad: float, pitch_mm: float, row_spacing: float, wide: NDArray, high: NDArray, irregular: float
) -> NDArray[np.float64]:
    """Half a window that is ``wide`` and ``high`` (n,) to each side, mm of s and t, in rows of a lattice and in
    microlenses along them, (n, 2). ``irregular``: ``irregularity``."""
    c, s = abs(cos(rotation_rad)), abs(sin(rotation_rad))
    along, across = (c * wide + s * high) / pitch_mm, (c * high + s * wide) / pitch_mm
    moved = irregular * (np.maximum(along, across) + 1)
    return np.stack([(across + moved) / row_spacing, along + moved], -1) + MARGIN


def irregularity(camera: CameraOnGrid) -> float:
    """By how much microlenses side by side may be moved against each other in any view, pitches."""
    views = range(camera.layout.views if camera.shifts is not None else 1)
    return max((float(camera.lenses_moved(view)[1]) for view in views), default=0.0)


def _points_per(mapped: MappedViews) -> NDArray[np.float64]:
    """Points of each plane's map per mm of s, px of q along x, mm of t and px of q along y, (nz, 4)."""
    shape = mapped.maps.shape
    points = (shape[:, 4] / 2.0 ** shape[:, 5])[:, None]
    return points * column_of(mapped.planes, "voxel_s", "step_x", "voxel_t", "step_y").astype(np.float64)


def _table(
    mapped: MappedViews,
    planes: NDArray[np.int64],
    down: NDArray[np.float32],
    across: NDArray[np.float32],
    reach: NDArray[np.float64],
) -> PlaneTable:
    """The table of some planes."""
    shape, constants = mapped.maps.shape[planes], mapped.planes[planes]
    points = (shape[:, 4] / 2.0 ** shape[:, 5])[:, None]
    first = mapped.maps.border[planes] - 1 - points * np.array([mapped.cam.x0, mapped.cam.y0], np.float64)
    steps = _points_per(mapped)[planes]
    place = np.concatenate([first[:, :1], steps[:, :2], first[:, 1:], steps[:, 2:]], 1)
    spread, light = (constants[:, Plane._fields.index(name)] for name in ("spread", "light"))
    off = spread - column_of(mapped.planes, "spread")[0]
    to = np.float32
    return PlaneTable(
        planes.astype(np.int32), down, across, place.astype(to), off, spread, light, reach[planes].astype(to)
    )


def _split(planes: list[int], weights: list[Taps], reach: NDArray[np.float64]) -> list[list[int]]:
    """Planes of as many points to a voxel in one list, or in several where that saves much work."""
    if len(planes) < SPLIT:
        return [planes]
    cuts = []
    for order in (sorted(planes, key=lambda k: len(weights[k].down)), sorted(planes, key=lambda k: tuple(reach[k]))):
        for at in range(1, len(order)):
            parts = order[:at], order[at:]
            cuts.append((sum(_work(part, weights, reach) for part in parts), parts))
    least, best = min(cuts, key=lambda cut: cut[0])
    if least > GAIN * _work(planes, weights, reach):
        return [planes]
    return [part for half in best for part in _split(half, weights, reach)]


def _work(planes: list[int], weights: list[Taps], reach: NDArray[np.float64]) -> float:
    """Time that some planes take in one bucket: products for each point, and microlenses about it, which take several
    times as long and come once for each view."""
    ranks = max(len(weights[k].down) for k in planes)
    phases, taps = (max(weights[k].down.shape[axis] for k in planes) for axis in (1, 2))
    rows, along = (floor(2 * most) + 1 for most in reach[planes].max(0))
    return len(planes) * (4 * ranks * taps * phases + 60 * rows * along)
