"""Why an image cannot serve as white image: not white, too dim, overexposed, too distorted; and centres cross-checked.

The fit of a model can be wrong with small residuals. Centroids know no model: where nothing clips micro-images, in the
middle of the image, both must agree but for light that is uneven within a micro-image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor

LARGEST_GAIN, LARGEST_READ_NOISE = 20.0, 60.0  # counts to an electron, and counts: of a sensor
DIM = 4.0  # light over noise below which a lattice that is not found was too dim
OVEREXPOSED = 0.2  # share of saturated pixels above which that is the fault: discs have lost their rims
LEAST_COUNTS = 5.0  # of lit pixels above the black level
UNEVEN = 0.2  # of the light of neighbouring micro-images, by their median deviation: particles have more
GRAINY, ALIKE = 0.25, 0.08  # noise over light; difference of the light of neighbouring cells of a white image
GONE = 0.5  # share of micro-images that may be lost
MOVED_PX = 2.0  # from where neighbours predict a micro-image
DISTORTED_PX = 0.6  # mean residual of a region that no map describes
CENTROIDS, LEAST_CENTROIDS = 150, 20  # micro-images whose centroids are compared
UNCLIPPED_PX = 0.1  # depth of a cut that moves no centroid
CELL = 0.6  # radius, of a pitch, of the pixels of a centroid: some of the gaps between touching discs
CENTROID_STEPS = 8
DISAGREED = (0.3, 0.05)  # px, and share of the pitch that uneven light may move a centroid by
WHITE = "give an image of an evenly lit white surface"


def no_lattice(image: NDArray, sensor: Sensor, stated_px: float, name: str) -> PlenoPIVError:
    """The error for an image in whose spectrum no lattice is found."""
    light, noise = _light_and_noise(image, sensor)
    found = f"no microlens lattice of about {stated_px:.2f} px found"
    if _is_dim(light, noise):
        return PlenoPIVError(
            f"{name}: too dim: {found}, lit pixels hold {light:.0f} counts above the black level with a noise of "
            f"{noise:.0f}: record it with more light, or average several exposures"
        )
    return PlenoPIVError(
        f"{name}: not white: {found}: {WHITE} (not particles, not dark), and check camera.microlens_array.pitch_mm and "
        "camera.sensor.pixel_pitch_mm"
    )


def overexposed(saturated: float, name: str) -> PlenoPIVError | None:
    """The error for an image of which this share of the pixels is ``saturated`` and in which something is wrong; None
    where that is not the reason."""
    if saturated <= OVEREXPOSED:
        return None
    return PlenoPIVError(
        f"{name}: overexposed: {saturated:.0%} of the pixels are saturated, and its microlenses cannot be told: record "
        "it with less light"
    )


def _light_and_noise(image: NDArray, sensor: Sensor) -> tuple[float, float]:
    """Counts of lit pixels above the black level, and the noise of a pixel against the next but one of its row."""
    light = float(np.percentile(image, 90)) - sensor.black_level
    apart = image[:, 2:].astype(np.float32) - image[:, :-2]
    return light, float(1.4826 * np.median(np.abs(apart - np.median(apart)))) / 2.0**0.5


def _is_dim(light: float, noise: float) -> bool:
    """Whether too little light is the fault: what varies by more than a sensor's noise does so itself, as speckle."""
    of_sensor = (LARGEST_GAIN * max(light, 0.0) + LARGEST_READ_NOISE**2) ** 0.5
    return light < LEAST_COUNTS or (light < DIM * noise and noise < of_sensor)


def lost(
    fitted: NDArray[np.bool_],
    position: NDArray[np.complex128],
    pitch_px: float,
    image: NDArray,
    sensor: Sensor,
    name: str,
) -> PlenoPIVError:
    """The error where less than half of the micro-images are ``fitted`` well, near to ``position`` (complex, pixels
    from the axis), where they are predicted. Cells of a distorted array hold as much light as their neighbours."""
    light, noise = _light_and_noise(image, sensor)
    share = f"of {len(fitted)} micro-images only {fitted.mean():.0%} look like evenly lit discs"
    if _is_dim(light, noise):
        return PlenoPIVError(f"{name}: too dim: {share}: record it with more light, or average several exposures")
    if noise < GRAINY * light and _unevenness(image, position, pitch_px, sensor) < ALIKE:
        return PlenoPIVError(
            f"{name}: too distorted: {share} where their neighbours predict them, though all cells hold as much light: "
            "check that the image is one exposure of the whole array, or have the array seen to"
        )
    return PlenoPIVError(f"{name}: not white: {share}: {WHITE}, not of particles, in focus on the micro-images")


def _unevenness(image: NDArray, position: NDArray[np.complex128], pitch_px: float, sensor: Sensor) -> float:
    """Median difference of the light in the cell about each position from that in the next one, over the light."""
    rows, columns = image.shape
    half = max(1, int(0.5 * pitch_px))
    c = np.clip(np.rint(position.real + (columns - 1) / 2.0).astype(int), half, columns - 1 - half)
    r = np.clip(np.rint(position.imag + (rows - 1) / 2.0).astype(int), half, rows - 1 - half)
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    cell = views[r - half, c - half].mean((1, 2)) - sensor.black_level
    return float(np.median(np.abs(np.diff(cell))) / max(float(np.median(cell)), 1e-9))


def check_even(gain: NDArray, block: NDArray, name: str) -> None:
    """Refuse micro-images (lens,) whose light differs from that of their neighbours, those of the same ``block``."""
    spread = []
    for b in np.unique(block):
        here = gain[block == b]
        if here.size > 4 and np.median(here) > 0:
            spread.append(np.median(np.abs(here / np.median(here) - 1.0)))
    if spread and np.median(spread) > UNEVEN:
        raise PlenoPIVError(
            f"{name}: not white: the light of neighbouring micro-images differs by {np.median(spread):.0%} in the "
            f"median: {WHITE}, not of particles or of a target"
        )


def check_regions(regions: NDArray, name: str) -> None:
    """Refuse an array that no map describes. ``regions``: mean residuals, px, rows and columns of the upright image."""
    if np.nanmax(regions) > DISTORTED_PX:
        row, column = np.unravel_index(np.nanargmax(regions), regions.shape)
        raise PlenoPIVError(
            f"{name}: too distorted: micro-images lie {np.nanmax(regions):.2f} px off a cubic map in region (row "
            f"{row + 1}, column {column + 1}) of {len(regions)} x {len(regions)}: check that the image is one exposure "
            "of the whole array, or have the array seen to"
        )


def centroid_words(image: NDArray, position: NDArray[np.complex128], pitch_px: float) -> str | None:
    """Words for a warning where centroids disagree with the fitted centres ``position`` (complex, pixels from the axis)
    of micro-images that nothing clips; None where they agree, or are too few. Those next to the axis are compared."""
    chosen = position[np.argsort(np.abs(position), kind="stable")[:CENTROIDS]]
    if chosen.size < LEAST_CENTROIDS:
        return None
    rows, columns = image.shape
    axis, half = complex((columns - 1) / 2.0, (rows - 1) / 2.0), int(np.ceil(CELL * pitch_px + 1.0))
    d = np.arange(-half, half + 1)
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    found = chosen.copy()
    for _ in range(CENTROID_STEPS):
        c, r = (np.rint(part).astype(int) for part in ((found + axis).real, (found + axis).imag))
        c, r = np.clip(c, half, columns - 1 - half), np.clip(r, half, rows - 1 - half)
        at = c[:, None, None] + 1j * r[:, None, None] - axis + d + 1j * d[:, None]
        cell = np.clip(CELL * pitch_px + 0.5 - np.abs(at - found[:, None, None]), 0.0, 1.0)
        counts = views[r - half, c - half].astype(np.float64)
        dark = np.array([np.percentile(one[inside > 0], 5) for one, inside in zip(counts, cell, strict=True)])
        light = np.maximum(counts - dark[:, None, None], 0.0) * cell
        found = (light * at).sum((1, 2)) / np.maximum(light.sum((1, 2)), 1e-9)
    off = found - chosen
    apart = abs(complex(np.median(off.real), np.median(off.imag)))
    if apart <= max(DISAGREED[0], DISAGREED[1] * pitch_px):
        return None
    return (
        f"centroids of the micro-images lie {apart:.2f} px from the centres fitted where nothing clips them: look at "
        "the white image; its light is uneven within the micro-images, or the lattice is wrong"
    )
