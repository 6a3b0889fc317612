"""LF-PIV of the jet: simulated frames of one plenoptic camera, reconstructed and correlated as a run does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np
from comparison_settings import DT_S, LightFieldSetting, TomoSetting, TwoCamerasSetting, Window
from numpy.typing import NDArray

from plenopiv.accuracy import exact_volume
from plenopiv.cameras.coverage import seen_by_every_view_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.chain import Chain
from plenopiv.design.twin import NOISE, WAVELENGTH_NM, mounted, seeing
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.simulation.flows import Velocity
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.simulation.simulated_recording import Seeding, seed_pair
from plenopiv.volume import SparseVolume

if TYPE_CHECKING:
    import xarray as xr

Frames = tuple[Particles, Particles]
Setting = LightFieldSetting | TwoCamerasSetting | TomoSetting


@dataclass
class Clock:
    """Seconds by stage, of the wall's clock and of the processors."""

    wall_s: dict[str, float] = field(default_factory=dict)
    processor_s: dict[str, float] = field(default_factory=dict)
    _began: tuple[float, float] = field(default_factory=lambda: (perf_counter(), process_time()))

    def continued(self) -> Clock:
        """A clock of its own that has measured as much and goes on from now."""
        return Clock(dict(self.wall_s), dict(self.processor_s))

    def lap(self, stage: str) -> None:
        """What passed since the last lap belongs to ``stage``."""
        now = perf_counter(), process_time()
        for seconds, a, b in zip((self.wall_s, self.processor_s), self._began, now, strict=True):
            seconds[stage] = round(b - a + seconds.get(stage, 0.0), 2)
        self._began = now


@dataclass(frozen=True)
class Measured:
    """A velocity field, the particles of its two frames, and where windows are seen.

    ``field``: ``velocity_dataset``. ``half_mm``: half the last window along x, y, z. ``seen`` (nz, ny, nx): windows
    that every view, or every camera, sees wholly. ``candidates``: share of the voxels that MART started from.
    """

    field: xr.Dataset
    particles: Frames
    voxel_mm: tuple[float, float, float]
    half_mm: NDArray[np.float64]
    seen: NDArray[np.bool_]
    candidates: float
    clock: Clock


def correlation_of(
    setting: Setting, inner_window: Window | None = None, inner_overlap: float = CorrelationSettings.inner_overlap
) -> CorrelationSettings:
    """Three passes with the finest windows: the setting's last ones, as in the paper, or others within them."""
    inner = inner_window or setting.windows[-1]
    return CorrelationSettings(setting.windows, setting.overlap, inner, inner_overlap, fine_passes=3)


@dataclass(frozen=True)
class Reconstructed:
    """Both volumes of a measurement, and the chain that made them. ``seen``: of a field and half the last window, the
    windows that are seen; ``images``: of both frames, where they were reconstructed from any; the rest as in
    ``Measured``."""

    setting: Setting
    chain: Chain
    seen: Callable[[xr.Dataset, NDArray[np.float64]], NDArray[np.bool_]]
    particles: Frames
    volumes: tuple[SparseVolume, SparseVolume]
    candidates: float
    clock: Clock
    images: tuple[NDArray, ...] = ()

    def correlated(
        self, inner_window: Window | None = None, inner_overlap: float = CorrelationSettings.inner_overlap
    ) -> Measured:
        """The velocity field, in the setting's windows with or without sub-windows."""
        grid, clock = self.setting.grid, self.clock.continued()
        chain = replace(self.chain, correlation=correlation_of(self.setting, inner_window, inner_overlap))
        field = chain.velocity(*self.volumes, dt_s=DT_S).isel(time=0)
        clock.lap("correlation")
        half = 0.5 * np.array(self.setting.windows[-1]) * grid.voxel_mm
        return Measured(field, self.particles, grid.voxel_mm, half, self.seen(field, half), self.candidates, clock)


def camera_of(setting: LightFieldSetting) -> PlenopticCamera:
    """The camera, its sensor no larger than what the light of the volume needs, its lattice turned and off the axis."""
    return mounted(seeing(preset(setting.camera), setting.volume_mm))


def seeded(setting: LightFieldSetting, flow: Velocity, seed: int) -> Frames:
    """The particles in both frames, evenly strewn at mid-time."""
    seeding = Seeding(setting.particles_per_microlens)
    return seed_pair(camera_of(setting), flow, DT_S, setting.volume_mm, seeding, np.random.default_rng(seed))


def windows_seen(
    camera: PlenopticCamera, at_mm: tuple[NDArray, NDArray, NDArray], half_mm: NDArray
) -> NDArray[np.bool_]:
    """Whether every view sees the whole window about each vector, at the vector's depth; ``at_mm``: along the camera's
    x, y, z; (nz, ny, nx)."""
    x, y = seen_by_every_view_mm(camera, at_mm[2])
    in_x = np.abs(at_mm[0]) + half_mm[0] <= x[:, None] + 1e-9
    in_y = np.abs(at_mm[1]) + half_mm[1] <= y[:, None] + 1e-9
    return in_y[:, :, None] & in_x[:, None, :]


def seen_of_field(camera: PlenopticCamera, field: xr.Dataset, half_mm: NDArray) -> NDArray[np.bool_]:
    """``windows_seen`` of the vectors of a field."""
    return windows_seen(camera, (field.x.values, field.y.values, field.z.values), half_mm)


def exact_pair(setting: LightFieldSetting, particles: Frames, clock: Clock) -> list[SparseVolume]:
    """Volumes of Gaussians of three voxels in the place of reconstructed particles."""
    volumes = []
    for now in particles:
        values = exact_volume(now.position_mm, now.electrons, setting.grid).values
        lit = values > 0
        volumes.append(SparseVolume.from_mask(setting.grid, lit).with_values(values[lit]))
        clock.lap("simulation")
    return volumes


def exact_volumes(setting: LightFieldSetting, flow: Velocity, seed: int = 0) -> Reconstructed:
    """The same particles with exact volumes in place of reconstructed ones: what windows find at all."""
    clock, particles, camera = Clock(), seeded(setting, flow, seed), camera_of(setting)
    chain = Chain((camera,), setting.grid, ReconstructionSettings(focus_reach=0.0))  # no plane near focus is weaker
    a, b = exact_pair(setting, particles, clock)
    return Reconstructed(setting, chain, partial(seen_of_field, camera), particles, (a, b), a.occupancy, clock)


def reconstruct_light_field(setting: LightFieldSetting, flow: Velocity, seed: int = 0) -> Reconstructed:
    """Simulate and reconstruct as a run does. The lattice is known: calibration from a white image is left out."""
    clock, particles, camera = Clock(), seeded(setting, flow, seed), camera_of(setting)
    chain, rng = Chain((camera,), setting.grid, counts_per_electron=NOISE.gain), np.random.default_rng(seed + 1)
    frames, images = list[Reconstruction](), list[NDArray]()
    for number, now in enumerate(particles):
        light = particle_image(camera, now, rays=setting.rays, seed=2 * seed + number, diffraction_nm=WAVELENGTH_NM)
        counts = digitise(light + Seeding.background_electrons, camera.sensor, NOISE, rng)
        clock.lap("simulation")
        images.append(counts)
        frames.append(chain.reconstruct([counts]))
        clock.lap("reconstruction")
    a, b = (frame.volume for frame in frames)
    about = setting, chain, partial(seen_of_field, camera), particles, (a, b), frames[0].candidates, clock
    return Reconstructed(*about, tuple(images))
