"""From a white image to the lattice of microlenses, with residuals.

1. The spectrum of the image's middle gives kind, pitch and rotation, the phases of its peaks the offset
   (``spectrum``): good to a few hundredths of a pixel there.
2. Every micro-image's centre is measured (``micro_images``), first near the axis and then ever farther out, so that
   the lattice fitted so far always predicts the next centres to a fraction of a pixel.
3. A similarity (pitch, rotation, offset) is fitted to all centres; what a general affine map would add, and the mean
   residual by regions of the sensor, show whether one regular lattice describes the array.
"""

from __future__ import annotations

import warnings
from cmath import phase
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.lattice_fit import LatticeFit
from plenopiv.calibration.micro_images import Disc, MicroImages, find_disc, inside, measure, refine_disc
from plenopiv.calibration.spectrum import find_peaks, read_lattice, read_offset, reduced_angle, unit_centres
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.lattice import Lattice, LatticeKind

PITCH_TOLERANCE = 0.03  # stated against found
REGIONS = 4  # the residual map has REGIONS x REGIONS blocks
STAGES = (24.0, 120.0, 1e6)  # radii in pitches out to which centres are measured
MOST_FITS = 8  # of each stage
CONVERGED_PX = 1e-3  # by which the farthest centre, radius and blur still change
SAMPLE = 3000  # micro-images of each fit but the last, which takes all
IRREGULAR_PX = 0.1  # a region's mean residual that is worth a warning


def find_lattice(white: NDArray, camera: PlenopticCamera, name: str = "white image") -> LatticeFit:
    """The microlens lattice from a white image.

    ``white``: (rows, columns), upright, counts with the black level still in. ``camera``: as the user states it; its
    lattice's kind and pitch (to 3 %) must be right, rotation and offset are not used. ``name`` is what messages call
    the image.

    Raises ``PlenoPIVError`` where the image's shape is not the sensor's, where no lattice is found (a flat, noisy or
    particle image) and where the lattice contradicts the stated kind or pitch. Warns (``PlenoPIVWarning``) of
    saturation, and of regions of the sensor where the array departs from a regular lattice.
    """
    _check_counts(white, camera, name)
    # In an upright image columns grow with -s: turned round, both axes grow with (s, t).
    image = np.asarray(white)[:, ::-1]
    pitch, offset = _first_estimate(image, camera, name)
    kind = camera.lattice.kind
    numbers = _numbers(image, kind, pitch, offset, STAGES[0])
    if len(numbers) < 25:
        raise PlenoPIVError(
            f"{name}: only {len(numbers)} whole micro-images fit on the sensor: too few to find the lattice; "
            "check camera.sensor and camera.microlens_array.pitch_mm"
        )
    disc = find_disc(image, offset + pitch * numbers[:: max(1, len(numbers) // 64)], kind, pitch)
    count = 0
    for reach in STAGES:
        numbers = _numbers(image, kind, pitch, offset, reach)
        if len(numbers) == count:  # the sensor ends here: all have been fitted
            break
        count = len(numbers)
        numbers = numbers[:: max(1, count // SAMPLE)]
        far = float(np.abs(numbers).max())
        for _ in range(MOST_FITS):
            before, shape = pitch, disc
            measured = measure(image, offset + pitch * numbers, disc)
            good = _sound(measured, offset + pitch * numbers, image, name)
            pitch, offset = _similarity(numbers[good], measured.position[good])
            disc = refine_disc(image, offset + pitch * numbers[good], replace(disc, pitch=pitch))
            moved = (far * abs(pitch - before), disc.radius_px - shape.radius_px, disc.blur_px - shape.blur_px)
            if max(np.abs(moved)) < CONVERGED_PX:
                break
    numbers = _numbers(image, kind, pitch, offset, STAGES[-1])
    predicted = offset + pitch * numbers
    shift = measure(image, predicted, disc).position - predicted
    # Measured once more about the centres found: a large shift is only known to some percent from a linear fit.
    measured = measure(image, predicted + shift * np.minimum(1.0, 0.5 / np.maximum(np.abs(shift), 0.5)), disc)
    good = _sound(measured, predicted, image, name)
    pitch, offset = _similarity(numbers[good], measured.position[good])
    return _summary(camera, image, numbers, measured.position, good, pitch, offset, name)


def _check_counts(white: NDArray, camera: PlenopticCamera, name: str) -> None:
    """Shape, finite numbers, saturation."""
    sensor = camera.sensor
    if white.shape != (sensor.rows, sensor.columns):
        size = " x ".join(str(n) for n in white.shape[::-1])
        raise PlenoPIVError(
            f"{name}: {size} px (columns x rows), but camera.sensor states {sensor.columns} x {sensor.rows}: "
            "correct camera.sensor or give this camera's white image"
        )
    if white.dtype.kind == "f" and not np.isfinite(white).all():
        raise PlenoPIVError(f"{name}: holds NaN or infinite pixels; save it again as the camera recorded it")
    saturated = float(np.mean(white >= sensor.full_scale))
    if saturated > 0.01:
        warnings.warn(
            f"{name}: {saturated:.1%} of the pixels are saturated (>= {sensor.full_scale} counts): "
            "micro-image rims are displaced; record it again with less light",
            PlenoPIVWarning,
            stacklevel=3,
        )


def _first_estimate(image: NDArray, camera: PlenopticCamera, name: str) -> tuple[complex, complex]:
    """Complex pitch and offset in pixels from the spectrum, or the error that says what was found instead."""
    stated_px, kind = camera.image_pitch_px, camera.lattice.kind
    peaks = find_peaks(image, stated_px)
    found = read_lattice(peaks, kind, stated_px, PITCH_TOLERANCE) if len(peaks.waves) else None
    if found is None:
        raise PlenoPIVError(
            f"{name}: no microlens lattice of about {stated_px:.2f} px found: give an image of an evenly lit white "
            "surface (not particles, not dark), and check camera.microlens_array.pitch_mm and "
            "camera.sensor.pixel_pitch_mm"
        )
    found_px = abs(found.pitch)
    found_um = 1e3 * camera.lattice.pitch_mm * found_px / stated_px
    if found.kind != kind:
        raise PlenoPIVError(
            f"{name}: shows a {found.kind} lattice (pitch {found_um:.2f} um, {found_px:.3f} px), but "
            f'camera.microlens_array.lattice states "{kind}": set it to "{found.kind}"'
        )
    if abs(found_px / stated_px - 1.0) > PITCH_TOLERANCE:
        raise PlenoPIVError(
            f"{name}: shows microlenses {found_um:.2f} um ({found_px:.3f} px) apart, but "
            f"camera.microlens_array.pitch_mm states {1e3 * camera.lattice.pitch_mm:.2f} um ({stated_px:.3f} px): "
            "correct it, or camera.sensor.pixel_pitch_mm"
        )
    return found.pitch, read_offset(image, found)


def _numbers(image: NDArray, kind: LatticeKind, pitch: complex, offset: complex, radius: float) -> NDArray:
    """Lenses, as points of the unit lattice, with whole micro-images within a radius (in pitches) of the axis."""
    rows, columns = image.shape
    reach = min(radius * abs(pitch), np.hypot(rows, columns) / 2.0) + abs(offset)
    n = int(reach / abs(pitch) * 1.2) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    numbers = unit_centres(kind, i.ravel(), j.ravel())
    positions = offset + pitch * numbers
    half_window = Disc(kind, pitch, 0.0, 0.0).half_window
    return numbers[inside(image.shape, positions, half_window) & (np.abs(positions) <= radius * abs(pitch))]


def _block(position: NDArray[np.complex128], image: NDArray, blocks: int) -> NDArray[np.int64]:
    """Number of the block, of blocks x blocks over the upright image, that holds each point."""
    rows, columns = image.shape
    across = np.clip(((columns / 2.0 - position.real) / columns * blocks).astype(int), 0, blocks - 1)
    down = np.clip(((rows / 2.0 + position.imag) / rows * blocks).astype(int), 0, blocks - 1)
    return down * blocks + across


def _sound(measured: MicroImages, predicted: NDArray, image: NDArray, name: str) -> NDArray[np.bool_]:
    """Which micro-images are sound: fitted well, and near to where their neighbours predict them.

    Dust and dead microlenses are judged against their own part of the sensor, so that distortion of the array is not
    taken for a fault of many lenses.
    """
    shift = measured.position - predicted
    fitted = (measured.quality > 0.5) & (measured.gain > 0) & (np.abs(shift) < 2.0)
    if fitted.mean() < 0.5:
        raise PlenoPIVError(
            f"{name}: of {len(fitted)} micro-images only {fitted.mean():.0%} look like evenly lit discs: "
            "give an image of an evenly lit white surface, not of particles, in focus on the micro-images"
        )
    sound = fitted.copy()
    block = _block(predicted, image, 8)
    for b in np.unique(block[fitted]):
        here = np.flatnonzero(fitted & (block == b))
        middle = np.median(shift[here].real) + 1j * np.median(shift[here].imag)
        deviation = np.abs(shift[here] - middle)
        # 1.18 sigma is the median of a two-dimensional normal distribution's radius; the floor holds without noise.
        sound[here] = deviation < max(4.5 * np.median(deviation) / 1.18, 0.005)
        gain = measured.gain[here]
        sound[here] &= np.abs(gain / np.median(gain) - 1.0) < 0.5
    return sound


def _similarity(numbers: NDArray[np.complex128], position: NDArray[np.complex128]) -> tuple[complex, complex]:
    """Complex pitch and offset of the least-squares similarity: position = offset + pitch * number."""
    middle = numbers.mean()
    w = numbers - middle
    pitch = complex(np.sum(np.conj(w) * position) / np.sum(np.abs(w) ** 2))
    return pitch, complex(position.mean() - pitch * middle)


def _affine(numbers: NDArray[np.complex128], residual: NDArray[np.complex128], pitch: complex) -> tuple[float, float]:
    """Stretch and shear (rad) of an affine map of the residuals of the similarity.

    To first order position = offset + pitch (w + mu conj(w)): the lattice is stretched by 1 + |mu| along one
    direction and 1 - |mu| across it, and the largest departure of a right angle is 2 |mu|.
    """
    w = np.conj(numbers - numbers.mean())
    mu = complex(np.sum(np.conj(w) * residual) / np.sum(np.abs(w) ** 2)) / pitch
    return 2.0 * mu.real, 2.0 * mu.imag


def _summary(
    camera: PlenopticCamera,
    image: NDArray,
    numbers: NDArray[np.complex128],
    position: NDArray[np.complex128],
    good: NDArray[np.bool_],
    pitch: complex,
    offset: complex,
    name: str,
) -> LatticeFit:
    """The fit in mm on the microlens plane, with its residuals."""
    kind = camera.lattice.kind
    predicted = offset + pitch * numbers[good]
    residual = position[good] - predicted
    block = _block(predicted, image, REGIONS)
    count = np.bincount(block, minlength=REGIONS**2)
    with np.errstate(invalid="ignore"):
        mean = [np.bincount(block, part, minlength=REGIONS**2) / count for part in (residual.real, residual.imag)]
    regions = np.hypot(*mean).reshape(REGIONS, REGIONS)
    if np.nanmax(regions) > IRREGULAR_PX:
        row, column = np.unravel_index(np.nanargmax(regions), regions.shape)
        warnings.warn(
            f"{name}: micro-images lie {np.nanmax(regions):.2f} px off the fitted lattice in region "
            f"(row {row + 1}, column {column + 1}) of {REGIONS} x {REGIONS}: the array is distorted or tilted; "
            "depth is biased there",
            PlenoPIVWarning,
            stacklevel=3,
        )
    mm = camera.sensor.pixel_pitch_mm / (1.0 + camera.image_scale)  # of microlens plane per pixel
    lattice = _nearest_to_axis(
        Lattice(kind, abs(pitch) * mm, reduced_angle(kind, phase(pitch)), (offset.real * mm, offset.imag * mm))
    )
    stretch, shear = _affine(numbers[good], residual, pitch)
    return LatticeFit(
        lattice=lattice,
        image_pitch_px=abs(pitch),
        residual_px=float(np.sqrt(np.mean(np.abs(residual) ** 2))),
        worst_px=float(np.percentile(np.abs(residual), 99.9)),
        residual_map_px=tuple(tuple(float(x) for x in row) for row in regions),
        stretch=stretch,
        shear_rad=shear,
        microlenses=int(good.sum()),
        rejected=int((~good).sum()),
    )


def _nearest_to_axis(lattice: Lattice) -> Lattice:
    """The same lattice, numbered from the lens nearest to the optical axis."""
    s, t = lattice.centres(*lattice.nearest(0.0, 0.0))
    return Lattice(lattice.kind, lattice.pitch_mm, lattice.rotation_rad, (float(s), float(t)))
