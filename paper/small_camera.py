"""The paper's small camera and volume (section 3), and one reconstruction with MART or DRT-MART.

31 x 31 square microlenses of 77 um on 448 x 448 px, PMR 14, M = -1; 385 x 385 x 57 voxels of 5.5 x 5.5 x 77 um around
the focus. MART and DRT-MART differ in the voxels that they start from, and in nothing else.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from plenopiv.cameras.presets import preset
from plenopiv.lightfield import LightField, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import dark_to_light, most_light
from plenopiv.reconstruction.mart import mart
from plenopiv.reconstruction.noise import Noise
from plenopiv.reconstruction.reconstruct import SMALLEST_FLOOR
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles, pixels_lit_in_focus
from plenopiv.volume import SparseVolume, VoxelGrid

Method = Literal["mart", "bound", "product"]

CAMERA = preset("pmr14")
LAYOUT = layout(CAMERA)
VOXEL_MM = (0.0055, 0.0055, 0.077)  # a pixel wide, a microlens pitch deep
ACROSS, PLANES = 385, 57  # voxels along x and y, along z
ELECTRONS = 400.0  # of a particle in focus, in each pixel that it lights
LIGHT = ELECTRONS * pixels_lit_in_focus(CAMERA)  # of a particle, all its pixels together
SETTINGS = ReconstructionSettings()


@dataclass(frozen=True)
class Found:
    """A reconstructed volume, the number of voxels that it started from, and the seconds from light field to volume."""

    volume: SparseVolume
    started: int
    seconds: float


def grid(across: int = ACROSS) -> VoxelGrid:
    """The paper's voxels; ``across``: fewer of them along x and y, about the axis."""
    limits = [(-n * d / 2, n * d / 2) for n, d in zip((across, across, PLANES), VOXEL_MM, strict=True)]
    return VoxelGrid.covering(*limits, VOXEL_MM)


def noise_free(position_mm: ArrayLike, rays: int) -> LightField:
    """What the pixels expect of particles at (n, 3) mm, each LIGHT electrons and one count an electron."""
    particles = Particles(np.atleast_2d(position_mm), np.float64(LIGHT))
    return decode(particle_image(CAMERA, particles, rays=rays) + CAMERA.sensor.black_level, LAYOUT)


def reconstructed(
    lightfield: LightField,
    projector: PlenopticProjector,
    method: Method,
    *,
    faintest: float,
    lit: float = 1.0,
    noise: Noise | None = None,
    rounds: int = SETTINGS.iterations,
    thin: float = 0.0,
) -> Found:
    """One frame by MART on all voxels that are seen, or on those that DRT leaves ("bound", "product").

    ``faintest``: light (counts, all pixels together) of the faintest particle that "bound" keeps; ``lit``: counts above
    which "product" takes a pixel as lit; ``noise``: of the pixels, none to speak of if left out.
    """
    noise = noise or Noise(0.0)
    begin = time.perf_counter()
    if method == "mart":
        volume = projector.visible_voxels()
    elif method == "product":
        volume = projector.candidates(dark_to_light(lightfield, lit), 1.0)
    else:
        volume = projector.candidates(most_light(lightfield, noise), faintest)
    started = volume.column.size
    volume.values[:] = float(lightfield.values.sum(dtype=np.float64)) / max(started, 1)
    floor = max(noise.dark, SMALLEST_FLOOR)
    relaxation, seed = SETTINGS.relaxation, SETTINGS.seed
    volume, _ = mart(
        lightfield.values,
        projector,
        volume,
        iterations=rounds,
        relaxation=relaxation,
        floor=floor,
        thin=thin,
        seed=seed,
        overwrite=True,
    )
    return Found(volume, started, time.perf_counter() - begin)
