"""Four pinhole cameras around a box of particles, as the paper's section 4 and Elsinga et al. (2006) have them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from plenopiv.calibration.pinhole_fit import calibrate_pinhole
from plenopiv.cameras.pinhole import PinholeCamera, looking_at
from plenopiv.sensor import Sensor
from plenopiv.simulation.board import board_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

SCALE_MM_PX = 0.074  # the paper's
DISTANCE_MM = 600.0
ELECTRONS = 2000.0  # of a particle in each camera: about 350 in its brightest pixel
NOISE = SensorNoise(0.5, 3.0)  # counts per electron, read noise in electrons
BLACK_LEVEL = 60.0
RIM = 2  # voxels at the faces of the volume that are not seeded
BOARD_DEPTHS = 3  # planes in which the board is imaged, through the depth of the volume


@dataclass(frozen=True)
class Scene:
    """``shape`` (nx, ny, nz) cubic voxels of a pixel's size, ``ppp`` particles per pixel of the seeded x-y face.

    Cameras at the corners of a square, turned by +-``angle_deg`` about y and about x, each with a sensor of
    ``pixels`` (columns, rows) that sees all of the volume; the first ``cameras`` of them, in the order in which 2 are
    opposite. ``diameter_px``: of particle images. ``laboratory``: sensors with noise and cameras that are calibrated
    from images of a board, else electrons without noise and the cameras as they are.
    """

    shape: tuple[int, int, int]
    pixels: tuple[int, int]
    ppp: float
    angle_deg: float = 20.0
    cameras: int = 4
    diameter_px: float = 2.7
    laboratory: bool = False
    seed: int = 0

    @cached_property
    def grid(self) -> VoxelGrid:
        half = [0.5 * n * SCALE_MM_PX for n in self.shape]
        return VoxelGrid.covering(*((-h, h) for h in half), (SCALE_MM_PX,) * 3)

    @cached_property
    def true_cameras(self) -> list[PinholeCamera]:
        sensor = Sensor(*self.pixels, 0.0055, 12, BLACK_LEVEL if self.laboratory else 0.0)
        corners = ((-1, -1), (1, 1), (-1, 1), (1, -1))[: self.cameras]
        turned = [{"about_y_deg": y * self.angle_deg, "about_x_deg": x * self.angle_deg} for y, x in corners]
        return [looking_at((0, 0, 0), sensor, scale_mm_px=SCALE_MM_PX, distance_mm=DISTANCE_MM, **t) for t in turned]

    @cached_property
    def known_cameras(self) -> list[PinholeCamera]:
        """What the reconstruction is given."""
        if not self.laboratory:
            return self.true_cameras
        low, high = self.grid.limits_mm()[2]
        depths = np.linspace(low, high, BOARD_DEPTHS)
        pitch = 0.1 * self.pixels[0] * SCALE_MM_PX
        board = {"pitch_mm": pitch, "diameter_mm": 0.4 * pitch, "origin_diameter_mm": 0.6 * pitch}
        side = 0.85 * min(self.pixels) * SCALE_MM_PX
        rng, found = np.random.default_rng(self.seed + 1), []
        for camera in self.true_cameras:
            images = [board_image(camera, z, side_mm=side, blur_px=0.6, **board) for z in depths]
            counts = [digitise(image, camera.sensor, NOISE, rng) for image in images]
            found.append(calibrate_pinhole(counts, depths, camera.sensor, pitch_mm=pitch).camera)
        return found

    @cached_property
    def place_mm(self) -> NDArray[np.float64]:
        """Particles (n, 3)."""
        half = 0.5 * np.array(self.shape) - RIM
        count = round(self.ppp * 4 * half[0] * half[1])
        return SCALE_MM_PX * np.random.default_rng(self.seed).uniform(-half, half, (count, 3))

    def images(self, place_mm: NDArray[np.float64] | None = None) -> list[NDArray]:
        """One of each camera, of the particles or of these places."""
        particles = Particles(self.place_mm if place_mm is None else place_mm, ELECTRONS)
        mean = [pinhole_image(camera, particles, diameter_px=self.diameter_px) for camera in self.true_cameras]
        if not self.laboratory:
            return mean
        rng = np.random.default_rng(self.seed + 2)
        return [digitise(image, c.sensor, NOISE, rng) for image, c in zip(mean, self.true_cameras, strict=True)]

    def having(self, **changes) -> Scene:
        return replace(self, **changes)
