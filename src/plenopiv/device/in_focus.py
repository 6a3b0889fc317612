"""Voxels in focus that lie across microlenses, on the device: ``projection.plenoptic.candidates.in_focus``."""

from __future__ import annotations

from functools import partial
from math import cos, sin
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from plenopiv.device.view_places import LensBlock
from plenopiv.lattice import nearest_lens
from plenopiv.projection.plenoptic.projector import PlenopticProjector


class Touched(NamedTuple):
    """A ``plane`` in focus, where borders between microlenses are the same in all views: the ``lenses`` (9, ny, nx)
    that hold points of each voxel, with the ring, which of them come for the first time (``new``), and the voxels that
    touch several (``several``)."""

    plane: int
    lenses: NDArray[np.int32]
    new: NDArray[np.bool_]
    several: NDArray[np.bool_]


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
def judge_together(
    alive: jax.Array,
    plane: jax.Array,
    lenses: jax.Array,
    new: jax.Array,
    several: jax.Array,
    bound: jax.Array,
    counts: jax.Array,
    views: jax.Array,
) -> jax.Array:
    """``judge_together`` there for a plane of ``alive`` (nz, ny, nx)."""

    def by_view(n: jax.Array, stays: jax.Array) -> jax.Array:
        of_view = bound[views[n]]
        return stays & (jnp.sum(jnp.where(new, of_view[lenses], 0.0), 0) >= counts)

    stays = lax.fori_loop(0, views.size, by_view, jnp.ones(alive.shape[1:], bool)) | ~several
    return alive.at[plane].set(alive[plane] & stays)
