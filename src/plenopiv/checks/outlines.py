"""Whether micro-images end where the white image's do, which settles what light within them leaves in doubt.

Particles beside a narrow beam, or far out of focus, light one side of every micro-image. The pattern of a block is then
off although no microlens has moved (``fit``). Micro-images end where they did all the same (``calibration.drift``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.drift import find_drift
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.checks import fit
from plenopiv.checks.findings import Finding


def compared(
    frames: Sequence[NDArray],
    names: Sequence[str],
    white: NDArray,
    camera: PlenopticCamera,
    unusable: NDArray[np.bool_] | None,
) -> tuple[list[fit.Fit], list[Finding]]:
    """How microlenses of ``frames`` lie to those of the ``white`` image, and a finding on each; as for ``settled``."""
    fits = fit.fits(frames, white, camera.image_pitch_px, camera.sensor.black_level)
    found = [fit.finding(one, name) for one, name in zip(fits, names, strict=True)]
    each = zip(found, frames, names, strict=True)
    return fits, [settled(one, frame, name, white, camera, unusable) for one, frame, name in each]


def settled(
    finding: Finding,
    frame: NDArray,
    name: str,
    white: NDArray,
    camera: PlenopticCamera,
    unusable: NDArray[np.bool_] | None,
) -> Finding:
    """``fit``'s finding on the ``frame`` of that name, or where it says that microlenses lie elsewhere, and outlines
    lie where they did, that they fit. ``camera``: with the lattice of the ``white`` image; both images upright, in
    counts."""
    if finding.name not in (fit.MOVED, fit.OTHER_CAMERA):
        return finding
    level = np.float32(camera.sensor.black_level)
    found = find_drift(frame - level, white - level, camera, unusable)
    if found is None or found.drift:
        return finding
    return fit.fitting(name, hypot(*found.measured.shift_px))
