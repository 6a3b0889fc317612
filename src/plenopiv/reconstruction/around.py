"""From the light fields of several plenoptic cameras around a volume to the volume: the same candidates and MART.

A camera tells depth less well than what is across its line of sight. A second one at a right angle sees the first one's
depth across its own. A voxel stays where dense ray tracing leaves it in every camera; MART then takes the views of all
cameras in one random order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField
from plenopiv.projection.several_cameras import CamerasAround
from plenopiv.reconstruction.mart import Progress
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, Noise, dark_noise
from plenopiv.reconstruction.reconstruct import Reconstruction, corrected, left_by_tracing, some_left
from plenopiv.reconstruction.settings import ReconstructionSettings


def reconstruct_around(
    lightfields: Sequence[LightField],
    cameras: CamerasAround,
    settings: ReconstructionSettings,
    *,
    counts_per_electron: float = NO_WHITE_IMAGE,
    name: str = "frame",
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct one frame from the light field of each camera, taken at the same time. What is measured of pixels and
    particles is the mean over the cameras.

    Raises:
        PlenoPIVError: a light field is missing; the frame ``name`` shows no particles, or none in the same place.
    """
    if len(lightfields) != len(cameras.projectors):
        raise PlenoPIVError(f"{name}: {len(lightfields)} light fields for {len(cameras.projectors)} cameras")
    noises = [Noise(dark_noise(lightfield), counts_per_electron) for lightfield in lightfields]
    each = [
        left_by_tracing(lightfield, projector, settings, noise, f"{name}, camera {number}")
        for number, (lightfield, projector, noise) in enumerate(
            zip(lightfields, cameras.projectors, noises, strict=True), 1
        )
    ]
    for number, left in enumerate(each, 1):
        some_left(left.volume, left.threshold, f"{name}, camera {number}")
    volume = cameras.left_by_all([left.volume for left in each])
    if volume.column.size == 0:
        raise PlenoPIVError(
            f"{name}: no voxel is left by all cameras; check how they are mounted, and that the frames belong together"
        )
    noise = Noise(float(np.mean([n.dark for n in noises])), counts_per_electron)
    threshold, particle = (float(np.mean(values)) for values in zip(*(left[1:] for left in each), strict=True))
    share, values = volume.occupancy, cameras.values_of(lightfields)
    volume, residuals = corrected(values, cameras, volume, settings, noise, progress, len(lightfields))
    return Reconstruction(volume, threshold, particle, noise, share, residuals)
