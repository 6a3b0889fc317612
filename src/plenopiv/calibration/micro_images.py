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
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.spectrum import unit_centres
from plenopiv.lattice import LatticeKind

PHASES = 8  # sub-pixel positions per axis at which the fit is tabulated; what is left of a shift is what it measures
CHUNK = 4096  # micro-images fitted at a time
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
    """T, T_s, T_t, T_R, T_b of pixels centred at multiples of 1/PHASES px: (5, t, s), the micro-image in the middle."""
    from scipy.special import erfc

    n = PHASES * (disc.half_window + 1)
    cells = (np.arange(-n, n) + 0.5) / PHASES
    i, j = (a.ravel() for a in np.mgrid[-2:3, -2:3])
    numbers = unit_centres(disc.kind, i, j)
    fine = np.zeros((5, 2 * n, 2 * n))
    for centre in disc.pitch * numbers[np.abs(numbers) < 1.5]:
        ds, dt = cells - centre.real, (cells - centre.imag)[:, None]
        r = np.hypot(ds, dt)
        x = (r - disc.radius_px) / disc.blur_px
        rim = np.exp(-0.5 * x**2) / (np.sqrt(2.0 * np.pi) * disc.blur_px)
        fine[0] += 0.5 * erfc(x / np.sqrt(2.0))
        fine[1] += rim * ds / np.maximum(r, 1e-9)
        fine[2] += rim * dt / np.maximum(r, 1e-9)
        fine[3] += rim
        fine[4] += rim * x
    # A pixel is PHASES cells wide: running means along both axes.
    for axis in (1, 2):
        total = np.cumsum(fine, axis=axis)
        total = np.concatenate((np.zeros_like(total.take([0], axis)), total), axis=axis)
        length = total.shape[axis]
        fine = (total.take(range(PHASES, length), axis) - total.take(range(length - PHASES), axis)) / PHASES
    return fine


def _groups(
    image: NDArray, node_s: NDArray[np.int64], node_t: NDArray[np.int64], disc: Disc
) -> Iterator[tuple[NDArray, NDArray, NDArray, NDArray]]:
    """Micro-images about (node_s, node_t) (in 1/PHASES px from pixel (0, 0)), those of one sub-pixel position together.

    Yields their indices, their (lens, pixel) counts within reach, the pixels' (s, t) over the reach, and the model's
    (5, pixel) T, T_s, T_t, T_R, T_b there.
    """
    half = disc.half_window
    # Nearest pixel (c, r), and the rest in 1/PHASES px.
    c, r = (node_s + PHASES // 2) // PHASES, (node_t + PHASES // 2) // PHASES
    phase = (node_t - PHASES * r + PHASES // 2) * PHASES + node_s - PHASES * c + PHASES // 2
    order = np.argsort(phase, kind="stable")
    bounds = np.searchsorted(phase[order], np.arange(PHASES**2 + 1))
    windows = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    table = _table(disc)
    d = np.arange(-half, half + 1)
    first = PHASES * (half + 1) - PHASES // 2  # index in the table of the pixel centred on the micro-image
    for p in np.flatnonzero(np.diff(bounds)):
        f_s, f_t = p % PHASES - PHASES // 2, p // PHASES - PHASES // 2
        at = np.meshgrid((d - f_s / PHASES) / disc.reach_px, (d - f_t / PHASES) / disc.reach_px)
        used = at[0] ** 2 + at[1] ** 2 < 1.0
        model = table[:, (first + PHASES * d - f_t)[:, None], first + PHASES * d - f_s][:, used]
        for start in range(bounds[p], bounds[p + 1], CHUNK):
            lens = order[start : min(start + CHUNK, bounds[p + 1])]
            counts = windows[r[lens] - half, c[lens] - half][:, used].astype(np.float64)
            yield lens, counts, np.stack([a[used] for a in at]), model


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
    for lens, counts, at, model in _groups(image, node_s, node_t, disc):
        light = model[0]
        design = np.stack((*model[:3], np.ones_like(light), *(at * light), (at**2).sum(0) * light, *model[3:]), 1)
        fit = counts @ _inverse(design).T
        level = counts @ _inverse(design[:, :6])[0]
        shift[lens] = (fit[:, 1] + 1j * fit[:, 2]) / np.where(np.abs(level) > 1e-9, level, np.inf)
        gain[lens] = level
        left = np.sum((counts - fit @ design.T) ** 2, 1)
        quality[lens] = 1.0 - left / np.maximum(np.sum((counts - counts.mean(1, keepdims=True)) ** 2, 1), 1e-30)
    return MicroImages((node_s + 1j * node_t) / PHASES - axis + shift, gain, quality)


def _inverse(design: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (unknown, pixel) matrix that turns counts into the least-squares fit of a design (pixel, unknown)."""
    return np.linalg.pinv(design.T @ design, rcond=1e-12, hermitian=True) @ design.T


def find_disc(image: NDArray, positions: NDArray[np.complex128], kind: LatticeKind, pitch: complex) -> Disc:
    """A first disc for ``refine_disc``: of radii from 0.3 to 0.6 pitches the one that explains the counts best, as
    light: taken away from the background, discs wide enough to overlap explain ones that just touch as well."""

    def explained(disc: Disc) -> float:
        found = measure(image, positions, disc)
        return float(np.median(np.where(found.gain > 0, found.quality, -np.inf)))

    return max((Disc(kind, pitch, ratio * abs(pitch), 0.5) for ratio in np.arange(0.30, 0.61, 0.04)), key=explained)


def refine_disc(image: NDArray, positions: NDArray[np.complex128], disc: Disc) -> Disc:
    """The disc with radius and blur fitted to the sum of the micro-images at ``positions``, in one bounded step."""
    node_s, node_t, _ = _nodes(image, positions)
    left, right = np.zeros((5, 5)), np.zeros(5)
    for _, counts, at, model in _groups(image, node_s, node_t, disc):
        even = np.stack((model[0], model[3], model[4], np.ones(model.shape[1]), (at**2).sum(0) * model[0]), 1)
        left += len(counts) * (even.T @ even)
        right += even.T @ counts.sum(0)
    gain, d_radius, d_blur = (np.linalg.pinv(left, rcond=1e-12, hermitian=True) @ right)[:3]
    step = np.clip(d_radius / gain, -0.5, 0.5) if gain > 0 else 0.0
    width = np.clip(disc.blur_px + d_blur / gain, 0.6 * disc.blur_px, 1.5 * disc.blur_px) if gain > 0 else disc.blur_px
    pitch = abs(disc.pitch)
    return Disc(
        disc.kind,
        disc.pitch,
        float(np.clip(disc.radius_px + step, 0.2 * pitch, 0.7 * pitch)),
        float(np.clip(width, SHARPEST_PX, 0.2 * pitch)),
    )
