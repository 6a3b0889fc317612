"""The pixels of views on the device, where their footprints are centred in a plane, and the microlenses about a place.

The same numbers as ``plane_maps.view_pixels`` and ``placing`` compute, for all microlenses of a view at once. Lenses
are kept with a ring of lenses around them that are no equations, so that a window of lenses may be cut off at the ring:
``lens`` below counts those too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from plenopiv.cameras.space_map import PLACE_POWERS
from plenopiv.projection.plenoptic.plane_maps.view_pixels import GAUSS


class LensTable(NamedTuple):
    """What the device knows of a camera's layout of pixels.

    ``s``, ``t`` (lens,): centres of the microlenses, mm; ``phase`` (2, lens) px. Of each view: ``offset`` (view, 2);
    ``rim`` (view,), whether the aperture's rim cuts pixels; ``middle`` (view, 2), the middle of what q of its pixels
    ranges over, px. ``light`` (view, lens): what the main lens' rim leaves, or None. ``shifts`` (view, terms, 2): of
    ``CameraOnGrid``, or None. ``regular`` (2, lens): s and t on the regular lattice, or None where lenses are there.
    ``radius``: of the aperture, px. ``ends`` (2,): A of the first plane and of the last. ``from_mm`` (2, 3):
    microlenses along the rows, and rows, of a point (s, t, 1), from lens (0, 0) of the block on, on the regular
    lattice. ``odd``: 1 where the block's first row is shifted by half a pitch."""

    s: jax.Array
    t: jax.Array
    phase: jax.Array
    offset: jax.Array
    rim: jax.Array
    middle: jax.Array
    light: jax.Array | None
    shifts: jax.Array | None
    regular: jax.Array | None
    radius: jax.Array
    ends: jax.Array
    from_mm: jax.Array
    odd: jax.Array


@dataclass(frozen=True)
class LensBlock:
    """Rows ``nj`` of ``ni`` microlenses; ``hexagonal``: odd rows are shifted by half a pitch."""

    ni: int
    nj: int
    hexagonal: bool

    @property
    def size(self) -> int:
        """With the ring."""
        return (self.ni + 2) * (self.nj + 2)

    @property
    def count(self) -> int:
        """Without the ring."""
        return self.ni * self.nj

    def ringed(self, values: np.ndarray) -> np.ndarray:
        """Values (..., lens) of the block with 0 in the ring."""
        block = np.reshape(values, (*np.shape(values)[:-1], self.nj, self.ni))
        rings = [(0, 0)] * (block.ndim - 2) + [(1, 1), (1, 1)]
        return np.pad(block, rings).reshape(*np.shape(values)[:-1], self.size)

    def inner(self, values: np.ndarray) -> np.ndarray:
        """Values (..., lens) without those of the ring."""
        block = np.reshape(values, (*np.shape(values)[:-1], self.nj + 2, self.ni + 2))[..., 1:-1, 1:-1]
        return block.reshape(*np.shape(values)[:-1], self.count)


class Pixels(NamedTuple):
    """The pixels of some views, (views, lens) each: q along x and y and lit share in the first plane, and the change of
    these per unit of A, as in ``view_pixels``. ``s``, ``t`` (views or 1, lens): where the microlenses are seen.
    ``moved`` (views or 1, 2, lens): how far they are from the regular lattice, along the rows in microlenses and across
    in rows, or None. ``middle`` (views, 2): of ``LensTable``."""

    qx: jax.Array
    qy: jax.Array
    lit: jax.Array
    dqx: jax.Array
    dqy: jax.Array
    dlit: jax.Array
    s: jax.Array
    t: jax.Array
    moved: jax.Array | None
    middle: jax.Array


def pixels_of(lenses: LensTable, views: jax.Array) -> Pixels:
    """The pixels of ``views``."""
    m, n = lenses.offset[views].T
    qx, qy = m[:, None] - lenses.phase[0], lenses.phase[1] - n[:, None]
    rim = lenses.rim[views][:, None]
    ends = [lit_part(lenses.radius, spread, qx, qy) for spread in lenses.ends]
    step = lenses.ends[1] - lenses.ends[0]
    per_unit = jnp.where(step == 0, 0.0, 1.0 / jnp.where(step == 0, 1.0, step))
    lit, qx, qy = (jnp.where(rim, cut, whole) for cut, whole in zip(ends[0], (1.0, qx, qy), strict=True))
    dlit, dqx, dqy = (jnp.where(rim, (last - first) * per_unit, 0.0) for first, last in zip(*ends, strict=True))
    if lenses.light is not None:
        lit, dlit = lit * lenses.light[views], dlit * lenses.light[views]
    s, t = places_mm(lenses, views)
    return Pixels(qx, qy, lit, dqx, dqy, dlit, s, t, _moved(lenses, s, t), lenses.middle[views])


def places_mm(lenses: LensTable, views: jax.Array) -> tuple[jax.Array, jax.Array]:
    """``CameraOnGrid.places_mm`` of several views, s and t, (views or 1, lens)."""
    s, t = lenses.s, lenses.t
    if lenses.shifts is None:
        return s[None], t[None]
    of_s, of_t = ([jnp.ones_like(x), x, x * x, x * x * x] for x in (s, t))
    moved = lenses.shifts[views]
    for k, (p, q) in enumerate(PLACE_POWERS):
        term = of_s[p] * of_t[q]
        s, t = s - moved[:, k, :1] * term, t - moved[:, k, 1:] * term
    return s, t


def _moved(lenses: LensTable, s: jax.Array, t: jax.Array) -> jax.Array | None:
    if lenses.regular is None:
        return None
    ds, dt = s - lenses.regular[0], t - lenses.regular[1]
    return jnp.stack([a * ds + b * dt for a, b in lenses.from_mm[:, :2]], 1)


def footprints(place: jax.Array, off: jax.Array, pixels: Pixels) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Where the footprints of pixels are centred on a plane's map, columns and rows (views, lens), and lit shares. By
    themselves, so that forward and back have the same bits. ``place``, ``off``: of ``PlaneTable``."""
    x0, xs, xq, y0, ys, yq = place
    x = x0 + xs * pixels.s + xq * (pixels.qx + off * pixels.dqx)
    y = y0 + ys * pixels.t + yq * (pixels.qy + off * pixels.dqy)
    return lax.optimization_barrier((x, y, pixels.lit + off * pixels.dlit))


def lit_part(
    radius: jax.Array, spread: jax.Array, qx: jax.Array, qy: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """``view_pixels.lit_part``: lit share of pixels at q that the rim may cut, and q of the middle of their lit
    part."""

    def half(v: jax.Array) -> jax.Array:
        return jnp.sqrt(jnp.maximum(radius * radius - v * v, 0.01))

    along_x = jnp.abs(qx) > jnp.abs(qy)
    out, v = jnp.where(along_x, qx, qy), jnp.where(along_x, qy, qx)
    u, outward = jnp.abs(out), jnp.where(out > 0, 1.0, -1.0)
    base = u + spread * (half(v) - u)
    one, two = (jnp.clip(half(v + side) - base, -0.5, 0.5) + 0.5 for side in (-GAUSS, GAUSS))
    lit = 0.5 * (one + two)
    du, dv = outward * 0.5 * (lit - 1.0), GAUSS * (two - one) / jnp.maximum(one + two, 1e-6)
    return lit, qx + jnp.where(along_x, du, dv), qy + jnp.where(along_x, dv, du)


class Near(NamedTuple):
    """The microlenses that may light places: the first row of them (``j``), and the places in microlenses along the
    rows (``along``); both count from the block's first lens."""

    j: jax.Array
    along: jax.Array


def near(
    block: LensBlock, lenses: LensTable, s: jax.Array, t: jax.Array, half_rows: jax.Array, moved: jax.Array | None
) -> Near:
    """The microlenses about places (s, t) mm, ``half_rows`` rows to each side. ``moved`` (2, lens) of ``Pixels``."""
    (ax, ay, a0), (bx, by, b0) = lenses.from_mm
    along, across = ax * s + ay * t + a0, bx * s + by * t + b0
    if moved is not None:
        at = along, across
        for _ in range(4):
            row = jnp.rint(at[1])
            place = lens_at(
                block, row.astype(jnp.int32), jnp.rint(at[0] - _shift(block, lenses, row)).astype(jnp.int32)
            )
            at = (
                along - moved[0].at[place].get(mode="promise_in_bounds"),
                across - moved[1].at[place].get(mode="promise_in_bounds"),
            )
        along, across = at
    return Near(jnp.ceil(across - half_rows).astype(jnp.int32), along)


def lens_of(
    block: LensBlock, lenses: LensTable, found: Near, row: int | jax.Array, number: int | jax.Array, half: jax.Array
) -> jax.Array:
    """The lens that is ``number`` of row ``row`` in each window, ``half`` microlenses to each side along the rows."""
    j = found.j + row
    first = jnp.ceil(found.along - _shift(block, lenses, j) - half).astype(jnp.int32)
    return lens_at(block, j, first + number)


def lens_at(block: LensBlock, j: jax.Array, i: jax.Array) -> jax.Array:
    """The number of lens i of row j; beyond the block one of the ring."""
    return (jnp.clip(j, -1, block.nj) + 1) * (block.ni + 2) + jnp.clip(i, -1, block.ni) + 1


def _shift(block: LensBlock, lenses: LensTable, j: jax.Array) -> jax.Array | float:
    """By how many pitches row j is shifted."""
    return 0.5 * ((j.astype(jnp.int32) + lenses.odd) & 1) if block.hexagonal else 0.0
