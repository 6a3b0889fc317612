"""A twin of a camera: simulated images of it, reconstructed, correlated and scored, as small as it may be.

Errors depend on depth and hardly on where in the field a window lies. So the twin of a large sensor has the camera's
optics and depth, but only as much sensor as some hundred vectors need; a small sensor is its own twin, recorded
several times.

One thing does depend on the place. An error in depth is one along the line of sight, and beside the axis lines of sight
are inclined by x/(S_o - z): an error e_z along z is one of e_z x/(S_o - z) along x. What the twin's narrow field leaves
of that is added (``inclined``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, hypot, radians, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plenopiv.accuracy.velocity import Errors, Score, pooled, score_velocity
from plenopiv.cameras.coverage import pixels_that_see
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.chain import Chain
from plenopiv.design.advice import Limits, Measurement
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.lattice import Lattice
from plenopiv.reconstruction.reconstruct import Reconstruction
from plenopiv.reconstruction.settings import ReconstructionSettings, Weights
from plenopiv.simulation.flows import flow
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import Seeding, seed_pair

if TYPE_CHECKING:
    import xarray as xr

VECTORS = 300  # judged, about
ACROSS = 3, 9  # vectors along x and along y, at least and at most, as far as the sensor sees them
MOST_PAIRS = 16
ENOUGH = 0.9  # of the vectors: no further pair for the last few
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

    ``errors``: voxels, over all windows and by thirds of depth, as ``docs/accuracy.md`` counts. ``planes``: by depth.
    ``candidates``: share of the voxels that dense ray tracing left. Of so many ``pairs`` of frames, ``vectors`` in all.
    """

    camera: PlenopticCamera
    measurement: Measurement
    particles_per_microlens: float
    particles_per_window: float
    candidates: float
    pairs: int
    vectors: int
    errors: Errors
    planes: tuple[PlaneError, ...]


def cut(
    camera: PlenopticCamera, measurement: Measurement, vectors: int = VECTORS
) -> tuple[PlenopticCamera, Measurement]:
    """As much of a sensor, and of the volume across, as about so many vectors take; depth, voxels and windows as asked
    for. The lattice is turned and off the axis, as lattices are."""
    window, (x, y, depth) = measurement.window_mm, measurement.limits_mm
    deep = max(2 * (depth[1] - depth[0]) / window[2] - 1, 1)
    across = min(max(ACROSS[0], ceil(sqrt(vectors / deep))), ACROSS[1])
    x, y = (_shorter(side, (across + 1) * width / 2) for side, width in zip((x, y), window[:2], strict=True))
    return mounted(seeing(camera, (x, y, depth))), replace(measurement, limits_mm=(x, y, depth))


def seeing(camera: PlenopticCamera, limits_mm: Limits) -> PlenopticCamera:
    """The camera with no more of its sensor, about the axis, than the light of a volume takes."""
    sensor, (x, y, depth) = camera.sensor, limits_mm
    columns, rows = pixels_that_see(camera, (max(-x[0], x[1]), max(-y[0], y[1])), depth)
    return replace(camera, sensor=replace(sensor, columns=min(columns, sensor.columns), rows=min(rows, sensor.rows)))


def mounted(camera: PlenopticCamera) -> PlenopticCamera:
    """The camera with its lattice turned and off the axis, as lattices are."""
    pitch = camera.lattice.pitch_mm
    lattice = Lattice(camera.lattice.kind, pitch, TURN_RAD, (OFFSET[0] * pitch, OFFSET[1] * pitch))
    return camera.with_lattice(lattice)


def _shorter(side: tuple[float, float], length: float) -> tuple[float, float]:
    """An interval around 0 of at most ``length``, within ``side``."""
    return max(side[0], -length / 2), min(side[1], length / 2)


@dataclass(frozen=True)
class Pair:
    """Two frames of uniform motion, reconstructed by ``chain``.

    ``particles`` and ``frames`` of the first and the second; ``moved_mm`` from one to the other along x, y, z.
    """

    chain: Chain
    measurement: Measurement
    particles: tuple[Particles, Particles]
    frames: tuple[Reconstruction, Reconstruction]
    moved_mm: tuple[float, float, float]

    @property
    def camera(self) -> PlenopticCamera:
        """The twin's camera."""
        return self.chain.camera

    def velocity(self, progress: Progress | None = None) -> xr.Dataset:
        """The velocity field."""
        a, b = (frame.volume for frame in self.frames)
        return self.chain.velocity(a, b, DT_S, progress=progress)

    def score(self, field: xr.Dataset) -> Score:
        """How near the truth a field is, as ``docs/accuracy.md`` counts."""
        return score_velocity(
            field,
            self.particles[0].position_mm,
            self.particles[1].position_mm,
            self.camera,
            dt_s=DT_S,
            voxel_mm=self.measurement.voxel_mm,
            window_voxels=self.measurement.windows[-1],
        )

    def by_plane(self, field: xr.Dataset) -> tuple[PlaneError, ...]:
        """Errors of all vectors, plane by plane: every view sees the windows of a twin."""
        shown = field.isel(time=0)
        planes = []
        for k, z in enumerate(shown.z.values):
            off = [1e3 * DT_S * shown[name].values[k] - d for name, d in zip("uvw", self.moved_mm, strict=True)]
            sides = zip(off, self.measurement.voxel_mm, strict=True)
            rms_x, rms_y, rms_z = (float(np.sqrt(np.mean(e**2))) / side for e, side in sides)
            planes.append(PlaneError(float(z), (rms_x, rms_y, rms_z)))
        return tuple(planes)


def reconstructed_pair(
    camera: PlenopticCamera,
    measurement: Measurement,
    *,
    seeding: Seeding | None = None,
    noise: SensorNoise = NOISE,
    weights: Weights = "exact",
    vectors: int = VECTORS,
    seed: int = 0,
    progress: Progress | None = None,
) -> Pair:
    """Simulate a pair of frames of uniform motion, SHIFT of the last window, and reconstruct them as a run with default
    settings does. Calibration is left out: the lattice is known. ``seeding``: default ``Seeding()``; ``weights``: of
    the ``PlenopticProjector``.

    Raises:
        PlenoPIVError: the frames show no particles.
    """
    report = progress or (lambda stage, done, total: None)
    seeding = seeding or Seeding()
    small, cut_out = cut(camera, measurement, vectors)
    x, y, z = (share * side for share, side in zip(SHIFT, cut_out.window_mm, strict=True))
    motion = flow("uniform", velocity_m_s=[1e-3 * d / DT_S for d in (x, y, z)])
    rng = np.random.default_rng(seed)
    settings = ReconstructionSettings(weights=weights).through(small)
    chain = Chain((small,), cut_out.grid, settings, CorrelationSettings(windows=cut_out.windows), noise.gain)

    def frame(particles: Particles, number: int) -> Reconstruction:
        image_seed = 2 * seed + number
        light = particle_image(small, particles, rays=RAYS, seed=image_seed, diffraction_nm=WAVELENGTH_NM)
        counts = digitise(light + seeding.background_electrons, small.sensor, noise, rng)
        name = f"twin at {seeding.particles_per_microlens:g} ppm, frame {number + 1}"
        return chain.reconstruct([counts], name, partial(report, name))

    first, second = seed_pair(small, motion, DT_S, cut_out.limits_mm, seeding, rng)
    frames = frame(first, 0), frame(second, 1)
    return Pair(chain, cut_out, (first, second), frames, (x, y, z))


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
    """Pairs (``reconstructed_pair``), correlated as a run does and scored, until ``vectors`` are judged or there are
    MOST_PAIRS.

    Raises:
        PlenoPIVError: the frames show no particles, or nothing can be measured.
    """
    seeding, scores, planes, candidates = seeding or Seeding(), list[Score](), [], 0.0
    while not scores or (sum(score.vectors for score in scores) < vectors * ENOUGH and len(scores) < MOST_PAIRS):
        pair = reconstructed_pair(
            camera,
            measurement,
            seeding=seeding,
            noise=noise,
            vectors=vectors,
            seed=seed + len(scores),
            progress=progress,
        )
        field = pair.velocity(progress)
        scores.append(pair.score(field))
        planes.append(pair.by_plane(field))
        candidates += pair.frames[0].candidates
    slope = inclined(camera, measurement, pair.measurement)
    return Twin(
        pair.camera,
        pair.measurement,
        seeding.particles_per_microlens,
        float(np.mean([score.particles_per_window for score in scores])),
        candidates / len(scores),
        len(scores),
        sum(score.vectors for score in scores),
        _over_the_field(pooled(scores), slope),
        tuple(_tilted(_mean(same), slope) for same in zip(*planes, strict=True)),
    )


def inclined(camera: PlenopticCamera, whole: Measurement, part: Measurement) -> tuple[float, float]:
    """Voxels that an error of one voxel along z adds along x and y, RMS over the whole field less that over a part."""
    dx, dy, dz = whole.voxel_mm
    slopes = []
    for (lo, hi), (low, high), side in zip(whole.limits_mm[:2], part.limits_mm[:2], (dx, dy), strict=True):
        square = (lo**2 + lo * hi + hi**2 - low**2 - low * high - high**2) / 3
        slopes.append(sqrt(max(square, 0.0)) / camera.main_lens.object_distance_mm * dz / side)
    return slopes[0], slopes[1]


def _tilted(plane: PlaneError, slope: tuple[float, float]) -> PlaneError:
    x, y, z = plane.rms
    return PlaneError(plane.z_mm, (hypot(x, slope[0] * z), hypot(y, slope[1] * z), z))


def _over_the_field(errors: Errors, slope: tuple[float, float]) -> Errors:
    """The same errors with what lines of sight beside the axis add."""

    def tilted(rms: tuple[float, ...]) -> tuple[float, ...]:
        return hypot(rms[0], slope[0] * rms[2]), hypot(rms[1], slope[1] * rms[2]), rms[2]

    bands = tuple(replace(band, rms=tilted(band.rms)) for band in errors.by_depth)
    return replace(errors, rms=tilted(errors.rms), by_depth=bands)


def _mean(planes: tuple[PlaneError, ...]) -> PlaneError:
    """Errors at one depth in several pairs as one."""
    x, y, z = np.sqrt(np.mean(np.square([plane.rms for plane in planes]), axis=0)).tolist()
    return PlaneError(planes[0].z_mm, (x, y, z))
