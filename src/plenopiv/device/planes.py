"""A plane of voxels spread into its map, and views read off it, in JAX.

A point of the map is the sum of the voxels about it by their weights: shifted slices, each times a number, added up in
one order, always the same, without a library that might choose another. A compiler makes one loop of it, which reads
the plane and writes the map once. A map is kept by *phases*: all points at the first place between voxels, then all at
the second, and so on, as each phase has weights of its own.
"""

from __future__ import annotations

from math import ceil, prod

import jax
import jax.numpy as jnp
from jax import lax

from plenopiv.device.plane_tables import Bucket

BEFORE, BEHIND = 1, 2  # dark units around a map, so that places beside it can be read too
WRITTEN_OUT = 150  # taps whose sum is written out as one loop; more take long to compile


def map_units(bucket: Bucket, plane: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns of units of the map of a plane (ny, nx), without dark ones."""
    rows, columns = (ceil(n / bucket.voxels) + taps - 1 for n, taps in zip(plane, bucket.taps, strict=True))
    return rows, columns


def spread(bucket: Bucket, planes: jax.Array, weights: jax.Array) -> jax.Array:
    """The map of planes (members, ny, nx) of voxels that share it, (phases, rows, columns) of units with dark borders.
    ``weights``: of ``PlaneTable``, of one group."""
    voxels, count = bucket.voxels, bucket.members * bucket.voxels**2
    high, wide = (n + BEFORE + BEHIND for n in map_units(bucket, planes.shape[1:]))
    rows, columns = (ceil(n / voxels) for n in planes.shape[1:])
    more = [(0, n * voxels - size) for n, size in zip((rows, columns), planes.shape[1:], strict=True)]
    lit = jnp.pad(planes, ((0, 0), *more)).reshape(-1, rows, voxels, columns, voxels)
    lit = lit.transpose(0, 2, 4, 1, 3).reshape(count, rows, columns)
    dark = [(taps - 1 + BEFORE, taps - 1 + BEHIND) for taps in bucket.taps]
    lit = lax.optimization_barrier(jnp.pad(lit, ((0, 0), *dark)))
    weights = jnp.moveaxis(weights.reshape(count, *weights.shape[2:]), 1, 0)

    if weights.shape[:2] == (1, 1):
        return _in_halves(lit[0], weights[0, 0], (high, wide))[None]

    def of_phase(weights: jax.Array) -> jax.Array:
        if count == 1:
            return _convolved(lit[0], weights[0], (high, wide))

        def add(n: jax.Array, light: jax.Array) -> jax.Array:
            of_place, by = lax.optimization_barrier((lit[n], weights[n]))
            return light + _convolved(of_place, by, (high, wide))

        return lax.fori_loop(0, count, add, jnp.zeros((high, wide), jnp.float32))

    return lax.map(of_phase, weights)


def _in_halves(lit: jax.Array, weights: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """``_convolved``, upper and lower rows one after the other, of an odd number one dark row more. What is done once
    is no loop to the compiler, which then sums all taps anew for each point that a pixel reads."""
    (high, wide), down = shape, weights.shape[0]
    half = ceil(high / 2)
    lit = jnp.pad(lit, ((0, 2 * half - high), (0, 0)))

    def of_half(first: jax.Array) -> jax.Array:
        rows = lax.optimization_barrier(lax.dynamic_slice_in_dim(lit, first, half + down - 1))
        return _convolved(rows, weights, (half, wide))

    return lax.map(of_half, jnp.array([0, half])).reshape(2 * half, wide)


def _convolved(lit: jax.Array, weights: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """The sum of ``lit`` shifted by so many units, each by its weight (taps along y, along x)."""
    high, wide = shape
    down, across = weights.shape

    def of_row(rows: jax.Array, weights: jax.Array) -> jax.Array:
        return sum(rows[:, across - 1 - a :][:, :wide] * weights[a] for a in range(across))

    if prod(weights.shape) <= WRITTEN_OUT:
        return sum(of_row(lit[down - 1 - a :][:high], weights[a]) for a in range(down))
    return lax.fori_loop(
        0,
        down,
        lambda a, light: light + of_row(lax.dynamic_slice_in_dim(lit, down - 1 - a, high), weights[a]),
        jnp.zeros(shape, jnp.float32),
    )


def read(bucket: Bucket, light: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """A map of ``spread`` at places (views, lens), points of columns and rows, the first of which is number 1, between
    points linearly; 0 beside the map."""
    points, (_, high, wide) = bucket.points, light.shape
    rows, columns = ((n - BEFORE - BEHIND) * points for n in (high, wide))
    x, y = jnp.clip(x, 0.0, columns + 1.0), jnp.clip(y, 0.0, rows + 1.0)
    i, j = x.astype(jnp.int32), y.astype(jnp.int32)
    beyond_x, beyond_y, flat = x - i, y - j, light.reshape(-1)
    i, j = i + (BEFORE * points - 1), j + (BEFORE * points - 1)  # from the first dark point on
    of_row = [(n % points) * (points * high * wide) + (n // points) * wide for n in (j, j + 1)]
    of_column = [(n % points) * (high * wide) + n // points for n in (i, i + 1)]
    one, two, three, four = (
        flat.at[row + column].get(mode="promise_in_bounds") for row in of_row for column in of_column
    )
    above, below = one + beyond_x * (two - one), three + beyond_x * (four - three)
    return above + beyond_y * (below - above)
