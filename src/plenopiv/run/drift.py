"""The drift of the microlens array of a recording whose experiment file says "auto"."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from plenopiv.calibration.drift import DriftFit, find_drift, light_of
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.recording import Recording

MOST = 8  # frames whose light is put together, spread over the recording


def with_drift(camera: PlenopticCamera, recording: Recording) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The ``camera``, whose lattice is the white image's, with the lattice that the frames show, and what was found:
    nothing without a white image, a "drift" of None where the frames do not show it."""
    white = recording.white()
    if white is None:
        return camera, {}
    above = white - np.float32(recording.sensor.black_level)
    found = find_drift(light_of(recording, chosen(recording)), above, camera, recording.unusable)
    if found is None:
        return camera, {"drift": None}
    return found.drift.of(camera) if found.drift else camera, {"drift": stated(found)}


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


def stated(found: DriftFit) -> dict[str, Any]:
    """What summary.json holds of a drift."""
    return {
        "shift_px": list(found.drift.shift_px),
        "turn_deg": found.drift.turn_deg,
        "scale": found.drift.scale,
        "shift_std_px": found.shift_std_px,
        "turn_std_deg": found.turn_std_deg,
        "scale_std": found.scale_std,
        "regions_off_px": found.scatter_px,
    }
