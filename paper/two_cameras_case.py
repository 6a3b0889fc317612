"""LF-PIV of the jet with two plenoptic cameras at a right angle: the same cameras, particles, candidates and MART."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from comparison_settings import TwoCamerasSetting
from lightfield_case import Clock, Frames, Reconstructed, windows_seen
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.cameras.presets import preset
from plenopiv.chain import Chain
from plenopiv.design.twin import NOISE, WAVELENGTH_NM, mounted, seeing
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.simulation.simulated_recording import Seeding

if TYPE_CHECKING:
    import xarray as xr

POSES = (FRONT, SIDE)


def cameras_of(setting: TwoCamerasSetting) -> list[PlenopticCamera]:
    """Each with no more of its sensor than the light of the volume needs."""
    return [mounted(seeing(preset(setting.camera), m.limits(setting.volume_mm))) for m in POSES]


def both_see(cameras: list[PlenopticCamera], field: xr.Dataset, half_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether every view of both sees the whole window about each vector; (nz, ny, nx)."""
    front, side = cameras
    x, y, z = (field[c].values for c in "xyz")
    from_side = windows_seen(side, (-z, y, x), np.abs(SIDE.in_camera(half_mm)))  # by its own z, y and x
    return windows_seen(front, (x, y, z), half_mm) & np.transpose(from_side, (2, 1, 0))


def images_of(
    cameras: list[PlenopticCamera], frame: Frames, number: int, rays: int, seed: int, rng: np.random.Generator
) -> list[NDArray[np.uint16]]:
    """Counts of each camera in frame ``number`` of the pair."""
    out = []
    for n, (camera, pose) in enumerate(zip(cameras, POSES, strict=True)):
        own = frame[number].moved_to(pose.in_camera(frame[number].position_mm))
        light = particle_image(camera, own, rays=rays, seed=4 * seed + 2 * n + number, diffraction_nm=WAVELENGTH_NM)
        out.append(digitise(light + Seeding.background_electrons, camera.sensor, NOISE, rng))
    return out


def reconstruct_by_two(setting: TwoCamerasSetting, particles: Frames, seed: int = 0) -> Reconstructed:
    """Simulate and reconstruct. The lattices and where the cameras stand are known."""
    clock, cameras = Clock(), cameras_of(setting)
    chain = Chain(tuple(cameras), setting.grid, counts_per_electron=NOISE.gain, poses=POSES)
    frames, rng = list[Reconstruction](), np.random.default_rng(seed + 1)
    for number in range(2):
        counts = images_of(cameras, particles, number, setting.rays, seed, rng)
        clock.lap("simulation")
        frames.append(chain.reconstruct(counts))
        clock.lap("reconstruction")
    a, b = (frame.volume for frame in frames)
    return Reconstructed(setting, chain, partial(both_see, cameras), particles, (a, b), frames[0].candidates, clock)
