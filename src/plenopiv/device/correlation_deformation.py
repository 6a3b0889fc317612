"""Planes of a volume on the device, deformed by a displacement field: ``displacement.deformation`` in JAX.

The same cubic B-spline without prefilter, every voxel sampled: 64 reads of the source, most of which a processor's
cache holds. Displacements are summed from the predictor's coefficients where they are needed and never stored for more
than the planes that are made at once.
"""

from __future__ import annotations

from functools import partial
from math import ceil

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.compression import BESIDE, CompressedVolume
from plenopiv.displacement.predictor import SplineField
from plenopiv.volume import SparseVolume, Volume

_LISTED = 1 << 20  # listed voxels that go to the device at once
_REACH = 4  # planes: reaches are rounded up, so that passes of like windows share one program


class Planes:
    """The planes of a volume, as the device takes them: all of them ``resident`` in its memory, or uploaded as they are
    asked for."""

    def __init__(self, volume: Volume, resident: bool) -> None:
        self.volume, self.shape = volume, volume.grid.shape
        self._dense = planes_on_device(volume, 0, self.shape[0]) if resident else None

    def slab(self, lo: int, count: int) -> tuple[jax.Array, int]:
        """``count`` planes (or all, if there are fewer) that hold those of the volume from ``lo`` on, and the number of
        the first one."""
        nz = self.shape[0]
        count = min(count, nz)
        first = min(max(lo, 0), nz - count)
        if self._dense is None:
            return planes_on_device(self.volume, first, first + count), first
        return (self._dense if count == nz else _some(self._dense, first, count)), first


def planes_on_device(volume: Volume, lo: int, hi: int) -> jax.Array:
    """Planes lo <= k < hi of a volume, float32 (hi - lo, ny, nx), on the device. Of a sparse volume the list alone is
    sent; what is correlated is compressed there."""
    _, ny, nx = volume.grid.shape
    if isinstance(volume, CompressedVolume):
        return _compressed(planes_on_device(volume.volume, lo, hi), volume.exponent, np.float32(volume.factor))
    if not isinstance(volume, SparseVolume):
        return jnp.asarray(volume.slab(lo, hi))
    out = jnp.zeros((hi - lo, ny * nx), jnp.float32)
    group = max(1, min(hi - lo, (1 << 30) // (ny * nx)))  # planes: places in them are 32-bit numbers
    for first in range(lo, hi, group):
        last = min(first + group, hi)
        start = volume.row_start[first * ny : last * ny + 1]
        for begin in range(int(start[0]), int(start[-1]), _LISTED):
            end = min(begin + _LISTED, int(start[-1]))
            row = np.searchsorted(start, np.arange(begin, end), "right") - 1
            place = np.full(_LISTED, np.iinfo(np.int32).max, np.int32)  # beyond the end: left out
            place[: end - begin] = row * nx + volume.column[begin:end]
            light = np.zeros(_LISTED, np.float32)
            light[: end - begin] = volume.values[begin:end]
            out = _placed(out, first - lo, place, light, last - first)
    return out.reshape(hi - lo, ny, nx)


@partial(jax.jit, static_argnums=1, donate_argnums=0)
def _compressed(dense: jax.Array, exponent: float, factor: jax.Array) -> jax.Array:
    """``CompressedVolume.slab`` of all planes, one after the other in their own place."""

    def blended(values: jax.Array, axis: int) -> jax.Array:
        n = values.shape[axis]
        first, last = (jax.lax.slice_in_dim(values, k, k + 1, axis=axis) for k in (0, n - 1))
        before = jnp.concatenate([first, jax.lax.slice_in_dim(values, 0, n - 1, axis=axis)], axis)
        after = jnp.concatenate([jax.lax.slice_in_dim(values, 1, n, axis=axis), last], axis)
        return (1 - 2 * BESIDE) * values + BESIDE * (before + after)

    def one(k: jax.Array, dense: jax.Array) -> jax.Array:
        plane = dense[k]
        if exponent != 1.0:
            plane = blended(blended(jnp.maximum(plane, 0.0), 1), 0)
            plane = jnp.sqrt(plane) if exponent == 0.5 else plane**exponent
        return dense.at[k].set(plane * factor)

    return jax.lax.fori_loop(0, dense.shape[0], one, dense)


@partial(jax.jit, static_argnames="count", donate_argnums=0)
def _placed(dense: jax.Array, lo: int, place: jax.Array, light: jax.Array, count: int) -> jax.Array:
    """Write ``light`` into ``count`` planes (planes, voxels) from ``lo`` on; no place comes twice."""
    part = jax.lax.dynamic_slice(dense, (lo, 0), (count, dense.shape[1]))
    flat = part.reshape(-1).at[place].set(light, mode="drop", unique_indices=True)
    return jax.lax.dynamic_update_slice(dense, flat.reshape(part.shape), (lo, 0))


@partial(jax.jit, static_argnames="count")
def _some(dense: jax.Array, first: int, count: int) -> jax.Array:
    return jax.lax.dynamic_slice(dense, (first, 0, 0), (count, *dense.shape[1:]))


class Deformed:
    """Windows' planes of one volume of a pair, layer after layer: planes that two layers share are made once.

    ``share``: -0.5 of the displacement for the first volume, 0.5 for the second; ``predictor`` None: planes as they are
    (``DeformedPlanes``). ``depth``, ``step``: of the windows along z.
    """

    def __init__(self, planes: Planes, predictor: SplineField | None, share: float, depth: int, step: int) -> None:
        self.planes, self.share, self.depth, self.step = planes, share, depth, step
        self.reach, self._taps = 0, None
        _, ny, nx = planes.shape
        if predictor is not None:
            farthest = abs(share) * float(np.abs(predictor.coefficients[2]).max())
            self.reach = -(-(ceil(farthest) + 3) // _REACH) * _REACH
            y, x = predictor.taps(1, np.arange(ny)), predictor.taps(2, np.arange(nx))
            self._taps = tuple(jnp.asarray(v) for v in (predictor.coefficients, *_narrow(y), *_narrow(x)))
        self._predictor = predictor
        self._end: int | None = None  # of the planes held
        self._held = jnp.zeros((depth, ny, nx), jnp.float32)

    @property
    def source_planes(self) -> int:
        """Planes of the source that are read at once."""
        return min(self.step + 2 * self.reach, self.planes.shape[0])

    def layer(self, start: int) -> jax.Array:
        """The planes ``start`` to ``start`` + depth; each call a step further than the one before."""
        end = start + self.depth
        first = end - ceil(self.depth / self.step) * self.step if self._end is None else self._end
        for made in range(first, end, self.step):
            self._advance(made)
        self._end = end
        return self._held

    def _advance(self, first: int) -> None:
        source, origin = self.planes.slab(first - self.reach, self.step + 2 * self.reach)
        if self._predictor is None or self._taps is None:
            self._held = _shifted(self._held, source, first - origin, self.step)
            return
        along_z = _narrow(self._predictor.taps(0, np.arange(first, first + self.step)))
        self._held = _deformed(self._held, source, first - origin, *along_z, *self._taps, self.share)


def _narrow(taps: tuple[NDArray[np.int64], NDArray[np.float32]]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    return taps[0].astype(np.int32), taps[1]


@partial(jax.jit, static_argnames="step", donate_argnums=0)
def _shifted(held: jax.Array, source: jax.Array, first: int, step: int) -> jax.Array:
    """``held``, its first ``step`` planes gone, those of the source from ``first`` on behind it; 0 outside it."""
    place = first + jnp.arange(step)
    inside = (place >= 0) & (place < source.shape[0])
    more = jnp.take(source, jnp.clip(place, 0, source.shape[0] - 1), axis=0)
    return jnp.concatenate([held[step:], jnp.where(inside[:, None, None], more, 0.0)])


@partial(jax.jit, donate_argnums=0)
def _deformed(
    held: jax.Array,
    source: jax.Array,
    first: int,
    first_z: jax.Array,
    weights_z: jax.Array,
    coefficients: jax.Array,
    first_y: jax.Array,
    weights_y: jax.Array,
    first_x: jax.Array,
    weights_x: jax.Array,
    share: float,
) -> jax.Array:
    """The same with deformed planes: source voxels ``first`` + k + d_z, j + d_y, i + d_x, by the cubic B-spline. One
    plane after the other, which has work enough: places and weights of all would take far more memory than they."""

    def made(plane: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        k, begin, weights = plane
        at = _expanded(coefficients, 1, begin[None], weights[None])
        at = _expanded(_expanded(at, 3, first_x, weights_x), 2, first_y, weights_y)
        return sampled(source, first + k, share * at)[0]

    more = jax.lax.map(made, (jnp.arange(first_z.size), first_z, weights_z))
    return jnp.concatenate([held[first_z.size :], more])


def _expanded(values: jax.Array, axis: int, first: jax.Array, weights: jax.Array) -> jax.Array:
    """Coefficients to values along an axis: four weighted ones each."""
    shape = [1] * values.ndim
    shape[axis] = -1
    total = jnp.zeros((), jnp.float32)
    for tap in range(4):
        total = total + weights[:, tap].reshape(shape) * jnp.take(values, first + tap, axis=axis)
    return total


def sampled(source: jax.Array, first: int | jax.Array, moved: jax.Array) -> jax.Array:
    """Planes (n, ny, nx) of which voxel k, j, i is the ``source`` at ``first`` + k, j, i plus ``moved`` (3, n, ny, nx),
    x, y, z; 0 where its neighbours lie outside the source."""
    _, planes, ny, nx = moved.shape
    whole = jnp.floor(moved)
    # whole and fractional parts apart: a float32 of the position itself would lose digits in large volumes
    weights, places = [], []
    for axis, (index, size) in enumerate(((2, source.shape[0]), (1, ny), (0, nx))):
        shape = [1, 1, 1]
        shape[axis] = -1
        own = jnp.arange(moved.shape[1 + axis], dtype=jnp.int32).reshape(shape) + whole[index].astype(jnp.int32) - 1
        own = own + first if axis == 0 else own
        inside = [(own + tap >= 0) & (own + tap < size) for tap in range(4)]
        four = cubic_weights(moved[index] - whole[index])
        weights.append([jnp.where(held, weight, 0.0) for held, weight in zip(inside, four, strict=True)])
        places.append([jnp.clip(own + tap, 0, size - 1) for tap in range(4)])
    flat = source.reshape(-1)
    total = jnp.zeros((planes, ny, nx), jnp.float32)
    for z, of_z in zip(places[0], weights[0], strict=True):
        for y, of_y in zip(places[1], weights[1], strict=True):
            row, along = (z * ny + y) * nx, jnp.zeros((), jnp.float32)
            for x, of_x in zip(places[2], weights[2], strict=True):
                along = along + of_x * flat.at[row + x].get(mode="promise_in_bounds")
            total = total + of_z * of_y * along
    return total


def cubic_weights(t: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The uniform cubic B-spline at the fractions ``t``."""
    u = 1.0 - t
    return (
        u * u * u / 6.0,
        2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
        2.0 / 3.0 - u * u * (1.0 - 0.5 * u),
        t * t * t / 6.0,
    )
