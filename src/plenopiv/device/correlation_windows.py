"""Batches of windows on the device: weighted, transformed, correlated; their peaks, and what blocks add to them.

What ``displacement.correlation``, ``peaks`` and ``uncertainty`` do window by window, for a batch at once. The window's
transforms are those of the library (``jnp.fft``). Of a correlation only the neighbourhood of its peak leaves the
device; the fit of the peak, in double precision, is the host's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from plenopiv.device.correlation_agreement import agreement
from plenopiv.displacement.overlap import PLAIN
from plenopiv.displacement.peaks import PEAK_RADIUS
from plenopiv.displacement.window_pass import WindowPass

_EXACT = jax.lax.Precision.HIGHEST  # float32 products of matrices; a graphics processor would take fewer digits
# of 3 x 3 x 3 values in a row: the middle one; its neighbours -z, +z, -y, +y, -x, +x; the order of ``block_sums``
MIDDLE, FACES = 13, (4, 22, 10, 16, 12, 14)
STAR = (MIDDLE, 12, 14, 10, 16, 4, 22)


@dataclass(frozen=True)
class How:
    """What a program for batches is compiled for: ``size`` of a window and ``around``, the period of its transforms,
    both z, y, x; ``radius`` of the search; settings; ``blocks`` of the variance, none where it is not wanted."""

    size: tuple[int, int, int]
    around: tuple[int, int, int]
    radius: tuple[int, int, int]
    whitening: float
    taper: float
    agreement: float
    blocks: tuple[int, int, int] | None

    @classmethod
    def of(cls, windows: WindowPass, scatter: bool) -> How:
        """Of a pass."""
        correlator = windows.correlator
        nz, ny, nx = (int(n) for n in correlator.blocks)
        blocks = (nz, ny, nx) if scatter else None
        about = correlator.whitening, correlator.taper, windows.power, blocks
        return cls(correlator.size, correlator.around, windows.radius, *about)  # type: ignore[arg-type]


class Found(NamedTuple):
    """Of each window of a batch: whether both ``lit`` windows hold more than one value; whether a peak was ``found``;
    the ``ratio`` of the highest to the second highest; ``place`` (x, y, z) of its voxel; ``near`` (3, 3, 3), the
    correlation about it, corrected for overlap; ``sums`` (blocks, 7), ``uncertainty.block_sums`` corrected too, or
    nothing."""

    lit: jax.Array
    found: jax.Array
    ratio: jax.Array
    place: jax.Array
    near: jax.Array
    sums: jax.Array | None


@partial(jax.jit, static_argnames="how")
def correlated(
    a: jax.Array,
    b: jax.Array,
    corners: jax.Array,
    cuts: jax.Array,
    depth: jax.Array,
    filters: tuple[jax.Array, ...],
    powers: jax.Array,
    how: How,
) -> Found:
    """Correlate the windows of ``a`` and ``b`` (planes of a layer) whose first rows and columns are ``corners``
    (batch, 2). ``cuts`` (batch, 3, 2), ``depth`` (batch, nz): as for ``WindowCorrelator.spectra``; ``filters``: its
    factors of the cross spectrum along z, y, x; ``powers``: of the gain (``WindowCorrelator.powers``)."""
    one, two = (windows_at(planes, corners, how.size) for planes in (a, b))
    fades, overlap = fades_and_overlap(cuts, how)
    first, second, lit = spectra(one, two, [fades[0] * depth, *fades[1:]], how)
    cross = jnp.conj(first) * second
    factor = whitened(cross, filters, how)
    near_zero = cropped(jnp.fft.irfftn(cross * factor, how.around, (1, 2, 3)), how.radius)
    gains = [1.0 / share for share in overlap]
    found, ratio, place, near, gain = peaks(near_zero, gains, powers)
    sums = None
    if how.blocks is not None:
        root = jnp.sqrt(factor)
        sums = block_sums(first * root, second * root, place, how)
        sums = sums * gain.reshape(len(lit), 1, 27)[..., STAR]
    return Found(lit, found & lit, jnp.where(lit, ratio, 0.0), place, near, sums)


def windows_at(planes: jax.Array, corners: jax.Array, size: tuple[int, int, int]) -> jax.Array:
    """(batch, nz, ny, nx)."""
    return jax.vmap(lambda c: jax.lax.dynamic_slice(planes, (0, c[0], c[1]), size))(corners)


def fades_and_overlap(cuts: jax.Array, how: How) -> tuple[list[jax.Array], list[jax.Array]]:
    """Along z, y, x: factors of w (batch, n), and C(d) of d = -radius - 1 to radius + 1 (``WindowCorrelator``)."""
    fades, overlap = [], []
    for axis, (n, radius) in enumerate(zip(how.size, how.radius, strict=True)):
        centre = jnp.arange(n, dtype=jnp.float32) + 0.5
        edge = jnp.minimum(centre - cuts[:, axis, :1], n - cuts[:, axis, 1:] - centre)
        w = jnp.sin(jnp.pi / 2 * jnp.clip(edge / how.taper, 0.0, 1.0)) ** 2 if how.taper > 0 else 1.0 * (edge > 0)
        apart = np.abs(np.arange(-radius - 1, radius + 2))
        moved = jnp.pad(w, ((0, 0), (0, radius + 1)))[:, np.arange(n) + apart[:, None]]  # (batch, d, n)
        fades.append(w)
        overlap.append((moved * w[:, None]).sum(-1) / (w * w).sum(-1)[:, None])
    return fades, overlap


def spectra(one: jax.Array, two: jax.Array, fades: list[jax.Array], how: How) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Transforms of both windows, weighted and of zero mean, and which of them hold more than one value."""
    z, y, x = fades
    weight = z[:, :, None, None] * y[:, None, :, None] * x[:, None, None, :]
    if how.agreement:
        weight = weight * agreement(one, two) ** how.agreement
    total, lit = weight.sum((1, 2, 3)) + 1e-30, jnp.ones(len(one), bool)
    out = []
    for windows in (one, two):
        mean = (weight * windows).sum((1, 2, 3)) / total
        out.append(jnp.fft.rfftn((windows - mean[:, None, None, None]) * weight, how.around, (1, 2, 3)))
        lit &= (windows != windows[:, :1, :1, :1]).any((1, 2, 3))
    return out[0], out[1], lit


def whitened(cross: jax.Array, filters: tuple[jax.Array, ...], how: How) -> jax.Array:
    """|S|^-whitening times the filters, for the half of the spectrum that ``rfftn`` leaves."""
    nx = how.around[2]
    of_z, of_y, of_x = filters
    smooth = of_z[:, None, None] * of_y[:, None] * of_x[: nx // 2 + 1]
    if how.whitening == 0:
        return jnp.broadcast_to(smooth, cross.shape)
    strength = jnp.sqrt(cross.real**2 + cross.imag**2)
    k = np.arange(nx // 2 + 1)
    seen = jnp.asarray(np.where((k == 0) | (2 * k == nx), 1.0, 2.0), jnp.float32)  # times in the whole spectrum
    mean = (strength * seen).sum((1, 2, 3), keepdims=True) / np.prod(how.around)
    floor = 1e-3 * mean + 1e-30
    power = jax.lax.rsqrt(strength + floor) if how.whitening == 0.5 else (strength + floor) ** -how.whitening
    return smooth * power


def cropped(correlation: jax.Array, radius: tuple[int, int, int]) -> jax.Array:
    """Displacements -radius - 1 to radius + 1 of a circular correlation along z, y, x."""
    for axis, r in enumerate(radius, 1):
        n = correlation.shape[axis]
        before = jax.lax.slice_in_dim(correlation, n - r - 1, n, axis=axis)
        correlation = jnp.concatenate([before, jax.lax.slice_in_dim(correlation, 0, r + 2, axis=axis)], axis)
    return correlation


def peaks(c: jax.Array, gains: list[jax.Array], powers: jax.Array) -> tuple[jax.Array, ...]:
    """``found``, ``ratio``, ``place`` and ``near`` of correlations (batch, nz, ny, nx), as ``peaks.find_peaks``
    searches them; and the gain in the same 3 x 3 x 3 voxels, raised to its powers."""
    count, sizes = len(c), c.shape[1:]
    inner = c[:, 1:-1, 1:-1, 1:-1]
    highest = jnp.argmax(inner.reshape(count, -1), axis=1)
    at = [index + 1 for index in jnp.unravel_index(highest, inner.shape[1:])]  # z, y, x
    best = inner.reshape(count, -1).max(1)
    away = [
        jnp.abs(jnp.arange(1, n - 1) - index[:, None]).reshape(count, *(-1 if k == axis else 1 for k in range(3)))
        for axis, (n, index) in enumerate(zip(sizes, at, strict=True))
    ]
    far = jnp.maximum(jnp.maximum(away[0], away[1]), away[2]) > PEAK_RADIUS
    second = jnp.where(far, inner, 0.0).max((1, 2, 3))
    around = patches(c, at).reshape(count, -1)[:, FACES]
    found = (best > 0) & (best[:, None] >= around).all(1)
    ratio = jnp.where(best > 0, best / jnp.maximum(second, jnp.maximum(1e-3 * best, 1e-37)), 0.0)
    gains = raised(patches(c, at), gains, powers)
    at = _nearest_top(c, gains, at)
    gain = _gain(gains, at)
    place = jnp.stack([index - n // 2 for index, n in zip(at[::-1], sizes[::-1], strict=True)], -1)
    none = best <= 0
    near = jnp.where(none[:, None, None, None], 0.0, patches(c, at) * gain)
    return found, ratio, jnp.where(none[:, None], 0, place), near, gain


def raised(near: jax.Array, gains: list[jax.Array], powers: jax.Array) -> list[jax.Array]:
    """``peaks.raise_gain``: gains along z, y, x by the curvatures of ``near`` (batch, 3, 3, 3) about peaks."""
    flat, out = near.reshape(len(near), 27), []
    for axis, gain in enumerate(gains):
        left, middle, right = (flat[:, k] for k in (FACES[2 * axis], MIDDLE, FACES[2 * axis + 1]))
        positive = jnp.minimum(jnp.minimum(left, middle), right) > 0
        left, middle, right = (jnp.log(jnp.where(positive, each, 1.0)) for each in (left, middle, right))
        bend = 2 * middle - left - right
        row = powers[2 - axis]
        knots = row.size - PLAIN
        at = jnp.where(bend > 0, (1 / jnp.where(bend > 0, bend, 1.0) - row[0]) * row[1], knots)
        at = jnp.clip(at, 0, knots - 1)
        below = jnp.minimum(at.astype(jnp.int32), knots - 2)
        low, high = row[PLAIN + below], row[PLAIN + below + 1]
        power = jnp.where(positive, low + (at - below) * (high - low), 1.0)
        out.append(gain ** power[:, None])
    return out


def patches(c: jax.Array, at: list[jax.Array]) -> jax.Array:
    """The 3 x 3 x 3 values about places z, y, x of each of a batch."""
    return jax.vmap(lambda own, z, y, x: jax.lax.dynamic_slice(own, (z - 1, y - 1, x - 1), (3, 3, 3)))(c, *at)


def _gain(gains: list[jax.Array], at: list[jax.Array]) -> jax.Array:
    """Products of the gains along z, y, x, (batch, 3, 3, 3)."""
    z, y, x = (
        jax.vmap(lambda own, k: jax.lax.dynamic_slice(own, (k - 1,), (3,)))(gain, index)
        for gain, index in zip(gains, at, strict=True)
    )
    return z[:, :, None, None] * y[:, None, :, None] * x[:, None, None, :]


def _nearest_top(c: jax.Array, gains: list[jax.Array], at: list[jax.Array]) -> list[jax.Array]:
    """The local maximum of the corrected correlation that is reached uphill, within the search radius."""
    steps, sizes = jnp.array([(0, 0, 0), *(np.unravel_index(k, (3, 3, 3)) for k in FACES)]), c.shape[1:]
    steps = steps.at[1:].add(-1)

    def uphill(state: tuple[list[jax.Array], jax.Array, jax.Array]) -> tuple[list[jax.Array], jax.Array, jax.Array]:
        at, _, gone = state
        inside = jnp.ones((len(c), 7), bool)
        for axis, (index, n) in enumerate(zip(at, sizes, strict=True)):
            to = index[:, None] + steps[:, axis]
            inside &= (to > 0) & (to < n - 1)
        values = (patches(c, at) * _gain(gains, at)).reshape(len(c), 27)[:, (MIDDLE, *FACES)]
        best = jnp.argmax(jnp.where(inside, values, -jnp.inf), 1)  # the first of equals, as the host takes it
        return [index + steps[best, axis] for axis, index in enumerate(at)], (best > 0).any(), gone + 1

    start = list(at), jnp.array(True), jnp.array(0)
    return jax.lax.while_loop(lambda state: state[1] & (state[2] < sum(sizes)), uphill, start)[0]


def block_sums(first: jax.Array, second: jax.Array, place: jax.Array, how: How) -> jax.Array:
    """``uncertainty.block_sums`` (batch, blocks, 7) of the windows that the correlation multiplies, given as their
    transforms. The second is moved by ``place`` through the phases of its transform, without rounding of its own."""
    assert how.blocks is not None
    for axis, (n, index) in enumerate(zip(how.around, (2, 1, 0), strict=True)):
        k = jnp.arange(second.shape[1 + axis])
        turn = (2 * jnp.pi / n) * ((k * place[:, index, None]) % n).astype(jnp.float32)
        shape = [len(place), 1, 1, 1]
        shape[1 + axis] = -1
        second = second * jax.lax.complex(jnp.cos(turn), jnp.sin(turn)).reshape(shape)
    a, b = (jnp.fft.irfftn(each, how.around, (1, 2, 3)) for each in (first, second))
    sums = [_sum_of_blocks(a * b, how.blocks)]
    for axis in (3, 2, 1):
        sums.append(_sum_of_blocks(jnp.roll(a, -1, axis) * b, how.blocks))
        sums.append(_sum_of_blocks(a * jnp.roll(b, -1, axis), how.blocks))
    return jnp.stack(sums, -1)


def _sum_of_blocks(values: jax.Array, blocks: tuple[int, int, int]) -> jax.Array:
    """Sums (batch, blocks) over blocks of voxels."""
    for axis, (n, count) in enumerate(zip(values.shape[1:], blocks, strict=True), 1):
        member = jnp.asarray(of_block(n, count))
        values = jnp.moveaxis(jnp.tensordot(values, member, (axis, 0), precision=_EXACT), -1, axis)
    return values.reshape(len(values), -1)


def of_block(n: int, count: int) -> NDArray[np.float32]:
    """(n, count): 1 where a voxel is in a block."""
    return (np.arange(n)[:, None] * count // n == np.arange(count)).astype(np.float32)
