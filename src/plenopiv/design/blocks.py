"""Blocks: the cells of object space within which a point keeps its light columns, in a plane.

Source: Shi, Ding & New (2016), section 2, Figs. 3 to 6: "Any point light sources inside these blocks cannot be
distinguished." A block is convex (see ``light_columns``), so equal codes on a raster are one block, and its polygon is
what is left of a large rectangle after a cut by each of its half-planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.design.light_columns import checked_points, fan_mm, half_spaces, lens_met
from plenopiv.errors import PlenoPIVError

Array = NDArray[np.float64]
Interval = tuple[float, float]


class Plane(NamedTuple):
    """A plane of object space: ``across`` and ``up`` number the axes (0, 1, 2 = x, y, z) of its pictures."""

    across: int
    up: int
    at_mm: float  # on the third axis

    def points_mm(self, across_mm: ArrayLike, up_mm: ArrayLike) -> Array:
        """Points (n, 3) in mm of positions (n,) in the plane."""
        across, up = np.broadcast_arrays(across_mm, up_mm)
        points = np.full((across.size, 3), self.at_mm)
        points[:, self.across], points[:, self.up] = across.ravel(), up.ravel()
        return points


def yz_plane(x_mm: float = 0.0) -> Plane:
    """The plane of the paper's Figs. 3 to 6: z across, y up."""
    return Plane(2, 1, x_mm)


def xy_plane(z_mm: float) -> Plane:
    """A plane of constant depth: x across, y up."""
    return Plane(0, 1, z_mm)


@dataclass(frozen=True)
class Blocks:
    """The blocks that a window of a plane meets.

    ``label`` (n up, n across): which block holds the middle of each raster cell; blocks smaller than a cell may be
    missed. ``across_mm``, ``up_mm``: the middles. ``polygon`` (m, corners, 2) in mm, (across, up), whole blocks, also
    beyond the window; the last corner is repeated where others have more. ``whole`` (m,): the block closes within
    ``margin`` of the window.
    """

    label: NDArray[np.int64]
    across_mm: Array
    up_mm: Array
    polygon: Array
    whole: NDArray[np.bool_]

    @property
    def area_mm2(self) -> Array:
        """Area of each block, (m,)."""
        x, y = self.polygon[..., 0], self.polygon[..., 1]
        x, y = x - x[:, :1], y - y[:, :1]  # areas are small beside positions
        return 0.5 * np.abs((x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y).sum(1))

    @property
    def extent_mm(self) -> Array:
        """Extent of each block along both axes, (m, 2): across, up."""
        return self.polygon.max(1) - self.polygon.min(1)


def blocks(
    camera: PlenopticCamera,
    plane: Plane,
    across_mm: Interval,
    up_mm: Interval,
    shape: tuple[int, int] = (400, 400),
    rays_mm: ArrayLike | None = None,
) -> Blocks:
    """The blocks of a window of ``plane``, on a raster of ``shape`` (n up, n across).

    ``rays_mm`` (rays, 2) on the main lens: ``fan_mm(camera)``, the default, is the paper's analysis, in which light
    stays in the y-z plane. With ``corners_mm(camera)`` blocks are sections of the blocks in space, which planes of
    constant z and hexagonal lattices need. The plane x = 0 holds edges of a hexagonal lattice whose rows run along x:
    rays in them meet the one microlens or the other by rounding, so take another plane there.

    Raises:
        PlenoPIVError: a window that is empty or not in front of the main lens.
    """
    if not (across_mm[0] < across_mm[1] and up_mm[0] < up_mm[1] and min(shape) > 0):
        raise PlenoPIVError(f"design: the window {across_mm} x {up_mm} mm of {shape} cells is empty, give (low, high)")
    rays = fan_mm(camera) if rays_mm is None else np.asarray(rays_mm, np.float64)
    across, up = (_middles(limits, n) for limits, n in ((across_mm, shape[1]), (up_mm, shape[0])))
    points = checked_points(camera, plane.points_mm(*np.meshgrid(across, up)))
    _, first, label = np.unique(_key(camera, points, rays), return_index=True, return_inverse=True)
    box = _margin(across_mm), _margin(up_mm)
    polygon = polygons(camera, plane, points[first], box, rays)
    bounds = np.array(box)
    whole = np.all((polygon > bounds[:, 0]) & (polygon < bounds[:, 1]), axis=(1, 2))
    return Blocks(label.reshape(shape), across, up, polygon, whole)


def polygons(
    camera: PlenopticCamera, plane: Plane, points_mm: Array, box_mm: tuple[Interval, Interval], rays_mm: Array
) -> Array:
    """Polygons (m, corners, 2) in mm, counter-clockwise, of the blocks that hold ``points_mm`` (m, 3), within a box."""
    (left, right), (low, high) = box_mm
    corners = np.array([(left, low), (right, low), (right, high), (left, high)], np.float64)
    polygon = np.repeat(corners[None], len(points_mm), 0)
    (normal,) = {0, 1, 2} - {plane.across, plane.up}
    for gradient, limit in _all_half_spaces(camera, points_mm, rays_mm):
        in_plane = gradient[:, [plane.across, plane.up]]
        polygon = _cut(polygon, in_plane, limit - gradient[:, normal] * plane.at_mm)
    return polygon


def _all_half_spaces(camera: PlenopticCamera, points: Array, rays: Array) -> Iterator[tuple[Array, Array]]:
    for ray in rays:
        yield from half_spaces(camera, points, ray)


def _cut(polygon: Array, normal: Array, limit: Array) -> Array:
    """The part n.p <= limit of each convex polygon (m, k, 2): Sutherland & Hodgman (1974), one half-plane."""
    over = np.einsum("mkc,mc->mk", polygon, normal) - limit[:, None]
    inside = over <= 0
    if inside.all():
        return polygon
    crosses = inside != np.roll(inside, -1, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(crosses, over / (over - np.roll(over, -1, 1)), 0.0)
    cut = polygon + part[..., None] * (np.roll(polygon, -1, 1) - polygon)
    m, k, _ = polygon.shape
    corners = np.stack([polygon, cut], 2).reshape(m, 2 * k, 2)
    kept = np.stack([inside, crosses], 2).reshape(m, 2 * k)
    count = kept.sum(1)
    order = np.argsort(~kept, axis=1, kind="stable")
    order = np.take_along_axis(order, np.minimum(np.arange(count.max()), count[:, None] - 1), 1)
    return np.take_along_axis(corners, order[..., None], 1)


def _key(camera: PlenopticCamera, points: Array, rays: Array) -> NDArray[np.uint64]:
    """One number for each point's code: a sum with random weights modulo 2^64, which two codes share by chance only."""
    weights = np.random.default_rng(0).integers(1, 2**63, (len(rays), 2), dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    key = np.zeros(len(points), np.uint64)
    for ray, (along, across) in zip(rays, weights, strict=True):
        i, j = lens_met(camera, points, ray)
        key += i.astype(np.uint64) * along + j.astype(np.uint64) * across
    return key


def _middles(limits: Interval, n: int) -> Array:
    edges = np.linspace(*limits, n + 1)
    return 0.5 * (edges[1:] + edges[:-1])


def _margin(limits: Interval) -> Interval:
    """A window as far again on each side, where blocks that leave the window may close."""
    side = limits[1] - limits[0]
    return limits[0] - side, limits[1] + side
