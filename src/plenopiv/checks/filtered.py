"""Whether a camera's software smoothed frames or compressed them with losses: neighbouring pixels are then equal far
more often than they differ by one or two counts, which no noise makes.

Of raw frames, dim and bright, pairs of neighbours are as often equal as they differ by any one number of counts, to a
fourth; after a median filter of 3 x 3 twenty times as often. Where a file holds only every so many-th count, as of 12
bits in the upper part of 16 or scaled to fill it, counts are those of the camera.
"""

from __future__ import annotations

from dataclasses import replace
from math import log2

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding
from plenopiv.sensor import Sensor

LIT = 20.0  # counts above the black level: where photons make noise
STEPS = 4  # counts of difference that equal neighbours are compared with
SMALL = 5.0  # per cent of the differences between one count that occurs and the next: bad pixels have others
FEWEST = 2000  # pairs of neighbours that differ by so much
TOO_OFTEN = 4.0


def of_frame(counts: NDArray, sensor: Sensor, name: str) -> Finding | None:
    """A finding on a frame that was filtered, or else on one whose counts are in the upper bits of what is stated."""
    apart = between_counts(counts)
    bits = max(sensor.bit_depth - round(log2(apart)), 1)
    camera = replace(sensor, bit_depth=bits, black_level=sensor.black_level / apart)
    found = finding(equal_neighbours(np.round(counts / apart).astype(np.int32), camera), name)
    if found is not None or apart < 2 or sensor.bit_depth != 16 or not log2(apart).is_integer():
        return found
    words = f"counts of {name} are multiples of {apart:.0f}: {bits} bits in the upper part of 16"
    words += f', which camera.sensor.bit_depth = {bits} and alignment = "high" say'
    return Finding("upper-bits", "good", words, float(bits), "bits")


def between_counts(counts: NDArray) -> float:
    """By how much a count that occurs is above the next lower one: 1 of raw counts."""
    steps = np.diff(np.unique(counts))
    if not steps.size:
        return 1.0
    small = float(np.percentile(steps, SMALL))
    return float(np.mean(steps[steps < 1.5 * small]))


def equal_neighbours(counts: NDArray, sensor: Sensor) -> float | None:
    """How many times as often lit neighbours in a row of a frame are equal as they differ by a given small number of
    counts; None where too few are lit."""
    a, b = counts[:, :-1].astype(np.int32), counts[:, 1:].astype(np.int32)
    lit = (np.minimum(a, b) > sensor.black_level + LIT) & (np.maximum(a, b) < sensor.full_scale)
    found = np.bincount(np.minimum(np.abs(a - b)[lit], STEPS + 1), minlength=STEPS + 2)
    differ = int(found[1 : STEPS + 1].sum())
    if differ + found[0] < FEWEST:
        return None
    return float(found[0] / max(differ / (2 * STEPS), 1.0))  # a difference has two signs


def finding(times: float | None, name: str) -> Finding | None:
    """A finding where neighbours in frame ``name`` are equal too often."""
    if times is None or times < TOO_OFTEN:
        return None
    return Finding(
        "filtered",
        "warning",
        f"neighbouring pixels of {name} are equal {times:.0f} times as often as noise makes them: it was filtered, or "
        "compressed with losses",
        times,
        "times",
        "save the raw counts: switch off noise reduction, sharpening and lossy compression in the camera's software",
    )
