"""Where the mean micro-images of regions of the sensor lie, however unevenly they are lit within.

A micro-image is a disc whose light is a polynomial of the place in it; all micro-images of a region together have one
such polynomial, and one that says how light changes from lens to lens, which tells the neighbours' light beside the
disc. With T the light of an even disc and its neighbours (``micro_images``), a and b the numbers of the lens that the
light is of, and u, v its place under that lens,

    I = T (sum g_pq u^p v^q + h_a a + h_b b) + ds T_s + dt T_t + dR T_R + db T_b + background,    p + q <= 3,

which is fitted by weighted least squares to the sums of all micro-images of one sub-pixel position. Pixels count by the
scatter of light that particles give them, which is in proportion to the light that they may get.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.micro_images import PHASES, Disc
from plenopiv.calibration.spectrum import unit_centres

LIGHT_POWERS = [(p, n - p) for n in range(4) for p in range(n, -1, -1)]  # of u and v, the constant first
DARK = 0.1  # scatter of a dark pixel, over that of a lit one
FEWEST = 40  # microlenses of a region
TERMS = len(LIGHT_POWERS) + 2  # of the light; then come the shift's two, radius, blur and background
SHIFT = slice(TERMS, TERMS + 2)

Array = NDArray[np.float64]


class RegionShifts(NamedTuple):
    """By how much the micro-images of each region lie beside the places given: ``shift`` (complex, px; NaN where there
    are too few), its variance along each axis by the scatter of the microlenses, and the light at the rim, counts."""

    shift: NDArray[np.complex128]
    variance: Array
    light: Array


class _Model(NamedTuple):
    """At one sub-pixel position: the pixels of the window within reach; what turns their counts into the right side of
    the normal equations (unknown, pixel); and the normal matrix."""

    used: NDArray[np.bool_]
    right: Array
    normal: Array


def terms_of(s: Array, t: Array, disc: Disc) -> Array:
    """The light at points (s, t) px from a micro-image's centre, (unknown, ...), before pixels take its mean."""
    from scipy.special import erfc

    i, j = (each.ravel() for each in np.mgrid[-2:3, -2:3])
    numbers = unit_centres(disc.kind, i, j)
    out = np.zeros((TERMS + 4, *np.broadcast(s, t).shape))
    for number in numbers[np.abs(numbers) < 1.5]:
        centre = disc.pitch * number
        ds, dt = np.broadcast_arrays(s - centre.real, t - centre.imag)
        r = np.hypot(ds, dt)
        x = (r - disc.radius_px) / disc.blur_px
        rim = np.exp(-0.5 * x**2) / (np.sqrt(2.0 * np.pi) * disc.blur_px)
        light, u, v = 0.5 * erfc(x / np.sqrt(2.0)), ds / disc.reach_px, dt / disc.reach_px
        of_place = [light * u**p * v**q for p, q in LIGHT_POWERS]
        of_lens = [light * number.real, light * number.imag]
        rest = [rim * ds / np.maximum(r, 1e-9), rim * dt / np.maximum(r, 1e-9), rim, rim * x]
        out += np.stack([*of_place, *of_lens, *rest])
    return out


@lru_cache(maxsize=1)
def _models(disc: Disc) -> list[_Model]:
    """Models of the PHASES**2 sub-pixel positions, t outside."""
    half, n = disc.half_window, PHASES * (disc.half_window + 1)
    cells = (np.arange(-n, n) + 0.5) / PHASES
    table = terms_of(cells, cells[:, None], disc)
    for axis in (1, 2):  # a pixel is PHASES cells wide: running means
        total = np.cumsum(table, axis=axis)
        total = np.concatenate((np.zeros_like(total.take([0], axis)), total), axis=axis)
        length = total.shape[axis]
        table = (total.take(range(PHASES, length), axis) - total.take(range(length - PHASES), axis)) / PHASES
    d, first, out = np.arange(-half, half + 1), n - PHASES // 2, []
    for p in range(PHASES**2):
        f_s, f_t = p % PHASES - PHASES // 2, p // PHASES - PHASES // 2
        at = np.meshgrid((d - f_s / PHASES) / disc.reach_px, (d - f_t / PHASES) / disc.reach_px)
        used = at[0] ** 2 + at[1] ** 2 < 1.0
        here = table[:, (first + PHASES * d - f_t)[:, None], first + PHASES * d - f_s][:, used]
        design = np.concatenate([here, np.ones((1, here.shape[1]))])
        right = design / (here[0] ** 2 + DARK**2)
        out.append(_Model(used, right, right @ design.T))
    return out


def region_shifts(
    image: NDArray, positions: NDArray[np.complex128], region: NDArray[np.int64], count: int, disc: Disc
) -> RegionShifts:
    """Fit the mean micro-images of ``count`` regions, whose numbers ``region`` holds for each microlens. ``positions``:
    complex, px from the axis, right to a pixel. ``image`` has axes (t, s), counts above the black level, the axis in
    its middle, NaN where a pixel is not to be used: its microlens has no part. All must lie ``inside``."""
    rows, columns = image.shape
    half, models = disc.half_window, _models(disc)
    nodes = PHASES * (positions + complex((columns - 1) / 2.0, (rows - 1) / 2.0))
    node_s, node_t = np.rint(nodes.real).astype(np.int64), np.rint(nodes.imag).astype(np.int64)
    c, r = (node_s + PHASES // 2) // PHASES, (node_t + PHASES // 2) // PHASES
    phase = (node_t - PHASES * r + PHASES // 2) * PHASES + node_s - PHASES * c + PHASES // 2
    beside = (nodes - node_s - 1j * node_t) / PHASES
    windows = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    right = np.empty((len(positions), len(models[0].right)))
    for p in np.unique(phase):
        lens = np.flatnonzero(phase == p)
        right[lens] = windows[r[lens] - half, c[lens] - half][:, models[p].used].astype(np.float64) @ models[p].right.T
    normals = np.stack([model.normal for model in models])
    rim = np.zeros(right.shape[1])  # light there, on the mean around it, from the numbers fitted
    rim[0], edge = 1.0, (disc.radius_px / disc.reach_px) ** 2
    rim[[LIGHT_POWERS.index((2, 0)), LIGHT_POWERS.index((0, 2))]] = 0.5 * edge
    out = RegionShifts(np.full(count, np.nan, np.complex128), np.full(count, np.inf), np.zeros(count))
    usable = np.isfinite(right).all(1)
    for k in range(count):
        lens = np.flatnonzero((region == k) & usable)
        if lens.size < FEWEST:
            continue
        normal = normals[phase[lens]]
        inverse = np.linalg.pinv(normal.sum(0), rcond=1e-11, hermitian=True)
        found = inverse @ right[lens].sum(0)
        light = float(rim @ found)
        out.light[k] = light
        if light <= 0:
            continue
        each = (right[lens] - normal @ found) @ inverse[:, SHIFT] / light
        shift = found[SHIFT] / light
        out.shift[k] = complex(*shift) - beside[lens].mean()
        out.variance[k] = float((each**2).sum()) / 2
    return out
