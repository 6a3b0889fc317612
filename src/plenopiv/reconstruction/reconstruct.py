"""From a light field to a volume: candidates, MART, and the voxels that hold light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField
from plenopiv.projection.plenoptic.projector import Projector
from plenopiv.projection.protocol import Projection
from plenopiv.reconstruction.candidates import (
    dark_to_light,
    faintest_share,
    lit_threshold,
    most_light,
    typical_particle,
)
from plenopiv.reconstruction.mart import Progress, mart
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, Noise, dark_noise
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import SparseVolume

CLEARLY = 2.0  # thresholds: noise alone does not reach so high
FEWEST_LIT = 1e-4  # share of such pixels below which a frame counts as empty
SMALLEST_FLOOR = 0.5  # counts: digitisation alone leaves 0.3
THIN = 0.3  # of the mean voxel: fainter ones are left out


@dataclass(frozen=True)
class Reconstruction:
    """A reconstructed volume and how it was reached.

    ``threshold`` counts, ``particle`` counts of a typical particle in a pixel that it lights wholly in focus (0 where
    it was not measured), ``noise`` of the pixels; ``candidates`` the share of voxels that DRT left; ``residuals`` RMS
    in counts met by each round.
    """

    volume: SparseVolume
    threshold: float
    particle: float
    noise: Noise
    candidates: float
    residuals: tuple[float, ...]


def reconstruct(
    lightfield: LightField,
    projector: Projector,
    settings: ReconstructionSettings,
    *,
    counts_per_electron: float = NO_WHITE_IMAGE,
    name: str = "frame",
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct one frame. ``counts_per_electron``: of its shot noise (``noise.counts_per_electron``).

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles.
    """
    noise = Noise(dark_noise(lightfield), counts_per_electron)
    left = left_by_tracing(lightfield, projector, settings, noise, name)
    some_left(left.volume, left.threshold, name)
    share = left.volume.occupancy
    volume, residuals = corrected(lightfield.values, projector, left.volume, settings, noise, progress)
    return Reconstruction(volume, left.threshold, left.particle, noise, share, residuals)


class Left(NamedTuple):
    """Voxels to start from, the rest as in ``Reconstruction``."""

    volume: SparseVolume
    threshold: float
    particle: float


def left_by_tracing(
    lightfield: LightField, projector: Projector, settings: ReconstructionSettings, noise: Noise, name: str
) -> Left:
    """The voxels that dense ray tracing leaves of one camera's frame, or all that it sees.

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles.
    """
    threshold = lit_threshold(lightfield, noise) if settings.threshold is None else settings.threshold
    clearly_lit = np.count_nonzero(lightfield.values > CLEARLY * threshold)
    if clearly_lit < FEWEST_LIT * np.count_nonzero(lightfield.layout.seen):
        raise PlenoPIVError(
            f"{name}: no particles: hardly a pixel is {CLEARLY * threshold:.0f} counts above the black level; "
            "check the exposure, sensor.black_level and reconstruction.threshold"
        )
    particle = 0.0
    if settings.method == "mart":
        volume = projector.seen_voxels()
    elif settings.candidates == "product":
        volume = projector.voxels_within(dark_to_light(lightfield, threshold), 1.0)
    else:
        particle = typical_particle(lightfield, projector, noise) * projector.light_in_focus
        if settings.threshold is None:
            threshold = max(faintest_share(lightfield, particle) * particle, threshold)
        volume = projector.voxels_within(most_light(lightfield, noise), threshold / projector.light_in_focus)
    return Left(volume, threshold, particle)


def some_left(volume: SparseVolume, threshold: float, name: str) -> None:
    """Raise PlenoPIVError where a frame's volume lists no voxel."""
    if volume.column.size == 0:
        raise PlenoPIVError(
            f"{name}: dense ray tracing leaves no voxel; lower reconstruction.threshold ({threshold:.0f} counts) "
            'or use reconstruction.method = "mart"'
        )


def corrected(
    values: NDArray[np.float32],
    projector: Projection,
    volume: SparseVolume,
    settings: ReconstructionSettings,
    noise: Noise,
    progress: Progress | None = None,
    times: float = 1.0,
) -> tuple[SparseVolume, tuple[float, ...]]:
    """MART on the listed voxels, which all start with the same light, and the residual of each round. ``times``: how
    often ``values`` hold the volume's light, as of several cameras; ``noise``: of their pixels."""
    light = float(values.sum(dtype=np.float64)) / times
    volume.values[:] = max(light, 1.0) / volume.column.size
    volume, residuals = mart(
        values,
        projector,
        volume,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        floor=max(noise.dark, SMALLEST_FLOOR),
        thin=THIN,
        seed=settings.seed,
        overwrite=True,
        progress=progress,
    )
    return volume, tuple(residuals)
