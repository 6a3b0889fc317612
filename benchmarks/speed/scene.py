"""What is reconstructed: one frame of the paper's PMR 14 camera, as large as a volume asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.lightfield import LightField, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import pixels_lit_in_focus, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

ELECTRONS, SPREAD, BACKGROUND = (
    400.0,
    0.25,
    4.0,
)  # in a pixel that a particle lights in focus; between particles; everywhere
NOISE = SensorNoise(0.5, 3.0)  # counts per electron, read noise in electrons
RAYS = 4000  # per particle
STEP = 64  # pixels by which a sensor grows until every view sees the volume


@dataclass(frozen=True)
class Scene:
    """A volume of ``shape`` (nx, ny, nz) voxels of ``voxel_mm`` around the focus, ``ppm`` particles per microlens.

    ``pixels``: columns and rows of the sensor; None for the least, in steps, on which every view sees the volume.
    """

    shape: tuple[int, int, int]
    voxel_mm: tuple[float, float, float]
    ppm: float = 1.0
    pixels: tuple[int, int] | None = None
    seed: int = 3

    @cached_property
    def limits(self):
        """Outer faces of the volume, mm."""
        return tuple((-n * d / 2, n * d / 2) for n, d in zip(self.shape, self.voxel_mm, strict=True))

    @cached_property
    def camera(self) -> PlenopticCamera:
        """PMR 14, square microlenses, M = -1."""
        camera = preset("pmr14")
        if self.pixels is not None:
            return replace(camera, sensor=replace(camera.sensor, columns=self.pixels[0], rows=self.pixels[1]))
        columns = rows = STEP
        while True:
            camera = replace(camera, sensor=replace(camera.sensor, columns=columns, rows=rows))
            x, y = (min(side) for side in seen_by_every_view_mm(camera, self.limits[2]))
            if x >= self.limits[0][1] and y >= self.limits[1][1]:
                return camera
            columns += STEP * (x < self.limits[0][1])
            rows += STEP * (y < self.limits[1][1])

    @cached_property
    def grid(self) -> VoxelGrid:
        """The voxels."""
        return VoxelGrid.covering(*self.limits, self.voxel_mm)

    @cached_property
    def lightfield(self) -> LightField:
        """One noisy frame as views."""
        camera, rng = self.camera, np.random.default_rng(self.seed)
        light = ELECTRONS * pixels_lit_in_focus(camera)
        particles = seed_box(camera, self.limits, self.ppm, rng, electrons=light, electrons_spread=SPREAD)
        mean = particle_image(camera, particles, rays=RAYS, seed=self.seed) + BACKGROUND
        return decode(digitise(mean, camera.sensor, NOISE, rng), layout(camera))

    @cached_property
    def projector(self) -> PlenopticProjector:
        """Exact areas, as a run has them."""
        return PlenopticProjector(self.lightfield.layout, self.grid)


LATERAL_MM, DEPTH_MM = 0.077 / 4.5, 0.077  # as runs have them by default: pitch / 4.5, and f_l / 4 M^2
FAHRINGER = Scene((300, 200, 200), (LATERAL_MM, LATERAL_MM, DEPTH_MM))


def small_camera(ppm: float) -> Scene:
    """The paper's 448 x 448 px and its volume of 385 x 385 x 57 voxels, a pixel wide and the microlens pitch deep."""
    return Scene((385, 385, 57), (0.0055, 0.0055, 0.077), ppm, (448, 448))
