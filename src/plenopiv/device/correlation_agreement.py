"""``displacement.agreement`` in JAX: weights where both windows show the same particles."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.agreement import FLOOR, centres, starts

_EXACT = jax.lax.Precision.HIGHEST


def agreement(a: jax.Array, b: jax.Array) -> jax.Array:
    """q for windows ``a``, ``b`` (batch, nz, ny, nx) of light >= 0, in the same shape."""
    size = a.shape[1:]
    for axis, n in enumerate(size, 1):
        a, b = (_along(_cells(n), v, axis) for v in (a, b))
    common, either = a * b, 0.5 * (a * a + b * b)
    for axis in (1, 2, 3):
        common, either = (_along(_neighbours(v.shape[axis]), v, axis) for v in (common, either))
    q = jnp.maximum(common, 0.0) / (either + FLOOR * either.mean((1, 2, 3), keepdims=True) + 1e-30)
    for axis, n in enumerate(size, 1):
        q = _along(_shares(n), q, axis)
    return q


def _along(matrix: NDArray[np.float32], values: jax.Array, axis: int) -> jax.Array:
    """A matrix (out, in) applied along an axis."""
    return jnp.moveaxis(jnp.tensordot(jnp.asarray(matrix), values, (1, axis), precision=_EXACT), 0, axis)


def _cells(n: int) -> NDArray[np.float32]:
    """(cells, n): 1 where a voxel is in a cell."""
    first = starts(n)
    which = np.searchsorted(first, np.arange(n), "right") - 1
    return (which == np.arange(first.size)[:, None]).astype(np.float32)


def _shares(n: int) -> NDArray[np.float32]:
    """(n, cells): of the cells in a voxel's value, linear between their centres."""
    at = centres(n)
    return np.stack([np.interp(np.arange(n), at, of_cell) for of_cell in np.eye(at.size)], -1).astype(np.float32)


def _neighbours(n: int) -> NDArray[np.float32]:
    """1 : 2 : 1, the outermost cells twice."""
    out = 0.5 * np.eye(n)
    for k in range(n):
        out[k, max(k - 1, 0)] += 0.25
        out[k, min(k + 1, n - 1)] += 0.25
    return out.astype(np.float32)
