"""A plane of voxels spread into its map, and summed from it: convolutions with the plane's outer products, in JAX.

Both are sums of shifted slices, each times a number: what a voxel or a point gets is added up in one order, always the
same, without a library that might choose another. A compiler makes one loop of each pass, which reads and writes a
plane once; on a processor it takes a seventh of the time of products of banded matrices.
"""

from __future__ import annotations

from math import ceil

import jax
import jax.numpy as jnp
from jax import lax

from plenopiv.device.plane_tables import Bucket

PAD = 1, 2  # dark points before and after a map, so that places beside it can be read too


def map_shape(bucket: Bucket, plane: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of the map of a plane (ny, nx), without its dark borders."""
    units = (ceil(n / bucket.voxels) + taps - 1 for n, taps in zip(plane, bucket.taps, strict=True))
    rows, columns = (n * bucket.points for n in units)
    return rows, columns


def spread(bucket: Bucket, plane: jax.Array, down: jax.Array, across: jax.Array) -> jax.Array:
    """The map of a plane (ny, nx) of voxels, with dark borders PAD. ``down``, ``across``: of ``PlaneTable``."""
    voxels, points = bucket.voxels, bucket.points
    rows, columns = (ceil(n / voxels) for n in plane.shape)
    ahead_y, ahead_x = (taps - 1 for taps in bucket.taps)
    wide, high = columns + ahead_x, rows + ahead_y
    lit = jnp.pad(plane, [(0, n * voxels - size) for n, size in zip((rows, columns), plane.shape, strict=True)])
    lit = jnp.moveaxis(lit.reshape(rows * voxels, columns, voxels), 2, 0)
    lit = lax.optimization_barrier(jnp.pad(lit, ((0, 0), (0, 0), (ahead_x, ahead_x))))

    def add(r: jax.Array, light: jax.Array) -> jax.Array:
        of_x, of_y = across[r], down[r]
        line = sum(
            lit[v, :, ahead_x - a : ahead_x - a + wide, None] * of_x[v, a] for v, a in _taps(voxels, ahead_x + 1)
        )
        line = line.reshape(rows, voxels, wide * points)
        line = lax.optimization_barrier(jnp.pad(line, ((ahead_y, ahead_y), (0, 0), (0, 0))))
        return light + sum(
            line[ahead_y - a : ahead_y - a + high, v][:, None] * of_y[v, a, :, None]
            for v, a in _taps(voxels, ahead_y + 1)
        )

    light = lax.fori_loop(0, bucket.ranks, add, jnp.zeros((high, points, wide * points), jnp.float32))
    return jnp.pad(light.reshape(high * points, wide * points), (PAD, PAD))


def _taps(count: int, taps: int) -> list[tuple[int, int]]:
    """(phase, tap) of all terms of a pass."""
    return [(phase, tap) for phase in range(count) for tap in range(taps)]
