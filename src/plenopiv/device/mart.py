"""MART on the device: ``reconstruction.mart`` with dense volumes, which stay there.

The same groups of views in the same random order, the same exponents, floors, saturated pixels and thinning; a voxel
that is left out has the value 0, and stays at it. Those that hold light are listed, and listed anew when thinning has
left so many fewer. Only their number comes back from the device between the first group of views and the last:
residuals stay there until the end.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.device.form import Form
from plenopiv.reconstruction.mart import THIN_EVERY, TOGETHER, Progress

RELISTED = 0.85  # of the voxels of a list, that may be left before the next one is made


class Frame(NamedTuple):
    """One frame on the device, (view, pixel) each: ``values`` in counts, where there is an equation (``seen``), pixels
    that are ``full`` or None, and ``floor``, or one number of it."""

    values: jax.Array
    seen: jax.Array
    full: jax.Array | None
    floor: jax.Array


def mart(
    frame: Frame,
    form: Form,
    tables: Any,
    volume: jax.Array,
    *,
    iterations: int,
    relaxation: float,
    thin: float = 0.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[jax.Array, list[float]]:
    """The volume (nz, ny, nx) whose views are those of ``frame``, from ``volume``, whose memory it takes; 0 where no
    voxel is. Arguments and residuals as of ``reconstruction.mart.mart``."""
    rng, total = np.random.default_rng(seed), frame.values.shape[0]
    lit, squares = _lit(volume), list[list[jax.Array]]()
    listed, count = form.listed(volume), int(np.asarray(lit).sum())
    for done, (power, together) in enumerate(exponents(iterations, relaxation, total)):
        order, used = rng.permutation(total), 0
        squares.append([])
        while used < total:
            views = order[used : used + together]
            with jax.enable_x64(form.double):
                group = *_padded(views, together), np.float32(power)
                volume, left = correct_views(form, tables, frame, volume, listed, *group)
            squares[-1].append(left)
            before, used = used, used + views.size
            if used // THIN_EVERY > before // THIN_EVERY and done < max(iterations - 1, 1):
                volume, lit = _thinned(volume, lit, np.float32(thin * min(done + used / total, 1.0)))
                if (left_over := int(np.asarray(lit).sum())) < RELISTED * count:
                    listed, count = form.listed(volume, listed), left_over
            if progress:
                progress(done * total + used, iterations * total)
    equations = max(int(np.asarray(frame.seen.sum())), 1)
    residuals = [float((np.sum(np.asarray(each, np.float64)) / equations) ** 0.5) for each in squares]
    return volume, residuals


def exponents(iterations: int, relaxation: float, views: int) -> list[tuple[float, int]]:
    """Of each iteration the exponent, and how many of so many views correct the volume at once, as ``mart`` has
    them."""
    powers = [min(relaxation * (2 if done == 0 else 1), 1.0) for done in range(iterations)]
    return [(power, min(TOGETHER, int(2 / power + 1e-6), views) if power < 1 else 1) for power in powers]


def _padded(views: NDArray[np.int64], together: int) -> tuple[NDArray[np.int32], np.int32]:
    """So many views, the last ones of which are none where there are fewer; and how many there are."""
    out = np.zeros(together, np.int32)
    out[: views.size] = views
    return out, np.int32(views.size)


@partial(jax.jit, static_argnums=0, donate_argnums=3)
def correct_views(
    form: Form,
    tables: Any,
    frame: Frame,
    volume: jax.Array,
    listed: Any,
    views: jax.Array,
    count: jax.Array,
    power: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """The volume, its ``listed`` voxels corrected by the first ``count`` of ``views`` at once, and the sum of squares
    of what was missing."""
    is_one = (jnp.arange(views.size) < count)[:, None]
    light = jnp.maximum(form.forward(tables, views, volume), 0.0)
    values, seen = frame.values[views], frame.seen[views] & is_one
    floor = frame.floor[views] if frame.floor.ndim else frame.floor
    ratio, missing = (jnp.maximum(values, 0.0) + floor) / (light + floor), values - light
    if frame.full is not None:
        full = frame.full[views]
        ratio = jnp.where(full, jnp.maximum(ratio, 1.0), ratio)
        missing = jnp.where(full, jnp.maximum(missing, 0.0), missing)
    corrections = jnp.where(seen, ratio**power - 1.0, 0.0)
    update = partial(_multiplied, count=count, most=views.size)
    return form.back(tables, views, corrections, volume, listed, update), jnp.sum(jnp.where(seen, missing, 0.0) ** 2)


def _multiplied(values: jax.Array, total: jax.Array, count: jax.Array, most: int) -> jax.Array:
    """Voxels times ``correction.factor_of`` their ``total`` for ``count`` views, ``most`` at the most."""
    each = jnp.maximum(1.0 + total / count.astype(jnp.float32), 0.0)
    less = each
    for n in range(1, most):
        less = jnp.where(n < count, less * each, less)
    return values * jnp.where(total >= 0, 1.0 + total, less)


@jax.jit
def _lit(volume: jax.Array) -> jax.Array:
    """How many voxels are not 0, plane by plane."""
    return jnp.sum(volume > 0, (1, 2))


@partial(jax.jit, donate_argnums=0)
def _thinned(volume: jax.Array, listed: jax.Array, share: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Without voxels of no more than ``share`` of the mean of those ``listed``, and which are listed then."""
    mean = jnp.sum(jnp.sum(volume, 2), (0, 1)) / jnp.maximum(jnp.sum(listed.astype(jnp.float32)), 1.0)
    keep = volume > share * mean
    return jnp.where(keep, volume, 0.0), jnp.sum(keep, (1, 2))
