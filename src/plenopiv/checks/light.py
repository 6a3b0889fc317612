"""Exposure and background of the frames, and their seeding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks.findings import Finding
from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.typical_particle import BELOW_MEAN, LOWEST, moments
from plenopiv.sensor import Sensor

CLIPPED_SHARE = 1e-4  # of a frame's pixels at the highest count, from which a recording is warned about
HOT_SHARE = 0.01  # below which pixels at the highest count may be hot ones
HOT = "name a dark image (recording.dark): most of them are alone, as hot pixels are"
CLIPPED_BADLY = 0.2  # up to a tenth is measured as well as if it were not (docs/uncertainty.md), with a third RMS grows
FAINTEST = 4.0  # of its noise that a particle in focus gives a pixel; 80 electrons at read noise 5 are 8
STRAY = 0.25  # background over what a particle in focus gives a pixel
BELOW_BLACK = 0.8  # median over RMS of values below the black level; of noise about it 0.67
BELOW_COUNTS, BELOW_SHARE = 4.0, 0.01  # RMS and share of pixels from which the black level counts as too high
OVERLAP = 4.5  # images that overlap in a pixel; up to 3.0 (1 ppm, 20 mm deep) are measured well in docs/accuracy.md
FEWEST_IN_WINDOW = 5.0


@dataclass(frozen=True)
class Light:
    """What the pixels of one frame hold, in counts above the black level.

    ``particle``: of a typical particle in a pixel that it lights wholly in focus; ``noise`` of the pixels; ``mean``;
    ``background``: of the darkest pixels; ``below_black``: by how much these lie below a black level that is too high;
    ``overlap``: particles whose images overlap in a pixel, the mean squared over the variance of their light;
    ``whole``: whether there are pixels that light fills: those that micro-images' rims cut tell nothing of these.
    """

    particle: float
    noise: Noise
    mean: float
    background: float
    below_black: float
    overlap: float
    whole: bool = True

    @property
    def signal_to_noise(self) -> float:
        """Signal of a particle in a pixel over the noise there."""
        spread = float(self.noise.std(np.array(self.particle, np.float32)))
        return self.particle / spread if spread > 0 else 0.0

    @property
    def ppm(self) -> float:
        """Particles per microlens: the light under one over a particle's."""
        return max(self.mean - self.background, 0.0) / self.particle if self.particle > 0 else 0.0


def light_of(lightfield: LightField, projector: PlenopticProjector, counts_per_electron: float) -> Light:
    """Measure one frame; ``projector`` of the volume that is lit."""
    noise = Noise(dark_noise(lightfield), counts_per_electron)
    total, squares, _ = projector.weight_sums().T
    share = projector.light_of_planes().astype(np.float64)
    particle = moments(lightfield, projector, noise).light
    through = [lightfield.values[view][projector.rays_inside_grid(int(view))] for view in projector.whole_views]
    values = np.concatenate([np.empty(0, np.float32), *through])  # of pixels that see nothing but the volume
    if values.size == 0:
        values = lightfield.values[lightfield.layout.seen]
    mean = float(values.mean(dtype=np.float64))
    one = particle * (share**2 @ squares) / (share @ total)  # variance over mean
    lowest = float(np.percentile(values, LOWEST)) + BELOW_MEAN * noise.dark
    background = _background(lowest, mean, one * mean)
    if background < mean:  # light that comes from no particle
        particle, one = (value * mean / (mean - background) for value in (particle, one))
    overlap = max(mean - background, 0.0) / one if one > 0 else 0.0
    of_pixels = noise, mean, background, _below_black(values), float(overlap), len(through) > 0
    return Light(particle * projector.light_in_focus, *of_pixels)


def _below_black(values: NDArray[np.float32]) -> float:
    """Counts by which dark pixels lie below the black level beyond noise about it, whose values thin out downward."""
    below = -values[values < 0]
    if below.size < BELOW_SHARE * values.size:
        return 0.0
    rms, median = float(np.sqrt(np.mean(below.astype(np.float64) ** 2))), float(np.median(below))
    return median if rms > BELOW_COUNTS and median > BELOW_BLACK * rms else 0.0


def _background(lowest: float, mean: float, variance: float) -> float:
    """Background: counts of the darkest pixels above what randomly placed particles give them, whose counts are near a
    gamma distribution of the same variance."""
    from scipy.stats import gamma

    background = 0.0
    for _ in range(30):
        light = mean - background
        if light <= 0 or variance <= 0:
            break
        expected = variance / light * float(gamma.ppf(LOWEST / 100, light**2 / variance))
        background = max(lowest - expected, 0.0)
    return background


def exposure(counts: NDArray, sensor: Sensor, found: Light, name: str, dark: str = "") -> list[Finding]:
    """Over- and underexposure of a frame (upright counts), and its background. ``dark``: name of the dark image that
    was taken off, where there is one."""
    out = [clipping(counts, sensor, name)]
    if not found.whole:
        words = f"micro-images are so small that none of their pixels in {name} is lit as a whole"
        advice = "open the main lens to the f-number of the microlenses: nothing can be reconstructed from rims alone"
        out.append(Finding("underexposed", "unusable", words, 0.0, "pixels", advice))
    elif found.signal_to_noise < FAINTEST:
        out.append(
            Finding(
                "underexposed",
                "warning" if found.signal_to_noise > 0.5 * FAINTEST else "unusable",
                f"{name} is underexposed: a particle in focus gives a pixel {found.particle:.1f} counts, "
                f"{found.signal_to_noise:.1f} times the noise",
                found.signal_to_noise,
                "noise",
                "more light, larger particles, or a longer pulse; is black_level right?",
            )
        )
    else:
        words = f"a particle in focus gives a pixel of {name} {found.particle:.0f} counts"
        words += f", {found.signal_to_noise:.0f} times the noise"
        out.append(Finding("signal", "good", words, found.signal_to_noise, "noise"))
    if found.below_black > 0:
        level = f"those of {dark}" if dark else f"black_level = {sensor.black_level:g}"
        words = f"dark pixels of {name} lie {found.below_black:.0f} counts below {level}"
        advice = "set camera.sensor.black_level to the mean count with the lens cap on"
        if dark:
            advice = "name a dark image of this camera at the gain and exposure of the frames, with the lens cap on"
        out.append(Finding("black-level", "warning", words, found.below_black, "counts", advice))
    elif found.particle > 0 and found.background > STRAY * found.particle and found.overlap < OVERLAP:
        words = f"the darkest pixels of {name} hold {found.background:.0f} counts above the black level"
        advice = "stray light, or camera.sensor.black_level is too low: take an image with the lens cap on"
        out.append(Finding("background", "warning", words, found.background, "counts", advice))
    else:
        words = f"the darkest pixels of {name} are {found.background:.1f} counts above the black level"
        out.append(Finding("background", "good", words, found.background, "counts"))
    return out


def clipping(counts: NDArray, sensor: Sensor, name: str) -> Finding:
    """Pixels at full scale, or heaped at a lower highest count: a sensor may saturate below what its bits hold.

    Less a dark image, which lies below the black level somewhere, pixels that were just not full are above full scale.
    """
    top = min(int(counts.max()), sensor.full_scale)
    full = counts >= top
    share = float(np.mean(full))
    high = top - sensor.black_level > 0.5 * (sensor.full_scale - sensor.black_level)
    if high and share > CLIPPED_SHARE:
        where = "full scale" if top >= sensor.full_scale else f"{top} counts, below full scale of {sensor.full_scale}"
        return Finding(
            "overexposed",
            "unusable" if share > CLIPPED_BADLY else "warning",
            f"{name} is overexposed: {100 * share:.2g} % of the pixels are at {where}",
            100 * share,
            "%",
            HOT
            if are_hot(full)
            else "less light, a shorter pulse, or a lower gain: what is cut off is missing from the particles",
        )
    used = float(np.percentile(counts, 99.9) - sensor.black_level) / (sensor.full_scale - sensor.black_level)
    words = f"no pixel of {name} is cut off; its brightest use {100 * used:.0f} % of the sensor's range"
    return Finding("range", "good", words, 100 * used, "%")


def are_hot(full: NDArray[np.bool_]) -> bool:
    """Whether pixels that are ``full`` (rows, columns) are few, and most of them without one beside them: light fills
    several."""
    if not 0 < np.mean(full) < HOT_SHARE:
        return False
    beside = np.zeros_like(full)
    beside[1:] |= full[:-1]
    beside[:-1] |= full[1:]
    beside[:, 1:] |= full[:, :-1]
    beside[:, :-1] |= full[:, 1:]
    return bool(np.mean(~beside[full]) > 0.5)


def seeding(found: Light, camera: PlenopticCamera, depth_mm: float, window_mm: tuple[float, float, float]) -> Finding:
    """Particles per microlens, in a pixel, and in one of the last windows (x, y, z in mm)."""
    area = camera.lattice.cell_area_mm2 / camera.main_lens.magnification**2
    in_window = found.ppm / (area * depth_mm) * float(np.prod(window_mm))
    many = f"{found.ppm:.2g}"
    words = (
        f"about {many} particle{'' if many == '1' else 's'} per microlens, images of {found.overlap:.1f} overlap in a "
        f"pixel, {in_window:.0f} are in one of the last windows"
    )
    if found.overlap > OVERLAP:
        advice = (
            f"dilute to {found.ppm * OVERLAP / 1.5 / found.overlap:.1g} particles "
            "per microlens, or light a thinner sheet"
        )
        return Finding(
            "too-dense", "warning", f"seeding is too dense: {words}", found.overlap, "particles per pixel", advice
        )
    if in_window < FEWEST_IN_WINDOW and found.signal_to_noise >= FAINTEST:
        words, advice = (
            f"seeding is too thin: {words}",
            "add particles, or give larger last windows (correlation.windows)",
        )
        return Finding("too-thin", "warning", words, in_window, "particles per window", advice)
    return Finding("seeding", "good", words, found.ppm, "particles per microlens")
