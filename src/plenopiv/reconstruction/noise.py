"""Noise of the pixels, measured on the images themselves.

A pixel of I counts above the black level carries the variance dark^2 + counts_per_electron I: read noise and
digitisation, and the photons' shot noise.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVWarning
from plenopiv.lightfield import LightField
from plenopiv.sensor import Sensor, at_full_scale

NO_WHITE_IMAGE = 1.0  # counts per electron taken where nothing tells: more than cameras have at 12 bits
INNER = 0.5  # of the aperture's radius: pixels of a white image that are lit alike
BESIDE = 2  # microlenses beside a saturated pixel that are left out with it: the bright ones of theirs are missing
FEWEST = 0.5  # of a view's pairs that must be left
MOST_ELECTRONS = 150e3  # that a pixel holds at full scale: of 5.5 um some 2e4, of 10 um some 1e5
QUANTUM = 12**-0.5  # counts: digitisation alone
SAMPLE = 1_000_000  # pixels, evenly spaced, that the usual noise is taken from
FAR = 2.0  # times the usual noise: a root mean square beyond that is one of dead pixels
MAD_TO_STD = 1.4826  # of a normal distribution


@dataclass(frozen=True)
class Noise:
    """``dark``: standard deviation of a pixel without light, counts. ``counts_per_electron``: of the shot noise.
    ``background`` (view, pixel): counts of static light that were taken off, whose shot noise is still there."""

    dark: float
    counts_per_electron: float = NO_WHITE_IMAGE
    background: NDArray[np.float32] | None = field(default=None, compare=False)

    def std(self, counts: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standard deviation (counts) of pixels of ``counts`` above the black level."""
        light = np.maximum(counts, 0)
        if self.background is not None:
            light = light + np.maximum(self.background, 0)  # an estimate: below the black level is no light
        return np.sqrt(np.float32(self.counts_per_electron) * light + np.float32(self.dark**2))

    def floor(self, least: float) -> float | NDArray[np.float32]:
        """Counts that MART adds to measured and projected light: the dark noise, ``least`` at least, and the static
        light that was taken off, with which both are what the pixel collected; one number, or (view, pixel)."""
        dark = max(self.dark, least)
        return dark if self.background is None else np.maximum(self.background, 0.0) + np.float32(dark)


def dark_noise(lightfield: LightField) -> float:
    """Standard deviation in counts of pixels without light, from the values below the black level (half a normal)."""
    return noise_below(lightfield.values[lightfield.layout.seen])


def noise_below(values: NDArray[np.float32]) -> float:
    """The same of pixels ``values`` (n,) in counts above the black level. Of whole counts it is high by
    1 / sqrt(1 - P(0)), as those that are 0 belong to the lower half too: 16 % at 1.5 counts."""
    below = values[values < 0]
    if not below.size:
        return 0.0
    root = float(np.sqrt(np.mean(below.astype(np.float64) ** 2)))
    usual = MAD_TO_STD * float(np.median(-below[:: max(below.size // SAMPLE, 1)]))
    return usual if root > FAR * usual else root  # dead pixels lie far below, and few of them make most of the root


def noise_of(
    values: NDArray[np.float32],
    seen: NDArray[np.bool_],
    counts_per_electron: float,
    background: NDArray[np.float32] | None = None,
) -> Noise:
    """The noise of a camera's pixels ``values`` (view, pixel) where they are ``seen``; ``background`` as in ``Noise``.

    Values below the black level scatter by the dark noise and by the shot noise of the static light that was taken off.
    Where none are below it, as of a camera that clips at zero, digitisation is left.
    """
    if background is None:
        return Noise(max(noise_below(values[seen]), QUANTUM), counts_per_electron)
    dim = seen & (background <= np.median(background[seen]))
    below = dim & (values < 0)
    variance = noise_below(values[dim]) ** 2
    if below.any():
        variance -= counts_per_electron * float(np.mean(background[below]))
    return Noise(max(variance, QUANTUM**2) ** 0.5, counts_per_electron, background)


def counts_per_electron(white: LightField) -> float:
    """Photon transfer on a white image: variance over mean of what one pixel shows under neighbouring microlenses.

    Differences between next neighbours along a row cancel what changes slowly over the sensor. Microlenses that differ
    among themselves raise the figure: it is an upper bound. Saturated pixels, which show no noise, and those beside
    them are left out; where they leave too few, PlenoPIVWarning says so, and ``NO_WHITE_IMAGE`` is taken. So it is
    where there is less noise than pixels of MOST_ELECTRONS have: a mean of several images tells no shot noise.
    """
    where = white.layout
    slopes, saturated = [], 0
    for view in np.flatnonzero(np.hypot(*where.offsets.T) < INNER * where.camera.aperture_radius_px):
        seen = where.seen[view].reshape(where.nj, where.ni)
        values = white.values[view].reshape(where.nj, where.ni)
        both = seen[:, 1:] & seen[:, :-1]
        pairs, full = np.count_nonzero(both), _near_full_scale(values, where.camera.sensor)
        both &= ~(full[:, 1:] | full[:, :-1])
        if np.count_nonzero(both) < FEWEST * pairs:
            saturated += 1
            continue
        step, mean = (values[:, 1:] - values[:, :-1])[both], (values[:, 1:] + values[:, :-1])[both] / 2
        if step.size and mean.mean() > 0:
            variance = 0.5 * (MAD_TO_STD * np.median(np.abs(step - np.median(step)))) ** 2
            slopes.append(variance / mean.mean())
    if saturated and not slopes:
        warnings.warn(
            f"recording.white: too many of its pixels are at full scale to tell shot noise; {NO_WHITE_IMAGE:g} count "
            "per electron is taken, more than cameras have; record it with less light",
            PlenoPIVWarning,
            stacklevel=2,
        )
    if not slopes:
        return NO_WHITE_IMAGE
    found = float(np.median(slopes))
    return found if found * MOST_ELECTRONS > where.camera.sensor.full_scale else NO_WHITE_IMAGE


def _near_full_scale(values: NDArray[np.float32], sensor: Sensor) -> NDArray[np.bool_]:
    """Pixels of one view (row, microlens) in counts above the black level that are saturated, and those beside them in
    their row."""
    from scipy.ndimage import binary_dilation

    full = at_full_scale(values, sensor)
    return binary_dilation(full, np.ones((1, 2 * BESIDE + 1))) if full.any() else full


def with_neighbours(microlenses: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """These of the microlenses (row, microlens), and those beside them."""
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(microlenses, np.ones((3, 3), bool)))
