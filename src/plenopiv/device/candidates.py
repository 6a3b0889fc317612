"""Dense ray tracing on the device: the rule of ``projection.plenoptic.candidates``, voxel by voxel.

The kernels there go through dark pixels and rule out voxels. Here each voxel of a plane asks the pixels that it may
light, a window of microlenses in each judging view, whether one of them rules it out: reads alone, no two of which
meet. What counts is the same least weight within the voxel.
"""

from __future__ import annotations

from functools import partial
from math import cos, floor, sin
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from plenopiv.cameras.coverage import half_sensor_mm
from plenopiv.device.plane_tables import SPLIT, irregularity, reach_in_lattice
from plenopiv.device.view_places import LensBlock, LensTable, lens_of, lit_part, near, places_mm
from plenopiv.device.weights import in_plane, patch_area
from plenopiv.lattice import nearest_lens
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide
from plenopiv.projection.plenoptic.candidates.kernels import LEAST_WEIGHT
from plenopiv.projection.plenoptic.candidates.rule import judging_views, weight_sums
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.projection.plenoptic.pixel_weights import EXACT, box_of, plane_of
from plenopiv.projection.plenoptic.projector import PlenopticProjector

SLACK = 0.1  # px by which lit parts of pixels depart from where they are in the first plane and in the last
ALIKE = 0.6  # of the largest window of a group of planes, the least


class Camera(NamedTuple):
    """``CameraConstants`` as numbers on the device."""

    cos: jax.Array
    sin: jax.Array
    turn: jax.Array
    x0: jax.Array
    y0: jax.Array
    radius: jax.Array


class Judged(NamedTuple):
    """Planes of like windows, (planes, ...) each: their ``number`` in the volume, the constants of
    ``geometry.Plane``, the ``largest`` weight, the blur of half a voxel in depth (``blur``), half the window of
    microlenses (``reach``), and whether a row (``rows``) and a column of voxels is seen."""

    number: NDArray[np.int32]
    plane: NDArray[np.float32]
    largest: NDArray[np.float32]
    blur: NDArray[np.float32]
    reach: NDArray[np.float32]
    rows: NDArray[np.bool_]
    columns: NDArray[np.bool_]


class Touched(NamedTuple):
    """A ``plane`` in focus, where borders between microlenses are the same in all views: the ``lenses`` (9, ny, nx)
    that hold points of each voxel, with the ring, which of them come for the first time (``new``), and the voxels that
    touch several (``several``)."""

    plane: int
    lenses: NDArray[np.int32]
    new: NDArray[np.bool_]
    several: NDArray[np.bool_]


class Judges(NamedTuple):
    """What dense ray tracing needs of a camera and a grid: ``planes`` by their windows, the judging views in ``order``
    and those inside the aperture (``whole``), planes in focus (``touched``)."""

    camera: Camera
    planes: list[tuple[tuple[int, int], Judged]]
    order: NDArray[np.int32]
    whole: NDArray[np.int32]
    touched: list[Touched]


def judges(projector: PlenopticProjector, block: LensBlock, q_half: NDArray[np.float64]) -> Judges:
    """Of a projector with exact weights; ``q_half`` (2,): half of what q of a view's pixels ranges over, px."""
    cam, order = projector.camera.cam, judging_views(projector.camera)
    whole = order[~projector.camera.rim[order]]
    in_focus = (k for k in range(projector.grid.shape[0]) if borders_coincide(projector.layout, projector.grid, k))
    touched = [found for k in in_focus if (found := touched_lenses(projector, block, k)) is not None]
    numbers = cam.cos, cam.sin, cam.turn, cam.x0, cam.y0, cam.radius
    planes = judged_planes(projector, q_half)
    return Judges(Camera(*map(jnp.float32, numbers)), planes, order.astype(np.int32), whole.astype(np.int32), touched)


def candidate_voxels(
    projector: PlenopticProjector,
    block: LensBlock,
    lenses: LensTable,
    found: Judges,
    most: NDArray[np.float32],
    particle: float,
) -> jax.Array:
    """``PlenopticProjector.candidates`` as a mask (nz, ny, nx) on the device."""
    where, cam = projector.layout, projector.camera.cam
    most = np.where(where.seen, most, np.float32(np.inf))
    if where.light is not None:  # a pixel that gets less light allows for as much more of a particle
        most = most / where.light
    inner = block.ringed(np.ones(where.lenses, bool))  # the ring rules nothing out
    bound = jnp.asarray(np.where(inner, block.ringed(most), np.float32(np.inf)))
    alive = jnp.zeros(projector.grid.shape, bool)
    for window, planes in found.planes:
        how = block, window, bool(cam.hexagonal), bool(cam.swapped)
        alive = _judge(how, found.camera, lenses, planes, found.order, bound, np.float32(particle), alive)
    light = projector.camera.column("light")
    for plane, *about in found.touched:
        alive = _together(
            alive, np.int32(plane), *about, bound, np.float32(particle * float(light[plane])), found.whole
        )
    return alive


def visible_voxels(camera: CameraOnGrid) -> jax.Array:
    """``PlenopticProjector.visible_voxels`` as a mask (nz, ny, nx) on the device."""
    rows, columns = _visible(camera)
    return jnp.asarray(rows)[:, :, None] & jnp.asarray(columns)[:, None, :]


def _visible(camera: CameraOnGrid) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """``CameraOnGrid.visible_planes`` as rows (nz, ny) and columns (nz, nx)."""
    half_s, half_t = half_sensor_mm(camera.layout.camera)
    x, y, z = camera.grid.axes()
    scale = np.abs(camera.layout.camera.scale(z))[:, None]
    return scale * np.abs(y) <= half_t, scale * np.abs(x) <= half_s


def judged_planes(projector: PlenopticProjector, q_half: NDArray[np.float64]) -> list[tuple[tuple[int, int], Judged]]:
    """Planes of like windows of microlenses (rows, microlenses along them) that a voxel may light, and the windows."""
    camera = projector.camera
    lattice, table = camera.layout.camera.lattice, camera.planes
    largest = weight_sums(camera)[:, 2].astype(np.float32)
    move = camera.column("move")
    blur = (0.5 * np.abs(np.gradient(move)) if move.size > 1 else np.zeros(1)).astype(np.float32)
    box = np.array([box_of.py_func(camera.cam, plane_of.py_func(table, k), EXACT) for k in range(len(table))])
    voxels, steps = (
        np.abs(camera.column(*names).astype(np.float64)) for names in (("voxel_s", "voxel_t"), ("step_x", "step_y"))
    )
    wide, high = ((box + (q_half + SLACK) * steps) / voxels).T
    moved = irregularity(camera)
    reach = reach_in_lattice(lattice.rotation_rad, lattice.pitch_mm, lattice.row_spacing, wide, high, moved)
    rows, columns = _visible(camera)
    windows, found = (np.floor(2 * reach) + 1).prod(1), []
    left = np.argsort(-windows, kind="stable")
    while left.size:
        alike = windows[left] >= ALIKE * windows[left[0]] if left.size >= SPLIT else np.ones(left.size, bool)
        some, left = np.sort(left[alike]), left[~alike]
        down, along = (floor(2 * most) + 1 for most in reach[some].max(0))
        of_planes = table[some], largest[some], blur[some], reach[some].astype(np.float32), rows[some], columns[some]
        found.append(((down, along), Judged(some.astype(np.int32), *of_planes)))
    return found


@partial(jax.jit, static_argnums=0, donate_argnums=7)
def _judge(
    how: tuple[LensBlock, tuple[int, int], bool, bool],
    cam: Camera,
    lenses: LensTable,
    planes: Judged,
    order: jax.Array,
    bound: jax.Array,
    particle: jax.Array,
    alive: jax.Array,
) -> jax.Array:
    """``kernels.rule_out`` for some planes, all of whose visible voxels are taken as alive. ``how``: the block of
    microlenses, the window, whether the lattice is hexagonal, and whether its rows run along y."""
    block, window, hexagonal, swapped = how
    _, ny, nx = alive.shape

    def judge(alive: jax.Array, judged: Judged) -> tuple[jax.Array, None]:
        plane = in_plane(judged.plane)
        i, j = jnp.arange(nx, dtype=jnp.float32)[None], jnp.arange(ny, dtype=jnp.float32)[:, None]
        counts, least = particle * plane.light, LEAST_WEIGHT * judged.largest
        half_x = 0.5 * (jnp.abs(plane.cell_x * cam.cos) + jnp.abs(plane.cell_y * cam.sin))
        half_y = 0.5 * (jnp.abs(plane.cell_y * cam.cos) + jnp.abs(plane.cell_x * cam.sin))

        def by_view(n: jax.Array, stays: jax.Array) -> jax.Array:
            view = order[n]
            m, of_row = lenses.offset[view]
            qx, qy = m - lenses.phase[0], lenses.phase[1] - of_row
            along, across = (jnp.abs(qy), jnp.abs(qx)) if swapped else (jnp.abs(qx), jnp.abs(qy))
            out_x, out_y = half_x + along * judged.blur, half_y + across * judged.blur
            limit = jnp.maximum(bound[view] / counts, least)
            limit = jnp.where(limit < judged.largest, limit, jnp.inf)
            lit, cut_x, cut_y = lit_part(cam.radius, plane.spread, qx, qy)
            rim = lenses.rim[view]
            limit = jnp.where(rim, limit / jnp.maximum(lit, 1e-3), limit)
            limit = jnp.where(limit < judged.largest, limit, jnp.inf)
            qx, qy = jnp.where(rim, cut_x, qx), jnp.where(rim, cut_y, qy)
            s, t = (each[0] for each in places_mm(lenses, view[None]))
            of_lens = (
                plane.voxel_s * s + plane.step_x * qx - cam.x0, plane.voxel_t * t + plane.step_y * qy - cam.y0,
                limit, out_x, out_y,
            )  # fmt: skip
            of_lens = lax.optimization_barrier(of_lens)
            middle_x, middle_y = lenses.middle[view]
            at_s = (i + cam.x0 - plane.step_x * middle_x) / plane.voxel_s
            at_t = (j + cam.y0 - plane.step_y * middle_y) / plane.voxel_t
            moved = None
            if lenses.regular is not None:
                ds, dt = s - lenses.regular[0], t - lenses.regular[1]
                moved = jnp.stack([a * ds + b * dt for a, b in lenses.from_mm[:, :2]])
            about = lax.optimization_barrier(near(block, lenses, at_s, at_t, judged.reach[0], moved))

            def by_lens(number: jax.Array, stays: jax.Array) -> jax.Array:
                row, along_row = number // window[1], number % window[1]
                lens = lens_of(block, lenses, about, row, along_row, judged.reach[1])
                cx, cy, most, beyond_x, beyond_y = (v.at[lens].get(mode="promise_in_bounds") for v in of_lens)
                ox, oy = plane.cell_x * (i - cx), plane.cell_y * (j - cy)
                x, y = cam.cos * ox + cam.sin * oy, cam.cos * oy - cam.sin * ox
                x, y = x + jnp.where(x >= 0, beyond_x, -beyond_x), y + jnp.where(y >= 0, beyond_y, -beyond_y)
                area = patch_area(hexagonal, cam.turn, x, y, plane.half, plane.half)
                return stays & (area * (0.25 / (plane.half * plane.half)) <= most)

            return lax.fori_loop(0, window[0] * window[1], by_lens, stays)

        seen = judged.rows[:, None] & judged.columns[None]
        found = lax.fori_loop(0, order.size, by_view, seen)
        return lax.dynamic_update_index_in_dim(alive, found, judged.number, 0), None

    return lax.scan(judge, alive, planes)[0]


def touched_lenses(projector: PlenopticProjector, block: LensBlock, plane: int) -> Touched | None:
    """The microlenses that voxels of a plane in focus touch, as ``in_focus.rule_out_together`` finds them; None where
    voxels are wider than a microlens."""
    where, grid = projector.layout, projector.grid
    camera, (x, y, z) = where.camera, grid.axes()
    lattice, scale = camera.lattice, float(camera.scale(z[plane]))
    depth = z[plane] + grid.voxel_mm[2] * np.array([-0.5, 0.5])
    blur = np.abs(camera.spread(depth)).max() * 0.5 * camera.main_lens.aperture_mm
    half_x, half_y = (float(0.5 * abs(scale) * size + blur) for size in grid.voxel_mm[:2])
    if max(half_x, half_y) > 0.5 * lattice.pitch_mm:
        return None
    s, t = np.broadcast_arrays(scale * x[None], scale * y[:, None])
    across, up = np.array([half_x, 0.0]), np.array([0.0, half_y])
    if lattice.map is not None:
        s, t = lattice.map.regular(s, t)
        across, up = (np.array(lattice.map.regular(*side)) for side in (across, up))
    s, t = s - lattice.offset_mm[0], t - lattice.offset_mm[1]
    c, turn = cos(lattice.rotation_rad) / lattice.pitch_mm, sin(lattice.rotation_rad) / lattice.pitch_mm
    lenses, known = np.empty((9, *s.shape), np.int32), np.ones(s.shape, bool)
    for point in range(9):
        m, n = point % 3 - 1, point // 3 - 1
        u, v = s + across[0] * m + up[0] * n, t + across[1] * m + up[1] * n
        at_i, at_j = nearest_lens(block.hexagonal, lattice.row_spacing, c * u + turn * v, c * v - turn * u)
        i, j = at_i.astype(np.int32) - where.i0, at_j.astype(np.int32) - where.j0
        known &= (i >= 0) & (i < block.ni) & (j >= 0) & (j < block.nj)
        lenses[point] = (np.clip(j, -1, block.nj) + 1) * (block.ni + 2) + np.clip(i, -1, block.ni) + 1
    new = np.array([(lenses[:n] != of_point).all(0) for n, of_point in enumerate(lenses)])
    return Touched(plane, lenses, new, known & (new.sum(0) > 1))


@partial(jax.jit, donate_argnums=0)
def _together(
    alive: jax.Array,
    plane: jax.Array,
    lenses: jax.Array,
    new: jax.Array,
    several: jax.Array,
    bound: jax.Array,
    counts: jax.Array,
    views: jax.Array,
) -> jax.Array:
    """``in_focus.judge_together`` for a plane."""

    def by_view(n: jax.Array, stays: jax.Array) -> jax.Array:
        of_view = bound[views[n]]
        return stays & (jnp.sum(jnp.where(new, of_view[lenses], 0.0), 0) >= counts)

    stays = lax.fori_loop(0, views.size, by_view, jnp.ones(alive.shape[1:], bool)) | ~several
    return alive.at[plane].set(alive[plane] & stays)
