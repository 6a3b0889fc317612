"""From a light field to a volume: candidates, MART, and the voxels that hold light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField
from plenopiv.projection.projector import Projector
from plenopiv.reconstruction.candidates import dark_noise, lit_threshold
from plenopiv.reconstruction.mart import Progress, mart
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import SparseVolume

CLEARLY = 2.0  # thresholds: noise alone does not reach so high
FEWEST_LIT = 1e-4  # share of such pixels below which a frame counts as empty
SMALLEST_FLOOR = 0.5  # counts: digitisation alone leaves 0.3
FAINTEST = 0.2  # of the dark noise: a voxel that gives less than this in each of its pixels is left out


@dataclass(frozen=True)
class Reconstruction:
    """A reconstructed volume and how it was reached.

    ``threshold`` counts; ``candidates`` the share of voxels that DRT left; ``residuals`` RMS in counts met by each
    round.
    """

    volume: SparseVolume
    threshold: float
    candidates: float
    residuals: tuple[float, ...]


def reconstruct(
    lightfield: LightField,
    projector: Projector,
    settings: ReconstructionSettings,
    *,
    name: str = "frame",
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct one frame.

    Raises:
        PlenoPIVError: the frame ``name`` shows no particles.
    """
    threshold = lit_threshold(lightfield) if settings.threshold is None else settings.threshold
    lit = lightfield.values > threshold
    clearly_lit = np.count_nonzero(lightfield.values > CLEARLY * threshold)
    if clearly_lit < FEWEST_LIT * np.count_nonzero(lightfield.layout.seen):
        raise PlenoPIVError(
            f"{name}: no particles: hardly a pixel is {CLEARLY * threshold:.0f} counts above the black level; "
            "check the exposure, sensor.black_level and reconstruction.threshold"
        )
    if settings.method == "drt-mart":
        volume = projector.lit_voxels(lit, settings.tolerance_px)
    else:
        volume = projector.every_voxel()
    alive = volume.column.size
    if alive == 0:
        raise PlenoPIVError(
            f"{name}: dense ray tracing leaves no voxel; lower reconstruction.threshold ({threshold:.0f} counts) "
            'or use reconstruction.method = "mart"'
        )
    volume.values[:] = max(float(lightfield.values.sum(dtype=np.float64)), 1.0) / alive
    floor = max(dark_noise(lightfield), SMALLEST_FLOOR)
    volume, residuals = mart(
        lightfield.values,
        projector,
        volume,
        iterations=settings.iterations,
        relaxation=settings.relaxation,
        floor=floor,
        faintest=FAINTEST * floor / projector.light_share,
        seed=settings.seed,
        progress=progress,
    )
    return Reconstruction(volume, threshold, alive / projector.grid.size, tuple(residuals))
