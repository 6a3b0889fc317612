"""A synthetic recording of a sequence: frames equally spaced in time, with the truth beside them.

white.tif  frame-000.tif ...   uint16 counts
optics.json, experiment.toml, truth.json   as of a pair (``simulated_recording``)
truth_particles.npz            float64 ``position_mm`` (frames, n, 3): every particle in every frame
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.experiment_file import default_voxel_mm, experiment_toml
from plenopiv.simulation.flows import Velocity, advect, describe
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import (
    COMPLETE,
    Seeding,
    WhiteLight,
    as_json,
    checked_folder,
    checked_seed,
    optics_sheet,
    write_folder,
)
from plenopiv.simulation.white import white_image
from plenopiv.volume import Limits, within


@dataclass(frozen=True)
class SimulatedSequence:
    """What was written: the folder, and the particles in each frame."""

    directory: Path
    frames: tuple[Particles, ...]


def carried(particles: Particles, flow: Velocity, dt_s: float, frames: int) -> tuple[Particles, ...]:
    """The particles of a sequence of frames, ``particles`` being those half way between the first and the last."""
    out = []
    for start, steps, sign in ((frames // 2 - 1, frames // 2, -1.0), (frames // 2, frames - frames // 2, 1.0)):
        at = advect(flow, particles.position_mm, (start - 0.5 * (frames - 1)) * dt_s)
        some = []
        for step in range(steps):
            at = advect(flow, at, sign * dt_s) if step else at
            some.append(particles.moved_to(at))
        out += some[::-1] if sign < 0 else some
    return tuple(out)


def simulate_sequence(
    directory: str | Path,
    camera: PlenopticCamera,
    flow: Velocity,
    frames: int,
    *,
    dt_s: float,
    volume_mm: Limits,
    seeding: Seeding | None = None,
    particles: tuple[Particles, ...] | None = None,
    lit_mm: Limits | None = None,
    noise: SensorNoise | None = None,
    wavelength_nm: float = 532.0,
    rays: int = 20_000,
    voxel_mm: tuple[float, float, float] | None = None,
    windows: tuple[tuple[int, int, int], ...] = ((128, 128, 32), (64, 64, 16)),
    seed: int = 0,
    overwrite: bool = False,
) -> SimulatedSequence:
    """Simulate so many ``frames``, ``dt_s`` apart, and the white image, and write the recording's folder.

    As ``simulate_recording``; particles are seeded evenly half way in time, within the volume and
    ``seeding.margin_mm``, by default nothing. ``particles``: those of each frame, instead. ``lit_mm``: the box that is
    lit; particles that leave it are dark, and those that enter it shine. None: all shine.

    Raises:
        PlenoPIVError: as ``simulate_recording``; fewer than two frames.
    """
    seed = checked_seed(dt_s, seed)
    if frames < 2:
        raise PlenoPIVError(f"simulation: {frames} frame in a sequence, give at least two")
    names = [f"frame-{number:03d}" for number in range(frames)]
    out = checked_folder(directory, ("white.tif", *(f"{name}.tif" for name in names)), overwrite)
    seeding, noise = seeding or Seeding(), noise or SensorNoise()
    seeding_rng, white_rng, *noise_rngs = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2 + frames)
    )
    if particles is None:
        margin = seeding.margin_mm or (0.0, 0.0, 0.0)
        x, y, z = ((lo - m, hi + m) for (lo, hi), m in zip(volume_mm, margin, strict=True))
        middle = seed_box(
            camera,
            (x, y, z),
            seeding.particles_per_microlens,
            seeding_rng,
            electrons=seeding.electrons,
            electrons_per_pixel=None if seeding.electrons is not None else seeding.electrons_per_pixel,
            electrons_spread=seeding.electrons_spread,
            diameter_mm=seeding.diameter_mm,
        )
        particles = carried(middle, flow, dt_s, frames)
    flat = white_image(camera, WhiteLight().electrons_per_pixel, diffraction_nm=wavelength_nm)
    images: dict[str, NDArray[np.uint16]] = {"white": digitise(flat, camera.sensor, noise, white_rng)}
    for number, (name, frame) in enumerate(zip(names, particles, strict=True)):
        light = particle_image(
            camera, _lit(frame, lit_mm), rays=rays, seed=frames * seed + number, diffraction_nm=wavelength_nm
        )
        light += seeding.background_electrons
        images[name] = digitise(light, camera.sensor, noise, noise_rngs[number])
    kind, parameters = describe(flow)
    truth = {"flow": kind, "seed": seed, "frames": frames, "flow_parameters": parameters}
    texts = {
        "optics.json": as_json(
            optics_sheet(camera, "upright", dt_s, wavelength_nm, seeding.particles_per_microlens, volume_mm)
        ),
        "truth.json": as_json(truth),
        COMPLETE: experiment_toml(
            camera,
            "upright",
            dt_s,
            volume_mm,
            voxel_mm or default_voxel_mm(camera),
            windows,
            images='frames = "frame-*.tif"',
        ),
    }
    positions = np.stack([frame.position_mm for frame in particles])
    write_folder(out, images, {"truth_particles": {"position_mm": positions}}, texts)
    return SimulatedSequence(out, particles)


def _lit(particles: Particles, lit_mm: Limits | None) -> Particles:
    """Those within the box that is lit."""
    if lit_mm is None:
        return particles
    inside = within(particles.position_mm, lit_mm)
    return Particles(particles.position_mm[inside], particles.electrons[inside], particles.diameter_mm)
