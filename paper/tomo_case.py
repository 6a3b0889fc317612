"""Tomo-PIV of the jet: simulated frames of four pinhole cameras, calibrated from a board, through the same MART and the
same correlation as the light field."""

from __future__ import annotations

from functools import partial
from itertools import product
from math import log, sqrt
from typing import TYPE_CHECKING

import numpy as np
from comparison_settings import DT_S, TomoSetting
from lightfield_case import Clock, Frames, Reconstructed
from numpy.typing import NDArray

from plenopiv.calibration.pinhole_fit import calibrate_pinhole
from plenopiv.cameras.pinhole import PinholeCamera, looking_at
from plenopiv.cameras.presets import BIT_DEPTH, BLACK_LEVEL, PIXEL_PITCH_MM
from plenopiv.chain import Chain
from plenopiv.design.twin import NOISE
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.reconstruction.settings import TOMOGRAPHY
from plenopiv.sensor import Sensor
from plenopiv.simulation.board import board_image
from plenopiv.simulation.flows import Velocity, advect
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.simulation.simulated_recording import Seeding

if TYPE_CHECKING:
    import xarray as xr

ELECTRONS = (
    2000.0  # of a particle in each camera: about 350 in its brightest pixel, as in a pixel lit in focus by LF-PIV
)
RIM_PX = 16  # beyond the volume's corners
BOARD_DEPTHS = 3
DOTS_ACROSS = 10  # of the board, in a camera's field


def cameras_of(setting: TomoSetting) -> list[PinholeCamera]:
    """The four cameras, their sensors no larger than the volume's image."""
    corners = np.array(list(product(*setting.volume_mm)))
    centre = 0.5 * (corners.min(0) + corners.max(0))
    cameras = []
    for about_y, about_x in product((-setting.angle_deg, setting.angle_deg), repeat=2):
        turned = {"about_y_deg": about_y, "about_x_deg": about_x}
        place = {"scale_mm_px": setting.scale_mm_px, "distance_mm": setting.distance_mm, **turned}
        whole = looking_at(centre, _sensor(setting.sensor_px, setting.sensor_px), **place)
        half = np.abs(whole.project(corners) - whole.sensor.axis).max(0)
        columns, rows = (min(2 * int(h + RIM_PX), setting.sensor_px) for h in half)
        cameras.append(looking_at(centre, _sensor(columns, rows), **place))
    return cameras


def _sensor(columns: int, rows: int) -> Sensor:
    return Sensor(columns, rows, PIXEL_PITCH_MM, BIT_DEPTH, BLACK_LEVEL)


def calibrated(cameras: list[PinholeCamera], setting: TomoSetting, rng: np.random.Generator) -> list[PinholeCamera]:
    """The cameras as noisy images of a dot board at several depths give them."""
    depths = np.linspace(*setting.volume_mm[2], BOARD_DEPTHS)
    found = []
    for camera in cameras:
        smaller = min(camera.sensor.columns, camera.sensor.rows) * setting.scale_mm_px
        pitch = smaller / DOTS_ACROSS
        board = {"pitch_mm": pitch, "diameter_mm": 0.4 * pitch, "origin_diameter_mm": 0.6 * pitch}
        images = [board_image(camera, z, side_mm=0.85 * smaller, blur_px=0.6, **board) for z in depths]
        counts = [digitise(image, camera.sensor, NOISE, rng) for image in images]
        found.append(calibrate_pinhole(counts, depths, camera.sensor, pitch_mm=pitch).camera)
    return found


def seeded(setting: TomoSetting, flow: Velocity, rng: np.random.Generator) -> Frames:
    """Particles at the setting's density in both frames, evenly strewn over the volume at mid-time."""
    assert setting.particles_per_pixel is not None
    lo, hi = np.array(setting.volume_mm).T
    width, height, _ = (hi - lo) / setting.scale_mm_px
    middle = rng.uniform(lo, hi, (round(setting.particles_per_pixel * width * height), 3))
    spread = sqrt(log(1 + Seeding.electrons_spread**2))
    light = ELECTRONS * np.exp(spread * rng.standard_normal(len(middle)) - 0.5 * spread**2)
    a, b = (Particles(advect(flow, middle, share * DT_S), light) for share in (-0.5, 0.5))
    return a, b


def as_bright(particles: Frames) -> Frames:
    """The particles of a light field with ELECTRONS in each camera on the mean."""
    mean = particles[0].electrons.mean()
    a, b = (Particles(p.position_mm, p.electrons * (ELECTRONS / mean)) for p in particles)
    return a, b


def windows_seen(cameras: list[PinholeCamera], field: xr.Dataset, half_mm: NDArray) -> NDArray[np.bool_]:
    """Whether every camera sees the eight corners of the window about each vector; (nz, ny, nx)."""
    z, y, x = np.meshgrid(field.z.values, field.y.values, field.x.values, indexing="ij")
    at = np.stack([x, y, z], -1)
    seen = np.ones(x.shape, bool)
    for camera in cameras:
        for corner in product((-1, 1), repeat=3):
            seen &= camera.sees(at + half_mm * corner)
    return seen


def reconstruct_tomo(
    setting: TomoSetting, flow: Velocity, particles: Frames | None = None, seed: int = 0
) -> Reconstructed:
    """Simulate, calibrate and reconstruct. ``particles``: those of a light field instead of its own."""
    clock, rng = Clock(), np.random.default_rng(seed + 2)
    a, b = seeded(setting, flow, rng) if particles is None else as_bright(particles)
    true_cameras = cameras_of(setting)
    clock.lap("simulation")
    cameras = calibrated(true_cameras, setting, rng)
    clock.lap("calibration")
    chain, frames = Chain(tuple(cameras), setting.grid, TOMOGRAPHY), list[Reconstruction]()
    for now in (a, b):
        light = [pinhole_image(camera, now, diameter_px=setting.diameter_px) for camera in true_cameras]
        stray = Seeding.background_electrons
        counts = [digitise(i + stray, c.sensor, NOISE, rng) for i, c in zip(light, true_cameras, strict=True)]
        clock.lap("simulation")
        frames.append(chain.reconstruct(counts))
        clock.lap("reconstruction")
    seen, candidates = partial(windows_seen, true_cameras), frames[0].candidates
    return Reconstructed(setting, chain, seen, (a, b), (frames[0].volume, frames[1].volume), candidates, clock)
