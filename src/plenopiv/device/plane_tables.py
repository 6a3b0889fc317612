"""Planes of voxels sorted into buckets of equal shapes, and what the device needs of each plane. NumPy alone.

A program is compiled for shapes. All planes of a bucket share one: as many points of their maps to a voxel or voxels to
a point, and arrays as long as the longest of them needs. The weights of a voxel in the points around it are the
rectangles of ``PlaneMaps``, one for each place of a voxel between points, cut into *units*: V voxels, which are P
points, along each axis; one of P and V is 1. Tap a of a unit is its weight in the points of the a-th unit after it."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.projection.plenoptic.geometry import CameraOnGrid, column_of
from plenopiv.projection.plenoptic.plane_maps.maps import PlaneGroups, PlaneMaps
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews

STEPS = "voxel_s", "step_x", "voxel_t", "step_y"  # of ``geometry.Plane``
MARGIN = 0.02  # microlenses: rounding of a place among them


class Bucket(NamedTuple):
    """What the program for a bucket is compiled for: its number of ``planes``, or of groups of planes that share a map,
    and of ``members`` of a group; ``points`` to a voxel and ``voxels`` to a point along an axis; ``taps`` along y and
    x."""

    planes: int
    members: int
    points: int
    voxels: int
    taps: tuple[int, int]


class PlaneTable(NamedTuple):
    """Of the groups of a bucket, (groups, ...) each; a plane by itself is a group of one.

    Of each member, (groups, members, ...): ``number`` of the plane in the volume, and ``weights`` (places, phases, taps
    along y, along x): of voxels at each place between points, in points at each place between voxels; 0 of a member
    that is only there for the sake of shapes. Of the plane that the group is taken to lie in: ``place`` (6,), point of
    lens (0, 0) at q = 0, and points per mm of s or t and per px of q, of x, then of y; a map's first point is number 1.
    ``off``: A less that of the first plane of all. ``light``: share of a voxel's light that a wholly lit pixel
    collects."""

    number: NDArray[np.int32]
    weights: NDArray[np.float32]
    place: NDArray[np.float32]
    off: NDArray[np.float32]
    light: NDArray[np.float32]


def buckets(
    mapped: MappedViews, variants: Sequence[PlaneGroups], weights: Sequence[NDArray[np.float32]]
) -> list[tuple[Bucket, PlaneTable]]:
    """The buckets of all planes, in groups; and the table of each for every one of ``variants`` of the groups, which
    share programs, (variants, groups, ...). ``weights``: ``rectangles_of`` each plane."""
    alike: dict[tuple[int, int], list[int]] = {}
    for k, (_, _, _, _, points, shift) in enumerate(mapped.maps.shape.tolist()):
        alike.setdefault((points, 1 << shift), []).append(k)
    found = []
    for (points, voxels), planes in alike.items():
        groups = [np.flatnonzero(np.isin(each.first[:-1], planes)) for each in variants]
        members = [[np.arange(*each.first[g : g + 2]) for g in own] for each, own in zip(variants, groups, strict=True)]
        taps_y, taps_x = (max(ceil(weights[k].shape[axis] / points) for k in planes) for axis in (2, 3))
        count, most = max(map(len, members)), max(len(group) for own in members for group in own)
        form = Bucket(count, most, points, voxels, (taps_y, taps_x))
        tables = [
            _table(mapped, form, each.table[own], group, weights)
            for each, own, group in zip(variants, groups, members, strict=True)
        ]
        found.append((form, PlaneTable(*(np.stack(parts) for parts in zip(*tables, strict=True)))))
    return found


def rectangles_of(maps: PlaneMaps, k: int) -> NDArray[np.float32]:
    """The weights of voxels of plane k in the points around them, (place along y, along x, point along y, along x),
    without what is 0 in all of them at the end."""
    _, _, rows, columns, _, shift = maps.shape[k].tolist()
    voxels = 1 << shift
    of_plane = maps.weights[maps.start[k, 0] :][: rows * columns * voxels**2].reshape(voxels, voxels, rows, columns)
    most = np.abs(of_plane).max((0, 1))
    high, wide = (1 + int(np.flatnonzero(most.max(axis) > 0).max(initial=0)) for axis in (1, 0))
    return of_plane[:, :, :high, :wide]


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
    weights: Sequence[NDArray[np.float32]],
) -> PlaneTable:
    """The table of some groups of planes, taken to lie where ``constants`` (groups, 14) say; with groups of none at the
    end, as many as ``form`` has more."""
    number, place = np.zeros((form.planes, form.members), np.int32), np.ones((form.planes, 6))
    out = np.zeros((*number.shape, form.voxels**2, form.points**2, *form.taps), np.float32)
    off, light = np.zeros(form.planes), np.zeros(form.planes)
    spread = column_of(mapped.planes, "spread")[0]
    for g, (group, plane) in enumerate(zip(groups, constants, strict=True)):
        for m, k in enumerate(group):
            number[g, m], out[g, m] = k, _in_units(form, weights[k])
        place[g] = place_of(mapped, group[0], plane)
        off[g], light[g] = column_of(plane[None], "spread")[0] - spread, column_of(plane[None], "light")[0]
    return PlaneTable(number, out, *(each.astype(np.float32) for each in (place, off, light)))


def _in_units(form: Bucket, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rectangles of weights as (places, phases, taps along y, along x)."""
    (high, wide), points = form.taps, form.points
    more = [(0, n * points - size) for n, size in zip((high, wide), weights.shape[2:], strict=True)]
    units = np.pad(weights, ((0, 0), (0, 0), *more)).reshape(form.voxels**2, high, points, wide, points)
    return units.transpose(0, 2, 4, 1, 3).reshape(form.voxels**2, points**2, high, wide)
