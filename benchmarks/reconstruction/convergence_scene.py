"""What is recorded: a pair of frames of a uniform shift, and a frame of particles that stand alone.

The camera is the paper's (PMR 14, M = -1, f_m = 50 mm) behind a small sensor: a hexagonal lattice turned by 0.1 degrees
whose micro-images are 14.04 px apart. The volume reaches as far as every view sees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import floor, radians

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.lightfield import Layout, layout
from plenopiv.sensor import Sensor
from plenopiv.simulation.experiment_file import default_voxel_mm
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Limits, Particles, pixels_lit_in_focus, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

SHIFT_VOXELS = (2.3, -1.6, 1.37)  # x, y, z between the two frames
WINDOWS = ((64, 64, 24), (40, 40, 16))  # of the correlation, coarse to fine
PIXEL_MM = 0.0055
WAVELENGTH_NM = 532.0
BACKGROUND_ELECTRONS = 4.0
ELECTRONS_SPREAD = 0.25
ALONE_VOXELS = (14.0, 14.0, 12.0)  # particles that stand alone are further apart than this along x, y or z


@dataclass(frozen=True)
class Condition:
    """Light, noise and density of a recording. ``electrons`` in a pixel lit by a particle in focus, ``ppm`` particles
    per microlens; ``alone`` puts that many particles apart instead."""

    name: str
    says: str
    ppm: float = 1.0
    electrons: float = 400.0
    read_noise: float = 3.0
    gain: float = 0.5
    alone: int = 0
    columns: int = 600
    rows: int = 480
    z_mm: tuple[float, float] = (-4.0, 4.0)
    seed: int = 7

    @cached_property
    def camera(self) -> PlenopticCamera:
        """The camera with its true lattice and the matched aperture."""
        lattice = Lattice("hexagonal", 14 * PIXEL_MM, radians(0.1), (0.0306, 0.0212))
        sensor = Sensor(self.columns, self.rows, PIXEL_MM, 12, 60)
        unmatched = PlenopticCamera(MainLens(50.0, 1.0, -1.0), lattice, 0.308, sensor)
        return replace(unmatched, main_lens=MainLens(50.0, unmatched.matched_aperture_mm, -1.0))

    @cached_property
    def layout(self) -> Layout:
        """The raw pixels as views."""
        return layout(self.camera)

    @cached_property
    def volume_mm(self) -> Limits:
        """What every view sees, down to whole hundredths of a mm."""
        x, y = (floor(100 * float(min(side))) / 100 for side in seen_by_every_view_mm(self.camera, self.z_mm))
        return (-x, x), (-y, y), self.z_mm

    @cached_property
    def grid(self) -> VoxelGrid:
        """Voxels of a pixel in the plane and f_l/M^2 a quarter in depth, as recordings have them by default."""
        return VoxelGrid.covering(*self.volume_mm, default_voxel_mm(self.camera))

    @cached_property
    def particles(self) -> tuple[Particles, ...]:
        """Particles at the two frames, half the shift before and after mid-time; those alone have one frame."""
        rng = np.random.default_rng(self.seed)
        light = self.electrons * pixels_lit_in_focus(self.camera)
        if self.alone:
            return (Particles(self._apart(rng), np.full(self.alone, light)),)
        half = 0.5 * np.array(SHIFT_VOXELS) * self.grid.voxel_mm
        box = tuple((lo - abs(m), hi + abs(m)) for (lo, hi), m in zip(self.volume_mm, half, strict=True))
        middle = seed_box(self.camera, box, self.ppm, rng, electrons=light, electrons_spread=ELECTRONS_SPREAD)  # type: ignore[arg-type]
        return middle.moved_to(middle.position_mm - half), middle.moved_to(middle.position_mm + half)

    def _apart(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Places in the inner volume, each apart from all others along some axis."""
        lo, hi = np.array(self.volume_mm).T
        apart = np.array(ALONE_VOXELS) * self.grid.voxel_mm
        places: list[NDArray] = []
        while len(places) < self.alone:
            place = rng.uniform(lo + 0.6 * apart, hi - 0.6 * apart)
            if all((np.abs(place - other) > apart).any() for other in places):
                places.append(place)
        return np.array(places)

    @cached_property
    def mean_electrons(self) -> tuple[NDArray[np.float64], ...]:
        """Electrons that the pixels of each frame would hold without noise."""
        return tuple(
            particle_image(self.camera, p, diffraction_nm=WAVELENGTH_NM, seed=k) + BACKGROUND_ELECTRONS
            for k, p in enumerate(self.particles)
        )

    @cached_property
    def images(self) -> tuple[NDArray[np.float32], ...]:
        """The raw frames in counts, upright."""
        noise, rng = SensorNoise(self.gain, self.read_noise), np.random.default_rng(self.seed + 1)
        frames = (digitise(mean, self.camera.sensor, noise, rng) for mean in self.mean_electrons)
        return tuple(frame.astype(np.float32) for frame in frames)

    @cached_property
    def noise_counts(self) -> float:
        """RMS in counts of frame a's pixels about their mean: the residual of the true volume."""
        mean = self.camera.sensor.black_level + self.gain * self.mean_electrons[0]
        return float(np.sqrt(np.mean((self.images[0] - mean) ** 2)))


CONDITIONS = {
    c.name: c
    for c in (
        Condition("pair", "1 particle per microlens, 400 electrons in a lit pixel, read noise of 3"),
        Condition("dim", "the same with 80 electrons in a lit pixel, read noise of 5", electrons=80, read_noise=5),
        Condition("alone", "particles that stand alone", alone=60, seed=3),
    )
}
