"""The area of a patch of light inside a microlens' cell, in JAX: ``cell_areas`` and ``pixel_weights.patch_area``."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from plenopiv.projection.plenoptic.cell_areas import BEND, HALF, ROOT3, TIP
from plenopiv.projection.plenoptic.geometry import Plane


def in_plane(constants: jax.Array) -> Plane:
    """Row of ``geometry.planes`` as scalars on the device."""
    return Plane(*(constants[k] for k in range(len(Plane._fields))))


def patch_area(
    hexagonal: bool, turn: jax.Array, x: jax.Array, y: jax.Array, half_x: jax.Array, half_y: jax.Array
) -> jax.Array:
    """``pixel_weights.patch_area``: of rectangles of light centred at (x, y) cells inside a microlens' cell."""
    high = TIP if hexagonal else HALF
    across = 0.5 * (jnp.maximum(y - half_y, -high) + jnp.minimum(y + half_y, high)) - y
    along = 0.5 * (jnp.maximum(x - half_x, -HALF) + jnp.minimum(x + half_x, HALF)) - x
    x, y = x + turn * across, y - turn * along
    x1, x2 = (jnp.clip(x + side, -HALF, HALF) for side in (-half_x, half_x))
    y1, y2 = (jnp.clip(y + side, -high, high) for side in (-half_y, half_y))
    area = (x2 - x1) * (y2 - y1)
    if not hexagonal:
        return area
    return jnp.maximum(area - (_corner(x2, y2) - _corner(x1, y2) - _corner(x2, y1) + _corner(x1, y1)), 0.0)


def _corner(x: jax.Array, y: jax.Array) -> jax.Array:
    """``cell_areas.corner``."""
    beyond = jnp.maximum(jnp.abs(x) + ROOT3 * jnp.abs(y) - 1.0, 0.0)
    cut = BEND * beyond * beyond
    return jnp.where(x * y >= 0, cut, -cut)
