"""Planes of voxels sorted into buckets of equal shapes, and what the device needs of each plane. NumPy alone.

A program is compiled for shapes. All planes of a bucket share one: as many points of their maps to a voxel or voxels to
a point, and arrays as long as the longest of them needs. The weights of a plane are its outer products
(``PlaneMaps.factors``), cut into *units*: V voxels, which are P points, along each axis; one of P and V is 1. Tap a of
a unit is its weight in the points of the a-th unit after it."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, floor, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.geometry import CameraOnGrid, column_of
from plenopiv.projection.plenoptic.plane_maps.maps import PlaneGroups, PlaneMaps
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.projection.plenoptic.plane_maps.voxel_rows import LINE_COST

EXACT = 1e-5  # of the largest singular value: outer products of planes whose weights are not left out
STEPS = "voxel_s", "step_x", "voxel_t", "step_y"  # of ``geometry.Plane``
MARGIN = 0.02  # microlenses: rounding of a place among them
SPLIT = 24  # planes of a bucket that may be cut in two for the sake of ranks, at least
GAIN = 0.8  # of the work, that a bucket cut in two may at most take to be worth another program


class Bucket(NamedTuple):
    """What the program for a bucket is compiled for: its number of ``planes``, or of groups of planes that share a map,
    and of ``members`` of a group; ``points`` to a voxel and ``voxels`` to a point along an axis; outer products
    (``ranks``); taps along y and x."""

    planes: int
    members: int
    points: int
    voxels: int
    ranks: int
    taps: tuple[int, int]


class PlaneTable(NamedTuple):
    """Of the groups of a bucket, (groups, ...) each; a plane by itself is a group of one.

    Of each member, (groups, members, ...): ``number`` of the plane in the volume; whether it is ``real``, or there for
    the sake of shapes and dark; ``down`` and ``across`` (ranks, voxels, taps, points), its weights along y and x. Of
    the plane that the group is taken to lie in: ``place`` (6,), point of lens (0, 0) at q = 0, and points per mm of s
    or t and per px of q, of x, then of y; a map's first point is number 1. ``off``: A less that of the first plane of
    all. ``light``: share of a voxel's light that a wholly lit pixel collects."""

    number: NDArray[np.int32]
    real: NDArray[np.bool_]
    down: NDArray[np.float32]
    across: NDArray[np.float32]
    place: NDArray[np.float32]
    off: NDArray[np.float32]
    light: NDArray[np.float32]


class Taps(NamedTuple):
    """Weights of one plane, (ranks, voxels, taps, points) along y and x."""

    down: NDArray[np.float64]
    across: NDArray[np.float64]


def buckets(
    mapped: MappedViews, variants: Sequence[PlaneGroups], weights: Sequence[Taps]
) -> list[tuple[Bucket, PlaneTable]]:
    """The buckets of all planes, in groups; and the table of each for every one of ``variants`` of the groups, which
    share programs, (variants, groups, ...). ``weights``: ``taps_of`` each plane."""
    alike: dict[tuple[int, int], list[int]] = {}
    for k, (_, _, _, _, points, shift) in enumerate(mapped.maps.shape.tolist()):
        alike.setdefault((points, 1 << shift), []).append(k)
    found = []
    for (points, voxels), planes in alike.items():
        for part in _split(planes, weights):
            groups = [np.flatnonzero(np.isin(each.first[:-1], part)) for each in variants]
            members = [
                [np.arange(*each.first[g : g + 2]) for g in own] for each, own in zip(variants, groups, strict=True)
            ]
            every = [group for own in members for group in own]
            met = np.unique(np.concatenate(every)) if every else np.array(part)
            ranks, taps_y, taps_x = (max(weights[k][a].shape[n] for k in met) for a, n in ((0, 0), (0, 2), (1, 2)))
            count, most = max(map(len, members)), max((len(group) for group in every), default=1)
            form = Bucket(count, most, points, voxels, ranks, (taps_y, taps_x))
            tables = [
                _table(mapped, form, each.table[own], group, weights)
                for each, own, group in zip(variants, groups, members, strict=True)
            ]
            found.append((form, PlaneTable(*(np.stack(parts) for parts in zip(*tables, strict=True)))))
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


def place_of(mapped: MappedViews, first: int, constants: NDArray[np.float32]) -> NDArray[np.float64]:
    """``PlaneTable.place`` of a group whose ``first`` plane this is, taken to lie where ``constants`` (14,) say."""
    *_, points, shift = mapped.maps.shape[first].tolist()
    per_voxel = points / 2.0**shift
    at = mapped.maps.border[first] - 1 - per_voxel * np.array([mapped.cam.x0, mapped.cam.y0], np.float64)
    s, x, t, y = per_voxel * column_of(constants[None], *STEPS)[0].astype(np.float64)
    return np.array([at[0], s, x, at[1], t, y])


def _table(
    mapped: MappedViews,
    form: Bucket,
    constants: NDArray[np.float32],
    groups: list[NDArray[np.int64]],
    weights: Sequence[Taps],
) -> PlaneTable:
    """The table of some groups of planes, taken to lie where ``constants`` (groups, 14) say; with groups of none at the
    end, as many as ``form`` has more."""
    number = np.zeros((form.planes, form.members), np.int32)
    real, place = np.zeros(number.shape, bool), np.ones((form.planes, 6))
    down, across = (np.zeros((*number.shape, form.ranks, form.voxels, taps, form.points)) for taps in form.taps)
    off, light = np.zeros(form.planes), np.zeros(form.planes)
    spread = column_of(mapped.planes, "spread")[0]
    for g, (group, plane) in enumerate(zip(groups, constants, strict=True)):
        for m, k in enumerate(group):
            number[g, m], real[g, m] = k, True
            for out, taps in zip((down, across), weights[k][:2], strict=True):
                out[g, m, : taps.shape[0], :, : taps.shape[2]] = taps
        place[g] = place_of(mapped, group[0], plane)
        off[g], light[g] = column_of(plane[None], "spread")[0] - spread, column_of(plane[None], "light")[0]
    numbers = (each.astype(np.float32) for each in (down, across, place, off, light))
    return PlaneTable(number, real, *numbers)


def _split(planes: list[int], weights: Sequence[Taps]) -> list[list[int]]:
    """Planes of as many points to a voxel in one list, or in several where that saves much work."""
    if len(planes) < SPLIT or weights[planes[0]].down.shape[1] > 1:  # neighbours may share a map
        return [planes]
    order = sorted(planes, key=lambda k: len(weights[k].down))
    cuts = [(order[:at], order[at:]) for at in range(1, len(order))]
    least, best = min(((sum(_work(part, weights) for part in parts), parts) for parts in cuts), key=lambda cut: cut[0])
    if least > GAIN * _work(planes, weights):
        return [planes]
    return [part for half in best for part in _split(half, weights)]


def _work(planes: list[int], weights: Sequence[Taps]) -> float:
    """Products that some planes take in one bucket, for each voxel or point."""
    ranks = max(len(weights[k].down) for k in planes)
    phases, taps = (max(weights[k].down.shape[axis] for k in planes) for axis in (1, 2))
    return float(len(planes) * ranks * taps * phases)
