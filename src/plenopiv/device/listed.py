"""The voxels of a volume that hold light, listed plane by plane on the device."""

from __future__ import annotations

from functools import partial
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

Grid = tuple[int, int, int]

PART = 16  # of a plane's voxels in a run: a graphics processor works on as many at once
OF_PROCESSOR = 128  # the same on a processor: shorter runs hold fewer voxels that are not there
SHORTEST = 1 << 8  # voxels of a run
SHARE = 0.125  # of all voxels in a list that is planned for, candidates of dense particles


class Listed(NamedTuple):
    """Lists of a volume's voxels in runs of one length: ``voxels`` (runs, length), numbers j nx + i of voxels within
    their plane in rising order, ny nx where there is none; ``start`` (nz + 1,): the first run of each plane."""

    voxels: jax.Array
    start: jax.Array


def run_of(grid: Grid) -> int:
    """The length of runs on the device in use: a power of two."""
    device = jax.config.jax_default_device or jax.devices()[0]
    part = OF_PROCESSOR if device.platform == "cpu" else PART
    return max(SHORTEST, 1 << (grid[1] * grid[2] // part).bit_length())


def listed_shape(grid: Grid, share: float) -> Listed:
    """What holds a ``share`` of the voxels, the same number in each plane, as shapes."""
    runs = _rounded(grid[0] * -(-int(share * grid[1] * grid[2]) // run_of(grid)))
    arrays = (runs, run_of(grid)), (grid[0] + 1,)
    return Listed(*(jax.ShapeDtypeStruct(shape, jnp.int32) for shape in arrays))


def listed(volume: jax.Array, room: int = 0) -> Listed:
    """The voxels of ``volume`` (nz, ny, nx) that are not 0, in a list of ``room`` runs or more if it takes more."""
    length = run_of(volume.shape)
    runs = -(-np.asarray(_count(volume)).astype(np.int64) // length)
    start = np.concatenate([[0], np.cumsum(runs)]).astype(np.int32)
    return Listed(_list(volume, start, (max(room, _rounded(int(start[-1]))), length)), jnp.asarray(start))


def _rounded(runs: int) -> int:
    """As many runs or up to an eighth more, so that lists share programs."""
    step = 1 << max(runs.bit_length() - 4, 0)
    return max(-(-runs // step) * step, 1)


@jax.jit
def _count(volume: jax.Array) -> jax.Array:
    return jnp.sum(volume != 0, (1, 2))


@partial(jax.jit, static_argnums=2)
def _list(volume: jax.Array, start: jax.Array, shape: tuple[int, int]) -> jax.Array:
    nz, ny, nx = volume.shape
    number, room = jnp.arange(ny * nx, dtype=jnp.int32), prod(shape)

    def add(out: jax.Array, k: jax.Array) -> tuple[jax.Array, None]:
        lit = lax.dynamic_index_in_dim(volume, k, keepdims=False).reshape(-1) != 0
        at = start[k] * shape[1] + jnp.cumsum(lit, dtype=jnp.int32) - 1
        at = jnp.where(lit, at, room + number)  # beside the list, each elsewhere
        return out.at[at].set(number, mode="drop", unique_indices=True), None

    out, _ = lax.scan(add, jnp.full(room, ny * nx, jnp.int32), jnp.arange(nz, dtype=jnp.int32))
    return out.reshape(shape)
