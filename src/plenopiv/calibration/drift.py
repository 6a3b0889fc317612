"""How far the microlens array has moved since the white image, from the light of frames.

A particle's light ends at the edge of a micro-image wherever the particle is: at the image of the main lens' aperture.
All frames' light together makes micro-images that are unevenly lit within, but whose outlines lie where the microlenses
are now. They are found region by region (``mean_micro_images``), in the frames and in the white image; the difference
is the drift there, and a similarity through all regions (shift, turn, scale) that of the array. Of these only what is
beyond doubt is taken.

Within the outline nothing can be told: a shift of the lattice and a shear of the volume make the same images there.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, hypot

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.aperture import aperture_disc
from plenopiv.calibration.mean_micro_images import region_shifts
from plenopiv.calibration.micro_images import Disc, inside
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVWarning
from plenopiv.recording import Recording

SIDE = 12.0  # pitches: the least side of a region
MOST = 8  # regions along an axis
LIT = 0.1  # of the brightest region's light: with less a region has no part
STEPS, CONVERGED_PX = 10, 0.002
SAMPLE = 2000  # microlenses from which the shift is first guessed
FAR, ROUNDS = 2.5, 10  # standard deviations beyond which a region counts less (Huber)
SURE = 4.0  # standard deviations below which nothing has moved ...
WORTH_PX = 0.05  # ... nor where it moves the images by less
LOST_PX = 0.3  # by which regions may differ from the similarity, RMS: else the light is not of this lattice
UNSURE_PX = 0.06  # standard deviation of the shift above which frames do not show it
LARGEST_TURN_DEG, LARGEST_SCALE = 0.3, 0.005

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriftFit:
    """The drift that frames show, ``drift``, what is in doubt taken for none; and as it was ``measured``. Standard
    deviations: of the shift along each axis in the sensor's middle, px; of turn, degrees, and scale. ``scatter_px``: of
    the ``regions`` about the drift."""

    drift: ArrayDrift
    measured: ArrayDrift
    shift_std_px: float
    turn_std_deg: float
    scale_std: float
    scatter_px: float
    regions: int


def find_drift(
    light: NDArray, white: NDArray, camera: PlenopticCamera, unusable: NDArray[np.bool_] | None = None
) -> DriftFit | None:
    """The drift of the microlenses from ``white`` to frames whose light together is ``light``, upright images (rows,
    columns) in counts above the black level; None where the frames do not show micro-images of the white image's
    lattice. ``camera``: with that lattice. ``unusable``: pixels that are no measurements."""
    disc = aperture_disc(white, camera)
    image, before = (np.asarray(each, np.float32)[:, ::-1] for each in (light, white))  # both axes grow with (s, t)
    if unusable is not None:
        image, before = (np.where(unusable[:, ::-1], np.float32(np.nan), each) for each in (image, before))
    places = _places(camera, image.shape, disc)
    region, count = _regions(places, image.shape, disc)
    of_white = region_shifts(before, places, region, count, disc)
    weight = np.maximum(np.bincount(region, minlength=count), 1)
    middle = (np.bincount(region, places.real, count) + 1j * np.bincount(region, places.imag, count)) / weight
    guess = first_guess(image, places, disc)
    now, far = np.array([guess.real, guess.imag, 0.0, 0.0]), 0.5 * hypot(*image.shape)
    for _ in range(STEPS):
        at = places + moved_by(now, places)
        there = inside(image.shape, at, disc.half_window)
        found = region_shifts(image, at[there], region[there], count, disc)
        good = np.isfinite(found.shift - of_white.shift) & (found.light > LIT * found.light.max())
        if not good.any():
            return None
        variance = (found.variance + of_white.variance)[good]
        step = found.shift[good] - of_white.shift[good]
        step *= np.minimum(1.0, 1.0 / np.maximum(np.abs(step), 1.0))
        free = [0, 1, 2, 3] if np.count_nonzero(good) > 2 else [0, 1]
        change = similarity(middle[good], step, variance, free)[0]
        now = now + change
        if hypot(*change[:2]) + far * hypot(*change[2:]) < CONVERGED_PX:
            break
    shift = moved_by(now - change, middle[good]) + step
    return _judged(middle[good], shift, variance, free, far)


def _judged(
    places: NDArray[np.complex128], shift: NDArray[np.complex128], variance: Array, free: list[int], far: float
) -> DriftFit | None:
    """The similarity of regions at ``places`` that moved by ``shift``, of which what is in doubt is left out."""
    all_of_it, covariance = similarity(places, shift, variance, free)
    scatter = float(np.sqrt(np.mean(np.abs(shift - moved_by(all_of_it, places)) ** 2)))
    turn, scale = degrees(all_of_it[2]), float(all_of_it[3])
    std = np.sqrt(np.diag(covariance))
    if max(std[:2]) > UNSURE_PX or scatter > LOST_PX or abs(turn) > LARGEST_TURN_DEG or abs(scale) > LARGEST_SCALE:
        return None
    kept, errors, left = all_of_it, std, list(free)
    for k in (3, 2):
        if k in left and (abs(kept[k]) < SURE * errors[k] or abs(kept[k]) * far < WORTH_PX):
            left.remove(k)
            kept, covariance = similarity(places, shift, variance, left)
            errors = np.sqrt(np.diag(covariance))
    length = hypot(*kept[:2])
    if left == [0, 1] and (length < SURE * max(errors[:2]) or length < WORTH_PX):
        kept = np.zeros(4)
    return DriftFit(
        _drift(kept), _drift(all_of_it), float(max(std[:2])), degrees(std[2]), float(std[3]), scatter, len(places)
    )


def _drift(moved: Array) -> ArrayDrift:
    """The same, of the upright image."""
    s, t, turn, scale = moved.tolist()
    return ArrayDrift((-s, t), degrees(turn), scale) if moved.any() else ArrayDrift()


def moved_by(moved: Array, places: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """How far places (complex, px from the axis) are moved by a shift (s, t), a turn (rad) and a scale."""
    s, t, turn, scale = moved.tolist()
    return np.asarray(complex(s, t) + places * ((1.0 + scale) * np.exp(1j * turn) - 1.0))


def similarity(
    places: NDArray[np.complex128], shift: NDArray[np.complex128], variance: Array, free: list[int]
) -> tuple[Array, Array]:
    """Shift (s, t), turn (rad) and scale that move ``places`` by ``shift``, and their covariance, by weighted least
    squares, in which what lies far off counts less; those not ``free`` are 0. The turn is taken as small."""
    one, none = np.ones(len(places)), np.zeros(len(places))
    along_s = np.stack([one, none, -places.imag, places.real], 1)
    along_t = np.stack([none, one, places.real, places.imag], 1)
    design, wanted = np.concatenate([along_s, along_t])[:, free], np.concatenate([shift.real, shift.imag])
    weight, less = np.tile(1.0 / variance, 2), np.ones(2 * len(places))
    for _ in range(ROUNDS):
        normal = (design.T * (weight * less)) @ design
        fitted = np.linalg.solve(normal, design.T @ (weight * less * wanted))
        off = np.abs(wanted - design @ fitted) * np.sqrt(weight)
        scale = max(1.0, float(np.median(off)) / 0.6745)
        less = np.minimum(1.0, FAR * scale / np.maximum(off, 1e-12))
    freedom = len(wanted) - len(free)
    wider = max(1.0, float(np.sum(less * off**2)) / freedom) if freedom > 0 else 1.0
    moved, covariance = np.zeros(4), np.zeros((4, 4))
    moved[free], covariance[np.ix_(free, free)] = fitted, wider * np.linalg.inv(normal)
    return moved, covariance


def light_of(recording: Recording, frames: Sequence[int]) -> NDArray[np.float32]:
    """The light of ``frames`` together, by number, without what is known to be static: upright counts.

    Raises:
        PlenoPIVError: a frame cannot be used.
    """
    total = np.zeros((recording.sensor.rows, recording.sensor.columns), np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)  # saturation is told where frames are used
        for k in frames:
            total += recording.light(k)[0] - np.float32(recording.sensor.black_level)
    return total


def first_guess(image: NDArray, places: NDArray[np.complex128], disc: Disc) -> complex:
    """The shift, to whole pixels and within half a pitch, at which most light lies in the discs."""
    from scipy.signal import correlate2d

    rows, columns = image.shape
    reach, half = int(0.5 * abs(disc.pitch)) + 1, disc.half_window
    at = places[:: max(1, len(places) // SAMPLE)] + complex((columns - 1) / 2.0, (rows - 1) / 2.0)
    c, r, side = np.rint(at.real).astype(int), np.rint(at.imag).astype(int), half + reach
    around = np.lib.stride_tricks.sliding_window_view(np.pad(np.nan_to_num(image), side), (2 * side + 1,) * 2)
    total = around[r, c].sum(0, dtype=np.float64)
    d = np.arange(-half, half + 1)
    near = np.hypot(d, d[:, None])
    lit, used = near < disc.radius_px, near < disc.reach_px
    within = correlate2d(total, np.where(used, lit - lit[used].mean(), 0.0), mode="valid")
    step = np.arange(-reach, reach + 1)
    within[np.hypot(step, step[:, None]) > 0.5 * abs(disc.pitch) + 1] = -np.inf
    row, column = np.unravel_index(np.argmax(within), within.shape)
    return complex(step[column], step[row])


def _places(camera: PlenopticCamera, shape: tuple[int, ...], disc: Disc) -> NDArray[np.complex128]:
    """Centres of the whole micro-images of an image (rows, columns), complex, px from the axis in (s, t)."""
    lattice, n = camera.lattice, int(hypot(*shape) / camera.image_pitch_px) + 2
    i, j = (each.ravel() for each in np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)))
    s, t = lattice.centres(i, j)
    places = (s + 1j * t) * ((1.0 + camera.image_scale) / camera.sensor.pixel_pitch_mm)
    return places[inside((shape[0], shape[1]), places, disc.half_window)]


def _regions(places: NDArray[np.complex128], shape: tuple[int, ...], disc: Disc) -> tuple[NDArray[np.int64], int]:
    """The region of each micro-image, and how many there are."""
    numbers, count = np.zeros(len(places), np.int64), 1
    for length, part in zip(shape, (places.imag, places.real), strict=True):
        n = int(np.clip(length / (SIDE * abs(disc.pitch)), 1, MOST))
        numbers = numbers * n + np.clip(((part / length + 0.5) * n).astype(int), 0, n - 1)
        count *= n
    return numbers, count
