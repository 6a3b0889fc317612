"""What a frame holds beside the light of particles: dark counts of each pixel, and static light.

A dark image (sensor covered) gives the black level of each pixel, and the pixels that are of no use: hot ones. Images
of each pulse before seeding give the static light: glow, reflections of walls and windows. Both are taken off each
frame; where static light saturates a pixel, nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.recording.pixel_light import peak, pixel_light
from plenopiv.sensor import Sensor

HOT = 8.0  # robust standard deviations of the dark image that a pixel stands out
HOT_COUNTS = 6.0  # and so many counts
MAD_TO_STD = 1.4826  # of a normal distribution
NEARLY_FULL = 0.95  # of the sensor's range that static light may fill
SAMPLE = 300_000  # pixels that tell by how much a pulse was brighter
DIM = 25.0  # per cent of them, those with the least static light, show noise and particles alone
CLEARLY = 3.0  # times as bright as those: what their own light says of the scale is small against it
JOINT = 3  # times that the scale is found, and then what all pixels hold beside it
CERTAIN = 0.02  # standard error of a scale that is used

Image = NDArray[np.float32]


@dataclass(frozen=True)
class StaticLight:
    """Upright images (rows, columns). ``dark``: counts of a pixel without light. ``pulses``: static light of the first
    and of the second pulse, counts above ``dark``; None where the recording names none. ``unusable``: pixels that give
    no equation. ``counts_per_electron``: of the shot noise; at first more than cameras have."""

    sensor: Sensor
    dark: Image
    pulses: tuple[Image, Image] | None
    unusable: NDArray[np.bool_]
    counts_per_electron: float = 1.0

    def removed(self, counts: NDArray[np.uint16], pulse: int) -> tuple[Image, Image | None]:
        """A frame's counts without them, above the sensor's black level as if it were one for all pixels; and the
        static light that was taken off, scaled to this pulse. Saturated pixels stay at full scale."""
        sensor = self.sensor
        light = counts - (self.dark - np.float32(sensor.black_level))
        static = None
        if self.pulses is not None:
            static = self.pulses[pulse] * np.float32(self.scale(counts, pulse))
            light -= static
        light[counts >= sensor.full_scale] = sensor.full_scale
        return light.astype(np.float32, copy=False), static

    def scale(self, counts: NDArray[np.uint16], pulse: int) -> float:
        """By how much a frame's pulse was brighter than the static light that was recorded of it.

        From the pixels that no particle lights: about the right scale their counts are densest. 1 where static light is
        nowhere bright against noise, everywhere bright, or particles light every pixel.
        """
        assert self.pulses is not None
        usable = np.flatnonzero(~self.unusable & (counts < self.sensor.full_scale))
        usable = usable[:: max(1, len(usable) // SAMPLE)]
        static = self.pulses[pulse].ravel()[usable]
        light = counts.ravel()[usable] - self.dark.ravel()[usable]
        dim = static <= np.percentile(static, DIM)
        bright = static > CLEARLY * np.median(static[dim])
        scale, error = 1.0, np.inf
        for _ in range(JOINT):
            common = np.float32(peak(light[dim] - np.float32(scale) * static[dim]))  # of a wrong black level, say
            alone = light[dim] - np.float32(scale) * static[dim] - common
            seen = pixel_light(alone, self.counts_per_electron, float(static.max(initial=0.0)))
            if np.std(static[dim]) > seen.noise:
                return 1.0
            noise = np.sqrt(np.maximum(self.counts_per_electron * static[bright], 0.0) + np.float32(seen.noise**2))
            scale, error = seen.brightness(light[bright] - common, static[bright], seen.level(noise))
        return scale if error < CERTAIN else 1.0


def static_light(sensor: Sensor, dark: NDArray | None, pulses: tuple[NDArray, NDArray] | None) -> StaticLight:
    """From upright counts of a dark image and of both pulses' static light; None for what there is not."""
    level = np.full((sensor.rows, sensor.columns), sensor.black_level, np.float32)
    unusable = np.zeros(level.shape, bool)
    if dark is not None:
        level, unusable = dark.astype(np.float32), hot_pixels(dark)
    if pulses is None:
        return StaticLight(sensor, level, None, unusable)
    full = NEARLY_FULL * sensor.full_scale
    for counts in pulses:
        unusable |= counts >= full
    a, b = (np.maximum(counts - level, 0.0).astype(np.float32) for counts in pulses)
    return StaticLight(sensor, level, (a, b), unusable)


def hot_pixels(dark: NDArray) -> NDArray[np.bool_]:
    """Pixels of a dark image that stand out from the others, up or down."""
    off = dark - np.median(dark)
    spread = MAD_TO_STD * float(np.median(np.abs(off)))
    return np.abs(off) > max(HOT * spread, HOT_COUNTS)
