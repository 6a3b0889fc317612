"""The drift of the microlens array of a recording whose experiment file says "auto"."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from math import hypot
from typing import Any

import numpy as np

from plenopiv.calibration.drift import SURE, WORTH_PX, DriftFit, find_drift, light_of
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording import Recording
from plenopiv.sensor import Sensor

MOST = 8  # frames whose light is put together, spread over the recording
ALIKE_PX = 2 * WORTH_PX  # by which drifts of one array may differ: frames may just show one that others just do not

Stated = Mapping[str, Any]  # a drift, as ``stated``


def with_drift(
    camera: PlenopticCamera, recording: Recording, before: Mapping[str, Any] | None = None
) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The ``camera``, whose lattice is the white image's, with the lattice that the frames show, and what was found:
    nothing without a white image, a "drift" of None where the frames do not show it. ``before``: what was found when
    the recording had other frames. Its drift stays where these frames show none that is another beyond doubt: a
    recording that grows gives a slightly different one, and pairs that were measured with the first are kept."""
    white = recording.white()
    if white is None:
        return camera, {}
    above = white - np.float32(recording.sensor.black_level)
    found = find_drift(light_of(recording, chosen(recording)), above, camera, recording.unusable)
    now: Stated | None = None if found is None else stated(found)
    if before is not None and "drift" in before and alike(now, before["drift"], camera.sensor):
        now = before["drift"]
    drift = drift_of(now)
    return drift.of(camera) if drift else camera, {"drift": now}


def chosen(recording: Recording) -> list[int]:
    """Numbers of readable frames, spread over the recording, those of the first readable pair among them."""
    first, bad = recording.first_readable_pair()
    others = [k for pair in recording.pairs for k in pair if k not in bad and k not in first]
    some = sorted(set(others))
    step = max(1, -(-len(some) // (MOST - 2)))
    out = list(first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        for k in some[::step]:
            try:
                recording.frame(k)
            except PlenoPIVError:
                continue
            out.append(k)
    return sorted(out)


def alike(one: Stated | None, other: Stated | None, sensor: Sensor) -> bool:
    """Whether two drifts may be of one array: they differ by less than they are known, or than makes a difference."""
    a, b = drift_of(one), drift_of(other)
    shift = a.shift_px[0] - b.shift_px[0], a.shift_px[1] - b.shift_px[1]
    apart = ArrayDrift(shift, a.turn_deg - b.turn_deg, a.scale - b.scale)
    return apart.most_px(sensor) <= max(ALIKE_PX, SURE * hypot(_std_px(one, sensor), _std_px(other, sensor)))


def drift_of(found: Stated | None) -> ArrayDrift:
    """The drift that was ``stated``, to the last bit; none where frames do not show it."""
    return ArrayDrift() if found is None else ArrayDrift(tuple(found["shift_px"]), found["turn_deg"], found["scale"])


def _std_px(found: Stated | None, sensor: Sensor) -> float:
    """Standard deviation of a drift in a corner of the sensor."""
    if found is None:
        return 0.0
    shift = (found["shift_std_px"],) * 2
    return ArrayDrift(shift, found["turn_std_deg"], found["scale_std"]).most_px(sensor)


def stated(found: DriftFit) -> dict[str, Any]:
    """What summary.json holds of a drift; by the alphabet, as a manifest gives it back."""
    return {
        "regions_off_px": found.scatter_px,
        "scale": found.drift.scale,
        "scale_std": found.scale_std,
        "shift_px": list(found.drift.shift_px),
        "shift_std_px": found.shift_std_px,
        "turn_deg": found.drift.turn_deg,
        "turn_std_deg": found.turn_std_deg,
    }
