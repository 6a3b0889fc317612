"""Sub-pixel centres of micro-images, each fitted by a model of the image of the main lens' aperture.

A micro-image is a disc of radius R with a rim blurred by a Gaussian of width b, area-sampled by the pixels; its
neighbours, which touch it, belong to the model. With T that model, the counts around a centre that is off by
(ds, dt) are, to first order,

    I = gain (T + ds T_s + dt T_t + dR T_R + db T_b) + background + (ramp_s s + ramp_t t + bow r^2) T

linear in all unknowns, so that one small matrix per sub-pixel position fits every micro-image. Unlike a centroid it
takes no bias from where the window cuts, from the neighbours' light or from uneven illumination. The even terms in
T_R, T_b and r^2 take up discs that differ from the model (vignetting, light falling off towards the rim). Of small
micro-images they cannot be told from the gain, which is therefore taken from a fit without them; and R and b, common
to all, from the sum of many.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.spectrum import unit_centres
from plenopiv.lattice import LatticeKind

PHASES = 8  # sub-pixel positions per axis at which the fit is tabulated; what is left of a shift is what it measures
EVEN = [0, 7, 8, 3, 6]  # T, T_R, T_b, 1 and T r^2 of a model's nine
CHUNK = 4096  # micro-images fitted at a time
SPOT = 0.28  # radius, of a pitch, below which a micro-image is a spot in the dark
SMALLEST = 0.05  # radius, of a pitch
DARK = 0.2  # of the light: less is dark
SPOT_STEPS = 4
SHARPEST_PX = 0.15  # blur below which the table's step would show


@dataclass(frozen=True)
class Disc:
    """Shape of the micro-images on a lattice: complex pitch, radius and blur of the rim in pixels."""

    kind: LatticeKind
    pitch: complex
    radius_px: float
    blur_px: float

    @property
    def reach_px(self) -> float:
        """Radius of the pixels that a fit uses: the disc, its rim, and little of the neighbours."""
        return 0.5 * abs(self.pitch) + 1.0

    @property
    def is_spot(self) -> bool:
        """Whether it is small beside the dark around it."""
        return self.radius_px < SPOT * abs(self.pitch)

    @property
    def half_window(self) -> int:
        """Half the side of the square of pixels around a centre that holds them."""
        return int(np.ceil(self.reach_px + 0.5))


@dataclass(frozen=True)
class MicroImages:
    """Fitted micro-images: centres (complex, pixels from the axis), gain in counts, share of variance explained."""

    position: NDArray[np.complex128]
    gain: NDArray[np.float64]
    quality: NDArray[np.float64]


def inside(shape: tuple[int, int], positions: NDArray[np.complex128], half_window: int) -> NDArray[np.bool_]:
    """Which positions (complex, pixels from the axis) lie a half window and a pixel within an image's edges."""
    rows, columns = shape
    margin = half_window + 1
    return (np.abs(positions.real) <= (columns - 1) / 2.0 - margin) & (
        np.abs(positions.imag) <= (rows - 1) / 2.0 - margin
    )


@lru_cache(maxsize=1)
def _table(disc: Disc) -> NDArray[np.float64]:
    """T, T_s, T_t, T_R, T_b, and T times s, t and r^2 of pixels centred at multiples of 1/PHASES px: (8, t, s), the
    micro-image in the middle. s, t and r, in units of the reach, are those of the micro-image that the light is of."""
    from scipy.special import erfc

    n = PHASES * (disc.half_window + 1)
    cells = (np.arange(-n, n) + 0.5) / PHASES
    i, j = (a.ravel() for a in np.mgrid[-2:3, -2:3])
    numbers = unit_centres(disc.kind, i, j)
    fine = np.zeros((8, 2 * n, 2 * n))
    for centre in disc.pitch * numbers[np.abs(numbers) < 1.5]:
        ds, dt = cells - centre.real, (cells - centre.imag)[:, None]
        r = np.hypot(ds, dt)
        x = (r - disc.radius_px) / disc.blur_px
        rim = np.exp(-0.5 * x**2) / (np.sqrt(2.0 * np.pi) * disc.blur_px)
        light, u, v = 0.5 * erfc(x / np.sqrt(2.0)), ds / disc.reach_px, dt / disc.reach_px
        fine[0] += light
        fine[1] += rim * ds / np.maximum(r, 1e-9)
        fine[2] += rim * dt / np.maximum(r, 1e-9)
        fine[3] += rim
        fine[4] += rim * x
        fine[5] += light * u
        fine[6] += light * v
        fine[7] += light * (u**2 + v**2)
    # A pixel is PHASES cells wide: running means along both axes.
    for axis in (1, 2):
        total = np.cumsum(fine, axis=axis)
        total = np.concatenate((np.zeros_like(total.take([0], axis)), total), axis=axis)
        length = total.shape[axis]
        fine = (total.take(range(PHASES, length), axis) - total.take(range(length - PHASES), axis)) / PHASES
    return fine


class _Model(NamedTuple):
    """A micro-image at one sub-pixel position: the pixels within reach; its light in them and how that changes, T, T_s,
    T_t, 1, T s, T t, T r^2, T_R and T_b (pixel, 9); what turns counts into the shares of these (9, pixel), and into
    that of T without r^2, T_R and T_b (pixel)."""

    used: NDArray[np.bool_]
    design: NDArray[np.float64]
    fit: NDArray[np.float64]
    level: NDArray[np.float64]


@lru_cache(maxsize=1)
def _models(disc: Disc) -> list[_Model]:
    """Models of the PHASES**2 sub-pixel positions, t outside."""
    half = disc.half_window
    table, d = _table(disc), np.arange(-half, half + 1)
    first = PHASES * (half + 1) - PHASES // 2  # index in the table of the pixel centred on the micro-image
    within, designs = [], []
    for p in range(PHASES**2):
        f_s, f_t = p % PHASES - PHASES // 2, p // PHASES - PHASES // 2
        at = np.meshgrid((d - f_s / PHASES) / disc.reach_px, (d - f_t / PHASES) / disc.reach_px)
        within.append(at[0] ** 2 + at[1] ** 2 < 1.0)
        here = table[:, (first + PHASES * d - f_t)[:, None], first + PHASES * d - f_s][:, within[-1]]
        designs.append(np.stack((*here[:3], np.ones(here.shape[1]), *here[5:], *here[3:5]), 1))
    squares = np.stack([design.T @ design for design in designs])
    fits = np.linalg.pinv(squares, rcond=1e-12, hermitian=True)
    levels = np.linalg.pinv(squares[:, :6, :6], rcond=1e-12, hermitian=True)[:, 0]
    return [
        _Model(used, design, fit @ design.T, design[:, :6] @ level)
        for used, design, fit, level in zip(within, designs, fits, levels, strict=True)
    ]


def _groups(
    image: NDArray, node_s: NDArray[np.int64], node_t: NDArray[np.int64], disc: Disc
) -> Iterator[tuple[NDArray, NDArray, _Model]]:
    """Micro-images about (node_s, node_t) (in 1/PHASES px from pixel (0, 0)), those of one sub-pixel position together.

    Yields their indices, their (lens, pixel) counts within reach, and the ``_Model`` there.
    """
    half = disc.half_window
    # Nearest pixel (c, r), and the rest in 1/PHASES px.
    c, r = (node_s + PHASES // 2) // PHASES, (node_t + PHASES // 2) // PHASES
    phase = (node_t - PHASES * r + PHASES // 2) * PHASES + node_s - PHASES * c + PHASES // 2
    order = np.argsort(phase, kind="stable")
    bounds = np.searchsorted(phase[order], np.arange(PHASES**2 + 1))
    windows = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    models = _models(disc)
    for p in np.flatnonzero(np.diff(bounds)):
        for start in range(bounds[p], bounds[p + 1], CHUNK):
            lens = order[start : min(start + CHUNK, bounds[p + 1])]
            counts = windows[r[lens] - half, c[lens] - half][:, models[p].used].astype(np.float64)
            yield lens, counts, models[p]


def _nodes(image: NDArray, positions: NDArray[np.complex128]) -> tuple[NDArray[np.int64], NDArray[np.int64], complex]:
    """Positions (complex, pixels from the axis) rounded to 1/PHASES px from pixel (0, 0); where the axis is, in px."""
    rows, columns = image.shape
    axis = complex((columns - 1) / 2.0, (rows - 1) / 2.0)
    nodes = PHASES * (positions + axis)
    return np.rint(nodes.real).astype(np.int64), np.rint(nodes.imag).astype(np.int64), axis


def measure(image: NDArray, positions: NDArray[np.complex128], disc: Disc) -> MicroImages:
    """Fit the micro-images predicted at ``positions`` (complex, pixels from the axis; within about a pixel).

    ``image`` has axes (t, s) and the optical axis in its middle. All must lie ``inside`` with ``disc.half_window``.
    """
    node_s, node_t, axis = _nodes(image, positions)
    shift, gain, quality = np.zeros(len(positions), np.complex128), np.zeros(len(positions)), np.zeros(len(positions))
    for lens, counts, model in _groups(image, node_s, node_t, disc):
        fit = counts @ model.fit.T
        level = counts @ model.level
        shift[lens] = (fit[:, 1] + 1j * fit[:, 2]) / np.where(np.abs(level) > 1e-9, level, np.inf)
        gain[lens] = level
        left = np.sum((counts - fit @ model.design.T) ** 2, 1)
        quality[lens] = 1.0 - left / np.maximum(np.sum((counts - counts.mean(1, keepdims=True)) ** 2, 1), 1e-30)
    return MicroImages((node_s + 1j * node_t) / PHASES - axis + shift, gain, quality)


def measure_spots(image: NDArray, positions: NDArray[np.complex128], disc: Disc) -> MicroImages:
    """Centroids of the light above the dark around it, in the cell about each of ``positions`` (complex, pixels from
    the axis). For spots, of which a disc that does not yet fit says less."""
    rows, columns = image.shape
    half = disc.half_window
    d = np.arange(-half, half + 1)
    used = np.hypot(d, d[:, None]) < 0.5 * abs(disc.pitch) + 0.25
    at = (d + 1j * d[:, None])[used]
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    axis = complex((columns - 1) / 2.0, (rows - 1) / 2.0)
    found, gain = positions.copy(), np.zeros(positions.size)
    quality = np.zeros(positions.size)
    for _ in range(SPOT_STEPS):
        c, r = (np.rint(part).astype(int) for part in ((found + axis).real, (found + axis).imag))
        c, r = np.clip(c, half, columns - 1 - half), np.clip(r, half, rows - 1 - half)
        counts = views[r - half, c - half][:, used].astype(np.float64)
        low, high = np.percentile(counts, (40, 99), axis=1)
        light = np.maximum(counts - (low + 0.1 * (high - low))[:, None], 0.0)
        gain = light.sum(1)
        found = c + 1j * r - axis + light @ at / np.maximum(gain, 1e-9)
        quality = 1.0 - np.var(np.where(light > 0, 0.0, counts - low[:, None]), axis=1) / np.maximum(
            counts.var(1), 1e-9
        )
    return MicroImages(found, gain, quality)


def find_disc(image: NDArray, positions: NDArray[np.complex128], kind: LatticeKind, pitch: complex) -> Disc:
    """A first disc for ``refine_disc``: of radii from 0.06 to 0.6 pitches the one that explains the counts best, as
    light: taken away from the background, discs wide enough to overlap explain ones that just touch as well."""

    def explained(disc: Disc) -> float:
        found = measure(image, positions, disc)
        return float(np.median(np.where(found.gain > 0, found.quality, -np.inf)))

    best = max((Disc(kind, pitch, ratio * abs(pitch), 0.5) for ratio in np.arange(0.30, 0.61, 0.04)), key=explained)
    radius = _spot_radius(image, positions, best)
    return replace(best, radius_px=radius) if radius < SPOT * abs(pitch) else best


def _spot_radius(image: NDArray, positions: NDArray[np.complex128], disc: Disc) -> float:
    """Radius of an even disc of the same second moment as the median micro-image has, px; inf where less than half of
    its cell is dark."""
    half = disc.half_window
    d = np.arange(-half, half + 1)
    used = np.hypot(d, d[:, None]) < 0.5 * abs(disc.pitch) + 0.25
    rows, columns = image.shape
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))

    def median_cell(places: NDArray[np.complex128]) -> NDArray[np.float64]:
        at = places + complex((columns - 1) / 2.0, (rows - 1) / 2.0)
        c, r = np.rint(at.real).astype(int), np.rint(at.imag).astype(int)
        keep = (c >= half) & (c < columns - half) & (r >= half) & (r < rows - half)
        return np.asarray(np.median(views[r[keep] - half, c[keep] - half][:, used].astype(np.float64), axis=0))

    shape = median_cell(positions)
    dark, middle, high = np.percentile(shape, (10, 50, 99))
    inner = shape[np.hypot(d, d[:, None])[used] <= max(1.0, 0.06 * abs(disc.pitch))].mean()
    lit = high - dark
    if middle - dark > DARK * lit or inner - dark < 0.5 * lit:  # discs that overlap are brightest where they do
        return np.inf
    shape = median_cell(measure_spots(image, positions, disc).position)
    dark, high = np.percentile(shape, (10, 99))
    light = np.maximum(shape - dark - 0.1 * (high - dark), 0.0)
    return float(np.sqrt(2.0 * np.sum(light * np.hypot(d, d[:, None])[used] ** 2) / max(light.sum(), 1e-9)))


def refine_disc(image: NDArray, positions: NDArray[np.complex128], disc: Disc) -> Disc:
    """The disc with radius and blur fitted to the sum of the micro-images at ``positions``, in one bounded step."""
    node_s, node_t, _ = _nodes(image, positions)
    left, right = np.zeros((5, 5)), np.zeros(5)
    for _, counts, model in _groups(image, node_s, node_t, disc):
        even = model.design[:, EVEN]
        left += len(counts) * (even.T @ even)
        right += even.T @ counts.sum(0)
    gain, d_radius, d_blur = (np.linalg.pinv(left, rcond=1e-12, hermitian=True) @ right)[:3]
    most = min(0.5, 0.08 * disc.radius_px)
    step = np.clip(d_radius / gain, -most, most) if gain > 0 else 0.0
    width = np.clip(disc.blur_px + d_blur / gain, 0.6 * disc.blur_px, 1.5 * disc.blur_px) if gain > 0 else disc.blur_px
    pitch = abs(disc.pitch)
    return Disc(
        disc.kind,
        disc.pitch,
        float(np.clip(disc.radius_px + step, SMALLEST * pitch, 0.7 * pitch)),
        float(np.clip(width, SHARPEST_PX, 0.2 * pitch)),
    )
