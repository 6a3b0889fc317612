"""Listed voxels ask the microlenses about them for what their pixels give back: the transpose of reading off maps.

Light of pixel q under the microlens at S is centred at  x = x0 + a S + b q  on a plane's map, so that a microlens may
light a voxel only if S is within (half the width of the voxel's weights plus |b| times half the range of q)/|a| of
where the voxel's own S would be, a window of a few microlenses. The places themselves are those that forward reads at,
and the weights are those by which it does. No two sums meet in one place, so that nothing waits for anything, and
nothing depends on the order in which threads arrive.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from plenopiv.device.form import Update
from plenopiv.device.listed import Listed
from plenopiv.device.view_places import LensBlock, LensTable, Pixels, footprints, lens_of, near
from plenopiv.device.voxel_tables import BEFORE, BEHIND, Asking, VoxelTable

WRITTEN_OUT = 32  # microlenses about a voxel whose sum is written out, as one loop; more take as long to compile


class _Voxels(NamedTuple):
    """Some voxels of a plane: their first point on its map, number ``x`` and ``y``; where their table of weights begins
    (``table``); and the point in the middle of their weights."""

    x: jax.Array
    y: jax.Array
    table: jax.Array
    middle_x: jax.Array
    middle_y: jax.Array


def corrected(
    asking: Asking,
    planes: VoxelTable,
    block: LensBlock,
    lenses: LensTable,
    pixels: Pixels,
    images: jax.Array,
    listed: Listed,
    volume: jax.Array,
    update: Update,
) -> jax.Array:
    """``volume`` (nz, ny, nx) with the ``listed`` voxels of the planes of a bucket replaced by ``update(voxels,
    total)``: of each the sum of ``images`` (views, lens) over the pixels that it lights, by weights. ``planes``: of the
    variant in use."""
    nz, ny, nx = volume.shape
    length = listed.voxels.shape[1]

    def of_plane(volume: jax.Array, plane: VoxelTable) -> tuple[jax.Array, None]:
        plane = VoxelTable._make(lax.optimization_barrier(tuple(plane)))
        x, y, lit = footprints(plane.place, plane.off, pixels)
        of_lens = lax.optimization_barrier((x, y, lit * images))

        def of_run(run: jax.Array, volume: jax.Array) -> jax.Array:
            number = lax.dynamic_index_in_dim(listed.voxels, run, keepdims=False)
            voxels = lax.optimization_barrier(_voxels(plane, number, nx))
            total = jnp.zeros(length, jnp.float32)
            about = asking, plane, block, lenses, pixels, of_lens, voxels
            total = lax.fori_loop(0, images.shape[0], partial(_of_view, *about), total)
            beside = jnp.arange(length, dtype=jnp.int32)  # the plane, each elsewhere
            number += jnp.where(number < ny * nx, 0, beside)
            at = volume.at[plane.number, number]
            after = update(at.get(mode="fill", fill_value=0), total)
            return at.set(after, mode="drop", indices_are_sorted=True, unique_indices=True)

        first, last = listed.start[plane.number], listed.start[plane.number + 1]
        return lax.fori_loop(first, last, of_run, volume), None

    flat, _ = lax.scan(of_plane, volume.reshape(nz, ny * nx), planes)
    return flat.reshape(volume.shape)


def _voxels(plane: VoxelTable, number: jax.Array, nx: int) -> _Voxels:
    j, i = number // nx, number % nx
    between = (1 << plane.shift) - 1
    at_y, at_x = j & between, i & between
    x, y = (i >> plane.shift) * plane.points, (j >> plane.shift) * plane.points
    table = (at_y * (between + 1) + at_x) * plane.size[0] * plane.size[1]
    x, y = x.astype(jnp.float32), y.astype(jnp.float32)
    return _Voxels(x, y, table, x + 1.0 + plane.centre[1][at_x], y + 1.0 + plane.centre[0][at_y])


def _of_view(
    asking: Asking,
    plane: VoxelTable,
    block: LensBlock,
    lenses: LensTable,
    pixels: Pixels,
    of_lens: tuple[jax.Array, jax.Array, jax.Array],
    voxels: _Voxels,
    n: jax.Array,
    total: jax.Array,
) -> jax.Array:
    """``total`` and what view ``n`` has for each voxel."""
    (x0, xs, xq, y0, ys, yq), (mx, my) = plane.place, pixels.middle[n]
    s, t = (voxels.middle_x - x0 - xq * mx) / xs, (voxels.middle_y - y0 - yq * my) / ys
    moved = None if pixels.moved is None else pixels.moved[n % pixels.moved.shape[0]]
    about = near(block, lenses, s, t, plane.reach[0], moved)
    of_view = lax.optimization_barrier(tuple(each[n] for each in of_lens))
    ends = (plane.size - BEHIND).astype(jnp.float32)  # of what is read of a table, along y and x
    weights, steps = jnp.asarray(plane.weights), (0, 1, plane.size[1], plane.size[1] + 1)

    def ask(row: int | jax.Array, along: int, total: jax.Array) -> jax.Array:
        lens = lens_of(block, lenses, about, row, along, plane.reach[1])
        x, y, light = (each.at[lens].get(mode="promise_in_bounds") for each in of_view)
        x = jnp.clip(x - voxels.x + (BEFORE - 1.0), 0.0, ends[1])
        y = jnp.clip(y - voxels.y + (BEFORE - 1.0), 0.0, ends[0])
        i, j = x.astype(jnp.int32), y.astype(jnp.int32)
        at, beyond_x, beyond_y = voxels.table + j * plane.size[1] + i, x - i, y - j
        one, two, three, four = (weights.at[at + step].get(mode="promise_in_bounds") for step in steps)
        above, below = one + beyond_x * (two - one), three + beyond_x * (four - three)
        return total + light * (above + beyond_y * (below - above))

    def ask_row(row: int | jax.Array, total: jax.Array) -> jax.Array:
        for along in range(asking.window[1]):
            total = ask(row, along, total)
        return total

    if row_by_row(asking):
        return lax.fori_loop(0, asking.window[0], ask_row, total)
    for row in range(asking.window[0]):
        total = ask_row(row, total)
    return total


def row_by_row(asking: Asking) -> bool:
    """Whether a program goes through rows of microlenses, and voxels' sums through memory after each."""
    return asking.window[0] * asking.window[1] > WRITTEN_OUT
