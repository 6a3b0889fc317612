"""Discrete window offset on the device: ``displacement.offset`` with its sums in JAX.

The walk of each window to its highest correlation, a few numbers, stays on the host (``offset_kernels.settle``); all
windows of a layer that still move are summed in batches.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.device.correlation_deformation import Planes
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.offset import Offsets
from plenopiv.displacement.offset_kernels import BESIDE, MOVES, STEPS, find_places, settle
from plenopiv.displacement.windows import WindowGrid


def discrete_offset(
    a: Planes,
    b: Planes,
    windows: WindowGrid,
    first: NDArray[np.float64],
    batch: int,
    depth: DepthWeights | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """As ``offset.discrete_offset``; ``batch``: windows at once."""
    offsets = Offsets(windows, first)
    whole = np.rint(offsets.vectors[..., ::-1]).astype(np.int64)
    moving = np.ones(offsets.again.shape, bool)
    tallest = max(hi - lo for lo, hi in offsets.slabs(a.shape[0]))
    for _ in range(MOVES + 1):
        if not moving.any():
            break
        sums = np.full((*moving.shape, 2, BESIDE), np.nan)  # of windows that do not fit
        for layer, (lo, hi) in enumerate(offsets.slabs(a.shape[0])):
            some = np.flatnonzero(moving[layer])
            if not some.size:
                continue
            corners = np.column_stack([np.full(some.size, windows.starts[0][layer] - lo), offsets.corners[some]])
            at, to, fits = find_places(corners, whole[layer, some], np.array(windows.size), (hi - lo, *a.shape[1:]))
            (planes_a, origin), (planes_b, _) = a.slab(lo, tallest), b.slab(lo, tallest)
            if depth is not None:
                by_depth = jnp.asarray(depth.slab(origin, origin + len(planes_a), a.shape[1:]))
                planes_a, planes_b = planes_a * by_depth, planes_b * by_depth
            down = np.array([lo - origin, 0, 0])
            found = [
                _sums(planes_a, planes_b, at[part] + down, to[part] + down, windows.size)
                for part in _batches(np.flatnonzero(fits), batch)
            ]
            of_all = np.concatenate([np.asarray(each, np.float64) for each in found])[: fits.sum()] if found else 0.0
            sums[layer, some[fits]] = of_all
        here = np.nonzero(moving)
        state = whole[here], offsets.vectors[here], offsets.again[here], moving[here]
        settle(sums[here], *state)
        whole[here], offsets.vectors[here], offsets.again[here], moving[here] = state
    return offsets.result()


def _batches(numbers: NDArray[np.int64], batch: int) -> Iterator[NDArray[np.int64]]:
    """So many at a time; the last are made as many by the last one again."""
    for lo in range(0, numbers.size, batch):
        part = numbers[lo : lo + batch]
        yield np.append(part, np.repeat(part[-1:], batch - part.size))


@partial(jax.jit, static_argnames="size")
def _sums(a: jax.Array, b: jax.Array, at: jax.Array, to: jax.Array, size: tuple[int, int, int]) -> jax.Array:
    """Numerator of C and its denominator squared (batch, 2, BESIDE), 0 where the second window is even, of windows of
    ``a`` at ``at`` (batch, 3; z, y, x) with those of ``b`` at ``to`` and beside it (``offset_kernels.add_sums``)."""
    one = jax.vmap(lambda c: jax.lax.dynamic_slice(a, (c[0], c[1], c[2]), size))(at)
    wide = tuple(n + 2 for n in size)
    two = jax.vmap(lambda c: jax.lax.dynamic_slice(b, (c[0], c[1], c[2]), wide))(to - 1)
    one = one - one.mean((1, 2, 3), keepdims=True)

    def beside(step: jax.Array) -> jax.Array:
        near = jax.lax.dynamic_slice(two, (0, 1 + step[0], 1 + step[1], 1 + step[2]), (len(two), *size))
        squares = (near * near).sum((1, 2, 3))
        spread = near - near.mean((1, 2, 3), keepdims=True)  # before the squares: these would cancel in float32
        both = jnp.stack([(one * spread).sum((1, 2, 3)), (spread * spread).sum((1, 2, 3))], -1)
        return jnp.where((both[:, 1] > 1e-6 * squares)[:, None], both, 0.0)

    # one after the other: side by side each would have a window's memory of its own
    return jnp.moveaxis(jax.lax.map(beside, jnp.asarray(STEPS, jnp.int32)), 0, -1)
