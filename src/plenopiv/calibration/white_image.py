"""From a white image to the lattice of microlenses, with residuals.

1. The spectrum of the image's middle gives kind, pitch and rotation, the phases of its peaks the offset
   (``spectrum``): good to a few hundredths of a pixel there.
2. Every micro-image's centre is measured (``micro_images``), first near the axis and then ever farther out, so that
   the lattice fitted so far always predicts the next centres to a fraction of a pixel.
3. A similarity (pitch, rotation, offset) is fitted to all centres, and where they ask for it an affine, quadratic or
   cubic map (``array_fit``); the mean residual by regions of the sensor shows whether that describes the array.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration import verdict
from plenopiv.calibration.array_fit import ArrayFit, best_fit, deviations
from plenopiv.calibration.cat_eyes import Rim, chief_rays, find_rim, spot_disc
from plenopiv.calibration.lattice_fit import LatticeFit
from plenopiv.calibration.micro_images import Disc, MicroImages, find_disc, inside, measure, measure_spots, refine_disc
from plenopiv.calibration.spectrum import find_peaks, read_lattice, read_offset, unit_centres
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.lattice import LatticeKind
from plenopiv.sensor import Sensor

PITCH_TOLERANCE = 0.03  # stated against found
REGIONS = 4  # the residual map has REGIONS x REGIONS blocks
FIRST_STAGE = 16.0  # radius in pitches out to which centres are measured first
GROWTH = 1.6  # of that radius from one stage to the next
MOST_FITS = 8  # of each stage
CONVERGED_PX = 1e-3  # by which the farthest centre, radius and blur still change
SAMPLE = 3000  # micro-images of each fit but the last, which takes all
HOT, HOT_LIGHT = 1.4, 0.15  # times the brightest neighbour, and more than it by this share of lit pixels' light
MOST_HOT = 0.01  # share of the pixels
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
    saturated = _check_counts(white, camera, name)
    try:
        return _found(white, camera, name)
    except PlenoPIVError as error:
        raise verdict.overexposed(saturated, name) or error from None


def _found(white: NDArray, camera: PlenopticCamera, name: str) -> LatticeFit:
    """``find_lattice``, of counts that are the sensor's."""
    # In an upright image columns grow with -s: turned round, both axes grow with (s, t).
    image = _without_hot_pixels(np.asarray(white)[:, ::-1], camera.sensor.black_level)
    fit = ArrayFit.similar(*_first_estimate(image, camera, name))
    kind = camera.lattice.kind
    reach, whole = FIRST_STAGE, 2.0 + np.hypot(*image.shape) / abs(fit.pitch)
    numbers = _numbers(image, kind, fit, reach)
    if len(numbers) < 25:
        raise PlenoPIVError(
            f"{name}: only {len(numbers)} whole micro-images fit on the sensor: too few to find the lattice; "
            "check camera.sensor and camera.microlens_array.pitch_mm"
        )
    disc = find_disc(image, fit(numbers[:: max(1, len(numbers) // 64)]), kind, fit.pitch)
    while True:
        for _ in range(MOST_FITS):
            numbers = _numbers(image, kind, fit, reach)
            numbers = numbers[:: max(1, len(numbers) // SAMPLE)]
            before, shape = fit(numbers), disc
            measured = (measure_spots if disc.is_spot else measure)(image, before, disc)
            good = _sound(measured, before, image, camera.sensor, name)
            fit = best_fit(numbers[good], measured.position[good])
            after = fit(numbers)
            good &= inside(image.shape, after, disc.half_window)
            disc = replace(disc, pitch=fit.pitch)
            if not disc.is_spot:
                disc = refine_disc(image, after[good], disc)
            moved = np.abs(after - before).max()
            if max(moved, abs(disc.radius_px - shape.radius_px), abs(disc.blur_px - shape.blur_px)) < CONVERGED_PX:
                break
        if reach > whole:  # the sensor ends here: all have been fitted
            break
        reach *= GROWTH
    numbers = _numbers(image, kind, fit, reach)
    predicted = fit(numbers)
    if disc.is_spot:
        measured = measure_spots(image, predicted, disc)
        good = _sound(measured, predicted, image, camera.sensor, name)
        clipped = spot_disc(image, measured.position[good], disc)
    else:
        shift = measure(image, predicted, disc).position - predicted
        # Measured once more about the centres found: a large shift is only known to some percent from a linear fit.
        measured = measure(image, predicted + shift * np.minimum(1.0, 0.5 / np.maximum(np.abs(shift), 0.5)), disc)
        good = _sound(measured, predicted, image, camera.sensor, name)
        clipped = find_rim(image, measured.position[good], disc)
    if clipped is not None:
        by_disc = chief_rays(image, numbers, np.where(good, measured.position, predicted), *clipped)
        # of spots a disc may say less than their centroids; rims are believed
        if not disc.is_spot or _scatter(numbers, by_disc, good) < _scatter(numbers, measured, good):
            measured = by_disc
            for _ in range(2):  # lenses that the biased centres left out come back
                after = best_fit(numbers[good], measured.position[good])(numbers)
                good = _sound(measured, after, image, camera.sensor, name)
    _judge(image, measured, good, clipped, abs(fit.pitch), name)
    found = _summary(camera, image, numbers[good], measured.position[good], int((~good).sum()), name)
    rim = None if clipped is None or disc.is_spot else clipped[1].on_main_lens(camera)
    return replace(found, rim=rim)


def _scatter(numbers: NDArray[np.complex128], measured: MicroImages, good: NDArray[np.bool_]) -> float:
    """Median distance of measured centres from their fit, px."""
    position = measured.position[good]
    return float(np.median(np.abs(position - best_fit(numbers[good], position)(numbers[good]))))


def _judge(
    image: NDArray, measured: MicroImages, good: NDArray, clipped: tuple[Disc, Rim] | None, pitch_px: float, name: str
) -> None:
    """Refuse what is not white; warn where centroids disagree with the centres found."""
    verdict.check_even(measured.gain, _block(measured.position, image, 8), name)
    position = measured.position[good]
    if clipped is not None:
        position = position[clipped[1].cut_px(position, clipped[0]) < verdict.UNCLIPPED_PX]
    words = verdict.centroid_words(image, position, pitch_px)
    if words:
        warnings.warn(f"{name}: {words}", PlenoPIVWarning, stacklevel=3)


def _without_hot_pixels(image: NDArray, black: float) -> NDArray:
    """The image with pixels that outshine all their neighbours as these. Where many do, they are micro-images."""
    from scipy import ndimage

    around = np.ones((3, 3), bool)
    around[1, 1] = False
    light = image.astype(np.float32) - np.float32(black)
    brightest = ndimage.maximum_filter(light, footprint=around, mode="nearest")
    least = HOT_LIGHT * float(np.percentile(light, 99))
    hot = (light > HOT * np.maximum(brightest, 0)) & (light - brightest > max(least, 1.0))
    if not hot.any() or hot.mean() > MOST_HOT:
        return image
    out = image.copy()
    out[hot] = ndimage.median_filter(image, footprint=around, mode="nearest")[hot]
    return out


def _check_counts(white: NDArray, camera: PlenopticCamera, name: str) -> float:
    """Shape and finite numbers; the share of saturated pixels."""
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
    return saturated


def _first_estimate(image: NDArray, camera: PlenopticCamera, name: str) -> tuple[complex, complex]:
    """Complex pitch and offset in pixels from the spectrum, or the error that says what was found instead."""
    stated_px, kind = camera.image_pitch_px, camera.lattice.kind
    peaks = find_peaks(image, stated_px)
    found = read_lattice(peaks, kind, stated_px, PITCH_TOLERANCE) if len(peaks.waves) else None
    if found is None:
        raise verdict.no_lattice(image, camera.sensor, stated_px, name)
    found_px = abs(found.pitch)
    found_um = 1e3 * camera.lattice.pitch_mm * found_px / stated_px
    if found.kind != kind:
        raise PlenoPIVError(
            f"{name}: another lattice: shows a {found.kind} lattice (pitch {found_um:.2f} um, {found_px:.3f} px), but "
            f'camera.microlens_array.lattice states "{kind}": set it to "{found.kind}", '
            "or name this camera's own white image"
        )
    if abs(found_px / stated_px - 1.0) > PITCH_TOLERANCE:
        raise PlenoPIVError(
            f"{name}: another lattice: shows microlenses {found_um:.2f} um ({found_px:.3f} px) apart, but "
            f"camera.microlens_array.pitch_mm states {1e3 * camera.lattice.pitch_mm:.2f} um ({stated_px:.3f} px): "
            "correct it, or camera.sensor.pixel_pitch_mm, or name this camera's own white image"
        )
    return found.pitch, read_offset(image, found)


def _numbers(image: NDArray, kind: LatticeKind, fit: ArrayFit, radius: float) -> NDArray:
    """Lenses, as points of the unit lattice, with whole micro-images within a radius (in pitches) of the axis."""
    rows, columns = image.shape
    pitch = abs(fit.pitch)
    reach = min(radius * pitch, np.hypot(rows, columns) / 2.0) + abs(fit.coefficients[0])
    n = int(reach / pitch * 1.2) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    numbers = unit_centres(kind, i.ravel(), j.ravel())
    numbers = numbers[np.abs(fit.coefficients[0] + fit.pitch * numbers) <= radius * pitch]
    return numbers[inside(image.shape, fit(numbers), Disc(kind, fit.pitch, 0.0, 0.0).half_window)]


def _block(position: NDArray[np.complex128], image: NDArray, blocks: int) -> NDArray[np.int64]:
    """Number of the block, of blocks x blocks over the upright image, that holds each point."""
    rows, columns = image.shape
    across = np.clip(((columns / 2.0 - position.real) / columns * blocks).astype(int), 0, blocks - 1)
    down = np.clip(((rows / 2.0 + position.imag) / rows * blocks).astype(int), 0, blocks - 1)
    return down * blocks + across


def _sound(measured: MicroImages, predicted: NDArray, image: NDArray, sensor: Sensor, name: str) -> NDArray[np.bool_]:
    """Which micro-images are sound: fitted well, and near to where their neighbours predict them.

    Dust and dead microlenses are judged against their own part of the sensor, so that distortion of the array is not
    taken for a fault of many lenses.
    """
    shift = measured.position - predicted
    fitted = (measured.quality > 0.5) & (measured.gain > 0) & (np.abs(shift) < verdict.MOVED_PX)
    if fitted.mean() < verdict.GONE:
        pitch_px = float(np.median(np.abs(np.diff(predicted)))) if len(predicted) > 1 else 1.0
        raise verdict.lost(fitted, predicted, pitch_px, image, sensor, name)
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


def _summary(
    camera: PlenopticCamera,
    image: NDArray,
    numbers: NDArray[np.complex128],
    position: NDArray[np.complex128],
    rejected: int,
    name: str,
) -> LatticeFit:
    """The fit in mm on the microlens plane, with its residuals, to sound micro-images."""
    fit = best_fit(numbers, position)
    predicted = fit(numbers)
    residual = position - predicted
    block = _block(predicted, image, REGIONS)
    count = np.bincount(block, minlength=REGIONS**2)
    with np.errstate(invalid="ignore"):
        mean = [np.bincount(block, part, minlength=REGIONS**2) / count for part in (residual.real, residual.imag)]
    regions = np.hypot(*mean).reshape(REGIONS, REGIONS)
    verdict.check_regions(regions, name)
    if np.nanmax(regions) > IRREGULAR_PX:
        row, column = np.unravel_index(np.nanargmax(regions), regions.shape)
        warnings.warn(
            f"{name}: micro-images lie {np.nanmax(regions):.2f} px off the fitted lattice in region "
            f"(row {row + 1}, column {column + 1}) of {REGIONS} x {REGIONS}: the array is distorted or tilted; "
            "depth is biased there",
            PlenoPIVWarning,
            stacklevel=3,
        )
    affine = ArrayFit.fitted(numbers, position, max(1, fit.degree))
    rotation_std, stretch_std, shear_std = deviations(numbers, position, fit.degree)
    return LatticeFit(
        lattice=fit.lattice(camera.lattice.kind, camera.sensor.pixel_pitch_mm / (1.0 + camera.image_scale)),
        image_pitch_px=abs(fit.pitch),
        residual_px=float(np.sqrt(np.mean(np.abs(residual) ** 2))),
        worst_px=float(np.percentile(np.abs(residual), 99.9)),
        residual_map_px=tuple(tuple(float(x) for x in row) for row in regions),
        stretch=affine.stretch,
        shear_rad=affine.shear_rad,
        microlenses=len(numbers),
        rejected=rejected,
        rotation_std_rad=rotation_std,
        stretch_std=stretch_std,
        shear_std_rad=shear_std,
    )
