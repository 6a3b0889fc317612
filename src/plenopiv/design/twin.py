"""A twin of a camera: simulated images of it, reconstructed, correlated and scored, as small as it may be.

Errors depend on depth, not on where in the field a window lies. So the twin has the camera's optics and depth, but
only as much sensor as some hundred vectors need, less or more than the camera's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, radians, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plenopiv.accuracy.velocity import Score, score_velocity
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.design.advice import Measurement, within
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.lattice import Lattice
from plenopiv.lightfield import decode, layout
from plenopiv.projection.projector import Projector
from plenopiv.reconstruction.chain import Reconstruction, reconstruct
from plenopiv.reconstruction.focus import focus_weight
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.simulation.flows import flow
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.recording import Seeding, seed_pair
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.velocity import velocity_dataset

if TYPE_CHECKING:
    import xarray as xr

VECTORS = 300  # judged, about
ACROSS = 3, 9  # vectors along x and along y, at least and at most
TURN_RAD, OFFSET = radians(0.1), (0.4, 0.28)  # of a lattice as they come: turned, its place in pitches off the axis
SHIFT = (1 / 12, -1 / 19, 1 / 11.7)  # displacement in last windows along x, y, z: no whole voxels
DT_S = 0.0005
RAYS = 4000  # a particle
WAVELENGTH_NM = 532.0
NOISE = SensorNoise()

Progress = Callable[[str, int, int], None]


class PlaneError(NamedTuple):
    """RMS error in voxels along x, y, z of the vectors at ``z_mm``."""

    z_mm: float
    rms: tuple[float, float, float]


@dataclass(frozen=True)
class Twin:
    """What was simulated, and how well it was measured.

    ``score``: voxels, over all windows and by thirds of depth, as ``docs/accuracy.md`` counts. ``planes``: by depth.
    ``candidates``: share of the voxels that dense ray tracing left.
    """

    camera: PlenopticCamera
    measurement: Measurement
    particles_per_microlens: float
    candidates: float
    score: Score
    planes: tuple[PlaneError, ...]


def cut(
    camera: PlenopticCamera, measurement: Measurement, vectors: int = VECTORS
) -> tuple[PlenopticCamera, Measurement]:
    """A sensor and a volume across, for about so many vectors; depth, voxels and windows as asked for."""
    window, (_, _, depth) = measurement.window_mm, measurement.limits_mm
    deep = max(2 * (depth[1] - depth[0]) / window[2] - 1, 1)
    across = min(max(ACROSS[0], ceil(sqrt(vectors / deep))), ACROSS[1])
    x, y = (0.5 * (across + 1) * side / 2 for side in window[:2])
    pixel = camera.sensor.pixel_pitch_mm / (1 + camera.image_scale)
    blur = [0.5 * camera.main_lens.aperture_mm * abs(float(camera.spread(z))) for z in depth]
    columns, rows = (
        2 * ceil(max(side * abs(float(camera.scale(z))) + b for z, b in zip(depth, blur, strict=True)) / pixel) + 2
        for side in (x, y)
    )
    pitch = camera.lattice.pitch_mm
    lattice = Lattice(camera.lattice.kind, pitch, TURN_RAD, (OFFSET[0] * pitch, OFFSET[1] * pitch))
    small = replace(camera, sensor=replace(camera.sensor, columns=columns, rows=rows), lattice=lattice)
    limits = (-x, x), (-y, y), depth
    nz, ny, nx = replace(measurement, limits_mm=limits).grid.shape
    windows = [within(window, (nx, ny, nz)) for window in measurement.windows]
    return small, replace(measurement, limits_mm=limits, windows=tuple(windows))


def twin(
    camera: PlenopticCamera,
    measurement: Measurement,
    *,
    seeding: Seeding | None = None,
    noise: SensorNoise = NOISE,
    vectors: int = VECTORS,
    seed: int = 0,
    progress: Progress | None = None,
) -> Twin:
    """Simulate a pair of frames of uniform motion, SHIFT of the last window, and measure it as a run with default
    settings does. Calibration is left out: the lattice is known. ``seeding``: default ``Seeding()``.

    Raises:
        PlenoPIVError: the frames show no particles, or nothing can be measured.
    """
    report = progress or (lambda stage, done, total: None)
    seeding = seeding or Seeding()
    small, cut_out = cut(camera, measurement, vectors)
    moved = [share * side for share, side in zip(SHIFT, cut_out.window_mm, strict=True)]
    motion = flow("uniform", velocity_m_s=[1e-3 * d / DT_S for d in moved])
    rng = np.random.default_rng(seed)
    pair = seed_pair(small, motion, DT_S, cut_out.limits_mm, seeding, rng)
    grid, where = cut_out.grid, layout(small)
    projector = Projector(where, grid)
    settings = ReconstructionSettings()
    weight = focus_weight(small, grid.axes()[2], settings.focus_reach)

    def volume(particles: Particles, name: str) -> Reconstruction:
        image_seed = 2 * seed + (name == "b")
        light = particle_image(small, particles, rays=RAYS, seed=image_seed, diffraction_nm=WAVELENGTH_NM)
        counts = digitise(light + seeding.background_electrons, small.sensor, noise, rng)
        name = f"twin at {seeding.particles_per_microlens:g} ppm, frame {name}"
        said = partial(report, name)
        gain = noise.gain
        return reconstruct(
            decode(counts, where), projector, settings, counts_per_electron=gain, name=name, progress=said
        )

    a, b = (volume(particles, name) for particles, name in zip(pair, "ab", strict=True))
    first, second = (found.volume.with_planes_scaled(weight) for found in (a, b))
    field = velocity_dataset(measure(first, second, CorrelationSettings(windows=cut_out.windows), progress), grid, DT_S)
    score = score_velocity(
        field,
        pair[0].position_mm,
        pair[1].position_mm,
        small,
        dt_s=DT_S,
        voxel_mm=cut_out.voxel_mm,
        window_voxels=cut_out.windows[-1],
    )
    planes = _by_plane(field, moved, cut_out.voxel_mm)
    return Twin(small, cut_out, seeding.particles_per_microlens, a.candidates, score, planes)


def _by_plane(field: xr.Dataset, moved_mm: list[float], voxel_mm: tuple[float, float, float]) -> tuple[PlaneError, ...]:
    """Errors of all vectors, plane by plane: every view sees the windows of a twin."""
    shown = field.isel(time=0)
    planes = []
    for k, z in enumerate(shown.z.values):
        errors = [1e3 * DT_S * shown[name].values[k] - moved for name, moved in zip("uvw", moved_mm, strict=True)]
        x, y, w = (float(np.sqrt(np.mean(e**2))) / d for e, d in zip(errors, voxel_mm, strict=True))
        planes.append(PlaneError(float(z), (x, y, w)))
    return tuple(planes)
