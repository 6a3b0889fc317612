"""From electrons to counts: shot noise, read noise, gain, black level, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Orientation, Sensor, upright

ROWS_AT_A_TIME = 256  # bounds the memory of large sensors


@dataclass(frozen=True)
class SensorNoise:
    """What a sensor adds. ``gain`` in counts per electron, ``read_noise_electrons`` the RMS of a dark pixel."""

    gain: float = 0.5
    read_noise_electrons: float = 3.0
    shot: bool = True

    def __post_init__(self) -> None:
        if not self.gain > 0:
            raise PlenoPIVError(f"noise: gain = {self.gain} counts per electron, give a positive number")
        if not self.read_noise_electrons >= 0:
            raise PlenoPIVError(f"noise: read_noise_electrons = {self.read_noise_electrons}, give 0 or more")


def digitise(
    electrons: NDArray[np.float64],
    sensor: Sensor,
    noise: SensorNoise,
    rng: np.random.Generator,
    orientation: Orientation = "upright",
) -> NDArray[np.uint16]:
    """Counts that the sensor stores for mean electrons (rows, columns) of an upright image.

    counts = black level + gain (Poisson(electrons) + read noise), rounded and clipped to 0 .. 2^bits - 1. The result is
    turned to ``orientation``.
    """
    counts = np.empty(electrons.shape, np.uint16)
    for first in range(0, electrons.shape[0], ROWS_AT_A_TIME):
        rows = slice(first, first + ROWS_AT_A_TIME)
        mean = np.asarray(electrons[rows], np.float64)
        signal = rng.poisson(mean).astype(np.float64) if noise.shot else mean.copy()
        if noise.read_noise_electrons:
            signal += noise.read_noise_electrons * rng.standard_normal(signal.shape)
        signal = np.rint(noise.gain * signal + sensor.black_level)
        counts[rows] = np.clip(signal, 0, sensor.full_scale)
    return np.ascontiguousarray(upright(counts, orientation))
