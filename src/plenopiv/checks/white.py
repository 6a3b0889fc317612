"""The white image: does it show one regular lattice of the stated kind, matched f-numbers, enough light."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration import LatticeFit, find_lattice
from plenopiv.calibration.aperture import aperture_disc
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks.findings import Finding
from plenopiv.checks.light import HOT, are_hot
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording.formats import split
from plenopiv.sensor import Sensor

RESIDUAL_PX = 0.1  # RMS; a few hundredths are usual
REGION_PX = 0.1
MATCHED = 0.04  # by which micro-images may be wider or narrower than the pitch; measured to 0.5 %
STATED = 0.04  # and than the stated aperture makes them
SATURATED = 1e-3  # share of the pixels
DEAD = 1e-3  # share of the pixels without any count
SUBTRACTED = 1.3  # times as many pixels that are nearly dark as have no count: noise clips half of them
NO_COUNT = 1.0
ARRAYS = {".h5", ".hdf5", ".npy"}  # files that say nothing of which axis are rows
UPRIGHT_DEG = 5.0  # of rows from the columns within which they run along these
DARK = 0.05  # of the sensor's range that the lit pixels should reach
BIT_DEPTHS = (8, 10, 12, 14)  # of cameras, below the 16 bits of files


def white_image(
    white: NDArray,
    camera: PlenopticCamera,
    name: str,
    stated: bool = True,
    frames_reach: float = 0.0,
    path: Path | None = None,
) -> tuple[list[Finding], LatticeFit | None]:
    """Findings on an upright white image in counts, and the lattice, None where none is found. ``stated``: the aperture
    that the file states is used; that of a camera calibrated with a target is the one that the white image shows.
    ``frames_reach``: the largest count of the frames; ``path``: of the image, where it is a file."""
    out = [*_light(white, camera, name, max(float(white.max()), frames_reach)), *_dead(white, camera, name)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlenoPIVWarning)  # a finding below
            fit = find_lattice(white, camera, name)
    except PlenoPIVError as error:
        words, _, advice = str(error).rpartition(": ")
        wrong = "lattice-type" if "lattice states" in words else "no-lattice"
        return [Finding(wrong, "unusable", words, advice=advice), *out], None
    out.insert(0, _lattice(fit, name))
    out.insert(1, _f_numbers(white, camera.with_lattice(fit.lattice), name, stated))
    out += _turned(fit, name, path)
    return out, fit


def _lattice(fit: LatticeFit, name: str) -> Finding:
    words = (
        f"{name} shows {fit.microlenses} microlenses, {fit.lattice.kind}, turned by {fit.rotation_deg:+.2f} degrees, "
        f"{fit.residual_px:.3f} px off the fitted lattice (RMS), {fit.worst_region_px:.3f} px in the worst region"
    )
    if fit.residual_px > RESIDUAL_PX or fit.worst_region_px > REGION_PX:
        advice = "more light for the white image, clean the array; in one region alone: the array is distorted there"
        return Finding("lattice-fit", "warning", words, fit.residual_px, "px", advice)
    return Finding("lattice-fit", "good", words, fit.residual_px, "px")


def _turned(fit: LatticeFit, name: str, path: Path | None) -> list[Finding]:
    """Rows of a hexagonal lattice along the columns of a stored array, whose axes some programs write reversed."""
    if path is None or split(path)[0].suffix.lower() not in ARRAYS or fit.lattice.kind != "hexagonal":
        return []
    beside = 30.0 - abs(fit.rotation_deg)
    if beside > UPRIGHT_DEG:
        return []
    words = (
        f"rows of microlenses of {name} run along the columns: was the array written with its axes reversed, as MATLAB "
        "does? Then images are mirrored, and with them the flow"
    )
    advice = "compare it with the picture on the camera's screen; write arrays as (images, rows, columns)"
    return [Finding("array-transposed", "warning", words, beside, "degrees", advice)]


def _f_numbers(white: NDArray, camera: PlenopticCamera, name: str, is_stated: bool) -> Finding:
    """Width of the micro-images against their pitch, and against what the stated aperture makes of it."""
    width, pitch = 2 * aperture_disc(white, camera).radius_px, camera.image_pitch_px
    ratio, stated = width / pitch, 2 * camera.aperture_radius_px / pitch
    words = f"micro-images are {width:.2f} px wide and {pitch:.2f} px apart ({100 * ratio:.0f} %)"
    lens = camera.main_lens
    if abs(ratio - 1) > MATCHED:
        effect = "overlap" if ratio > 1 else "leave dark pixels between them"
        turn = "close" if ratio > 1 else "open"
        number = lens.image_distance_mm / camera.matched_aperture_mm
        words = f"f-numbers do not match: {words}, so they {effect}"
        advice = (
            f"{turn} the main lens to an aperture of {camera.matched_aperture_mm:.3g} mm, f/{number:.3g} on the image "
            "side, and record anew"
        )
        if is_stated:
            usable = lens.aperture_mm * ratio / stated
            advice += f"; to use what there is, set camera.main_lens.aperture_mm = {usable:.3g}"
        return Finding("f-number", "warning", words, 100 * ratio, "% of the pitch", advice)
    if is_stated and abs(ratio / stated - 1) > STATED:
        words = f"{words}, but the stated aperture of {lens.aperture_mm:.3g} mm makes them {stated * pitch:.2f} px wide"
        advice = f"set camera.main_lens.aperture_mm = {lens.aperture_mm * ratio / stated:.3g} if the lens has it"
        return Finding("stated-aperture", "warning", words, 100 * ratio / stated, "%", advice)
    return Finding("f-number", "good", f"f-numbers match: {words}", 100 * ratio, "% of the pitch")


def _light(white: NDArray, camera: PlenopticCamera, name: str, largest: float) -> list[Finding]:
    """``largest``: count of all images."""
    sensor = camera.sensor
    full = white >= sensor.full_scale
    saturated = float(np.mean(full))
    level = float(np.percentile(white, 75) - sensor.black_level) / (sensor.full_scale - sensor.black_level)
    words = f"lit pixels of {name} reach {100 * level:.0f} % of the sensor's range"
    if saturated > SATURATED:
        words = f"{name} is overexposed: {100 * saturated:.2g} % of the pixels are saturated"
        advice = HOT if are_hot(full) else "record it with less light: micro-images lose their rims"
        return [Finding("white-overexposed", "warning", words, 100 * saturated, "%", advice)]
    if level < DARK:
        advice = "record it with more light, or average several images: the lattice is found from it"
        if bits := _fewer_bits(sensor, level, largest):
            advice += f"; or is camera.sensor.bit_depth {bits}?"
        if sensor.alignment == "high":
            advice += "; or are its counts in the lower bits, unlike those of the frames?"
        return [Finding("white-underexposed", "warning", f"{name} is underexposed: {words}", 100 * level, "%", advice)]
    return [Finding("white-light", "good", words, 100 * level, "%")]


def _fewer_bits(sensor: Sensor, level: float, largest: float) -> int | None:
    """A smaller bit depth that all counts fit into, and at which the lit pixels, at ``level`` of the range, would be
    bright enough."""
    bits = next((n for n in BIT_DEPTHS if largest < 2**n), sensor.bit_depth)
    if bits >= sensor.bit_depth or sensor.black_level >= 2**bits - 1:
        return None
    range_now, range_then = sensor.full_scale - sensor.black_level, 2**bits - 1 - sensor.black_level
    return bits if level * range_now >= DARK * range_then else None


def _dead(white: NDArray, camera: PlenopticCamera, name: str) -> list[Finding]:
    """Pixels without any count, where the sensor gives dark ones some."""
    share, level = float(np.mean(white <= NO_COUNT)), camera.sensor.black_level
    low = float(np.mean(white < 0.5 * level))  # what noise leaves of a level that was subtracted
    if level < 10 * NO_COUNT or share < DEAD:
        return []
    words = f"{100 * share:.2g} % of the pixels of {name} hold no count, where black_level = {level:g}: they are dead"
    advice = "name a dark image in recording.dark, or mask them: recording.mask"
    if low > SUBTRACTED * share:
        words += ", or the camera subtracts the black level"
        advice += "; or set camera.sensor.black_level = 0"
    return [Finding("dead-pixels", "warning", words, 100 * share, "%", advice)]
