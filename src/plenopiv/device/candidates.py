"""Dense ray tracing on the device: the rule of ``projection.plenoptic.candidates``, voxel by voxel.

The kernels there go through dark pixels and rule out voxels. Here each voxel of a plane asks the pixels that it may
light, a window of microlenses in each judging view, whether one of them rules it out: reads alone, no two of which
meet. What counts is the same least weight within the voxel. The voxels that are left are listed anew after every few
views, the first of which rule out most.
"""

from __future__ import annotations

from functools import partial
from math import floor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from plenopiv.cameras.coverage import half_sensor_mm
from plenopiv.device.in_focus import Touched, judge_together, touched_lenses
from plenopiv.device.plane_tables import irregularity, reach_in_lattice
from plenopiv.device.view_places import LensBlock, LensTable, lens_of, lit_part, near, places_mm
from plenopiv.device.weights import in_plane, patch_area
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide
from plenopiv.projection.plenoptic.candidates.kernels import LEAST_WEIGHT
from plenopiv.projection.plenoptic.candidates.rule import judging_views, weight_sums
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.projection.plenoptic.pixel_weights import EXACT, box_of, plane_of
from plenopiv.projection.plenoptic.projector import PlenopticProjector

SLACK = 0.1  # px by which lit parts of pixels depart from where they are in the first plane and in the last
LONGEST, SHORTEST = 1 << 22, 1 << 12  # runs of a plane's voxels that are judged at once
FILLED_UP = 1.25  # of the voxels that are left, runs judge at the most, where shorter runs can help it
VIEWS = 8  # that judge before the voxels that are left are listed anew
SPLIT = 24  # planes that are left to be judged by one program, at the most, whatever their windows
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


class How(NamedTuple):
    """What the program that judges is compiled for: the block of ``lenses``, the ``window`` of them that a voxel may
    light, whether the lattice is ``hexagonal`` and its rows run along y (``swapped``), ``columns`` of voxels, and
    voxels judged ``at_once``."""

    lenses: LensBlock
    window: tuple[int, int]
    hexagonal: bool
    swapped: bool
    columns: int
    at_once: int


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
    ny, nx = projector.grid.shape[1:]
    longest = min(LONGEST, 1 << (ny * nx - 1).bit_length())
    alive = jnp.zeros(projector.grid.shape, bool)
    together = np.minimum(np.arange(-(-len(found.order) // VIEWS) * VIEWS), len(found.order) - 1)
    groups = jax.device_put(list(found.order[together].reshape(-1, VIEWS)))
    about = found.camera, lenses, bound, jnp.float32(particle)
    for window, planes in found.planes:
        how = block, window, bool(cam.hexagonal), bool(cam.swapped), nx
        for judged in map(Judged._make, zip(*planes, strict=True)):
            judged = jax.device_put(judged)
            voxels, on_device, stays = _seen(judged.rows, judged.columns, longest)
            for views in groups:
                count = int(on_device)
                if count == 0:
                    break
                run, room = run_length(count, longest), room_for(count, longest, voxels.size)
                if room < voxels.size:  # what is listed anew is as long as the list
                    voxels, stays = _shortened(voxels, stays, room)
                for start in range(0, count, run):
                    stays = _judge(How(*how, run), *about, judged, views, voxels, np.int32(start), stays)
                voxels, on_device, stays = _kept(voxels, stays, ny * nx)
            alive = _with_plane(alive, judged.number, voxels)
    light = projector.camera.column("light")
    for plane, *touched in found.touched:
        alive = judge_together(
            alive, np.int32(plane), *touched, bound, np.float32(particle * float(light[plane])), found.whole
        )
    return alive


def run_length(count: int, longest: int) -> int:
    """The longest run, of some of which each has a program, in which so many voxels are judged without many others."""
    runs = [longest >> shift for shift in (0, 2, 4, 6) if longest >> shift >= SHORTEST] or [longest]
    return next((run for run in runs if -(-count // run) * run <= FILLED_UP * count), runs[-1])


def room_for(count: int, longest: int, room: int) -> int:
    """The shortest list, of a few lengths each of which has programs, that holds so many voxels in whole runs; no
    longer than ``room``, which does."""
    rooms = [longest >> shift for shift in (0, 2, 4, 6) if count <= longest >> shift >= SHORTEST]
    return min([room, *rooms])


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


@partial(jax.jit, static_argnums=0, donate_argnums=9)
def _judge(
    how: How,
    cam: Camera,
    lenses: LensTable,
    bound: jax.Array,
    particle: jax.Array,
    judged: Judged,
    order: jax.Array,
    voxels: jax.Array,
    start: jax.Array,
    kept: jax.Array,
) -> jax.Array:
    """``kernels.rule_out`` by the views ``order`` for those of a plane's listed ``voxels`` that begin at ``start``:
    ``kept`` (listed voxel,) with whether each of them stays."""
    block, window, plane = how.lenses, how.window, in_plane(judged.plane)
    some = lax.dynamic_slice_in_dim(voxels, start, how.at_once)
    i, j = (some % how.columns).astype(jnp.float32), (some // how.columns).astype(jnp.float32)
    counts, least = particle * plane.light, LEAST_WEIGHT * judged.largest
    half_x = 0.5 * (jnp.abs(plane.cell_x * cam.cos) + jnp.abs(plane.cell_y * cam.sin))
    half_y = 0.5 * (jnp.abs(plane.cell_y * cam.cos) + jnp.abs(plane.cell_x * cam.sin))

    def by_view(n: jax.Array, left: jax.Array) -> jax.Array:
        view = order[n]
        m, of_row = lenses.offset[view]
        qx, qy = m - lenses.phase[0], lenses.phase[1] - of_row
        along, across = (jnp.abs(qy), jnp.abs(qx)) if how.swapped else (jnp.abs(qx), jnp.abs(qy))
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

        def by_lens(number: jax.Array, left: jax.Array) -> jax.Array:
            row, along_row = number // window[1], number % window[1]
            lens = lens_of(block, lenses, about, row, along_row, judged.reach[1])
            cx, cy, most, beyond_x, beyond_y = (v.at[lens].get(mode="promise_in_bounds") for v in of_lens)
            ox, oy = plane.cell_x * (i - cx), plane.cell_y * (j - cy)
            x, y = cam.cos * ox + cam.sin * oy, cam.cos * oy - cam.sin * ox
            x, y = x + jnp.where(x >= 0, beyond_x, -beyond_x), y + jnp.where(y >= 0, beyond_y, -beyond_y)
            area = patch_area(how.hexagonal, cam.turn, x, y, plane.half, plane.half)
            return jnp.minimum(left, most - area * (0.25 / (plane.half * plane.half)))

        return lax.fori_loop(0, window[0] * window[1], by_lens, left)

    # what pixels could take more, at the least: of a voxel that one of them rules out less than nothing
    left = lax.fori_loop(0, order.size, by_view, jnp.full(how.at_once, jnp.inf, jnp.float32))
    return lax.dynamic_update_slice_in_dim(kept, left >= 0, start, 0)


@partial(jax.jit, static_argnums=2)
def _seen(rows: jax.Array, columns: jax.Array, run: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The numbers of a plane's voxels in ``rows`` and ``columns`` that are seen, in a list that has room for all of
    them and for whole runs; how many there are; and of none that it stays."""
    seen = (rows[:, None] & columns[None]).reshape(-1)
    room = -(-seen.size // run) * run
    voxels = jnp.nonzero(seen, size=room, fill_value=seen.size)[0].astype(jnp.int32)
    return voxels, jnp.sum(seen), jnp.zeros(room, bool)


@partial(jax.jit, static_argnums=2, donate_argnums=(0, 1))
def _kept(voxels: jax.Array, stays: jax.Array, none: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The listed voxels that stay, at the front, then ``none``; how many there are; and of none that it stays."""
    keep = stays & (voxels < none)
    at = jnp.nonzero(keep, size=voxels.size, fill_value=voxels.size)[0]
    return voxels.at[at].get(mode="fill", fill_value=none), jnp.sum(keep), jnp.zeros_like(stays)


@partial(jax.jit, static_argnums=2)
def _shortened(voxels: jax.Array, stays: jax.Array, room: int) -> tuple[jax.Array, jax.Array]:
    """The first ``room`` of a list."""
    return voxels[:room], stays[:room]


@partial(jax.jit, donate_argnums=0)
def _with_plane(alive: jax.Array, number: jax.Array, voxels: jax.Array) -> jax.Array:
    """``alive`` (nz, ny, nx) with the listed voxels of a plane."""
    plane = jnp.zeros(alive[0].size, bool).at[voxels].set(True, mode="drop")
    return lax.dynamic_update_index_in_dim(alive, plane.reshape(alive.shape[1:]), number, 0)
