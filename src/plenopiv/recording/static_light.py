"""What a frame holds beside the light of particles: dark counts of each pixel, and static light.

A dark image (sensor covered) gives the black level of each pixel, and the pixels that are of no use: hot ones. Images
of each pulse before seeding give the static light: glow, reflections of walls and windows. Both are taken off each
frame; where static light saturates a pixel, nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.sensor import Sensor

HOT = 8.0  # robust standard deviations of the dark image that a pixel stands out
HOT_COUNTS = 6.0  # and so many counts
MAD_TO_STD = 1.4826  # of a normal distribution
NEARLY_FULL = 0.95  # of the sensor's range that static light may fill
BRIGHT = 0.2  # of the brightest static light: pixels that tell by how much a pulse was brighter
FEWEST = 50  # of them
CLEARLY = 4.0  # times the spread of particle light that their static light has
SCALES = (0.5, 2.0)  # what pulses may differ by

Image = NDArray[np.float32]


@dataclass(frozen=True)
class StaticLight:
    """Upright images (rows, columns). ``dark``: counts of a pixel without light. ``pulses``: static light of the first
    and of the second pulse, counts above ``dark``; None where the recording names none. ``unusable``: pixels that give
    no equation."""

    sensor: Sensor
    dark: Image
    pulses: tuple[Image, Image] | None
    unusable: NDArray[np.bool_]

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

        Particles add as much where static light is bright as elsewhere: what is left has the same median in both. 1
        where static light is nowhere bright against that.
        """
        assert self.pulses is not None
        static = self.pulses[pulse]
        usable = ~self.unusable & (counts < self.sensor.full_scale)
        bright = usable & (static > BRIGHT * static[usable].max(initial=0.0))
        dim = usable & (static <= np.median(static[usable]))
        if np.count_nonzero(bright) < FEWEST or not dim.any():
            return 1.0
        light, scale = counts - self.dark, 1.0
        for _ in range(3):
            particles = float(np.median(light[dim] - scale * static[dim]))
            spread = float(np.median(np.abs(light[dim] - scale * static[dim] - particles)))
            if np.median(static[bright]) < CLEARLY * max(spread, 1.0):
                return 1.0
            scale = float(np.clip(np.median((light[bright] - particles) / static[bright]), *SCALES))
        return scale


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
