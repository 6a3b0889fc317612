"""The main lens' blur of a recording whose experiment file says "auto"."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from plenopiv.cameras.coverage import middle_with
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVWarning
from plenopiv.lightfield import decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.lens_blur import LensBlur, lens_blur
from plenopiv.recording import Recording
from plenopiv.sensor import middle_of

MIDDLE_PX = 1600  # side of the sensor's middle, which has thousands of particles
UNKNOWN = (
    'main_lens.blur_mm = "auto": the first pair shows too few particles, or lit in too small a part of the field, to '
    "tell; the lens is taken as sharp"
)


def with_blur(chain: Chain, recording: Recording) -> tuple[PlenopticCamera, dict[str, Any]]:
    """The camera of a ``chain``, which takes it as sharp, with the blur that the particles of the first pair show, and
    what was found. Warns where they do not tell."""
    camera, found = chain.camera, list[LensBlur]()
    part = middle_with(camera, chain.lens_grid.limits_mm(), MIDDLE_PX)
    masked = chain.unusable[0] if chain.unusable else None
    where = layout(replace(camera, sensor=part), None if masked is None else middle_of(masked, part))
    projector = PlenopticProjector(where, chain.lens_grid, "1-ray")  # only its geometry is used
    for k in recording.first_readable_pair()[0]:
        each = lens_blur(decode(middle_of(recording.light(k)[0], part), where), projector)
        found += [] if each is None else [each]
    if not found:
        warnings.warn(UNKNOWN, PlenoPIVWarning, stacklevel=2)
        return camera, {"blur_mm": 0.0}
    both = LensBlur(*(float(np.mean([getattr(one, key) for one in found])) for key in ("blur_mm", "std_mm", "left")))
    blur = both.beyond_doubt(camera.lattice.pitch_mm)
    return replace(camera, blur_mm=blur), {"blur_mm": blur, "blur_std_mm": both.std_mm}
