"""``plenopiv track``: the particles of every frame of an experiment and the links of its pairs, as tracks.nc."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.experiment.tracking_table import TrackingTable
from plenopiv.io.netcdf import COMPRESSED, write_dataset
from plenopiv.recording import Recording
from plenopiv.run.calibrated import calibrated_chain
from plenopiv.run.versions import versions
from plenopiv.tracking.frame import FrameParticles, particles_of_frame
from plenopiv.tracking.light import PointLights, diffraction_px
from plenopiv.tracking.links import Links, link
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.tracks import tracks_dataset
from plenopiv.volume import Limits, SparseVolume, VoxelGrid

FILE = "tracks.nc"
AROUND = 4  # voxels beyond the volume in which particles are looked for too: they light the same pixels
SCATTER_VOXELS = 0.7  # first guess of how far correlation is from a particle's displacement
FARTHER = 3.0  # times the largest displacement of the correlation is the largest of a particle

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackResult:
    """What was written: ``path``; ``particles`` of each frame by its number; of each pair how many are ``linked``;
    ``median_std_mm`` of x, y, z."""

    path: Path
    particles: dict[int, int]
    linked: list[int]
    median_std_mm: tuple[float, ...]


@dataclass(frozen=True)
class _Found:
    """A frame's volume and particles."""

    volume: SparseVolume
    particles: FrameParticles


def track(experiment: Experiment, progress: Progress | None = None, overwrite: bool = False) -> TrackResult:
    """Find the particles of all frames, link those of each pair, and write tracks.nc into the output folder.

    Raises:
        PlenoPIVError: an input cannot be used; x, y, z are not those of the camera ([calibration] and [medium] are not
            tracked yet); tracks.nc is there and ``overwrite`` is not given.
    """
    report = progress or (lambda stage, done, total: None)
    path = experiment.output_directory / FILE
    if path.exists() and not overwrite:
        raise PlenoPIVError(f"{path}: is already there; use --overwrite, or another output.directory")
    if experiment.calibration is not None or experiment.medium is not None:
        raise PlenoPIVError(
            f"{experiment.path}: plenopiv track needs x, y, z of the camera itself; it cannot yet take [calibration] "
            "or [medium]"
        )
    chain, recording, _ = calibrated_chain(experiment, experiment.recording(), progress=partial(report, "calibration"))
    if chain.camera.rim is not None:
        warnings.warn(
            "tracking: the main lens' rim cuts micro-images off axis; particles there are fitted as if it did not",
            PlenoPIVWarning,
            stacklevel=2,
        )
    if chain.camera.blur_mm > 0:
        warnings.warn(
            f"tracking: the main lens blurs by {1e3 * chain.camera.blur_mm:.0f} um; particles are fitted as if it were "
            "sharp",
            PlenoPIVWarning,
            stacklevel=2,
        )
    table = experiment.tracking or TrackingTable()
    of_points = PointLights(chain.camera, diffraction_px(chain.camera, table.wavelength_nm))
    frames, links = dict[int, FrameParticles](), list[tuple[int, int, Links]]()
    for a, b, first, second in _pairs(chain, recording, of_points, report):
        field = chain.displacement(first.volume, second.volume, report)
        frames |= {a: first.particles, b: second.particles}
        links.append((a, b, linked(first.particles, second.particles, field, chain.grid, table)))
    dataset = tracks_dataset(sorted(frames.items()), links, recording.dt_s)
    dataset.attrs |= {
        "Conventions": "CF-1.11",
        "title": "Particles and their tracks",
        "source": f"plenopiv {versions()['plenopiv']}",
        "dt_s": recording.dt_s,
        "frames": [recording.frames[k].name for k in sorted(frames)],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers = [name for name, variable in dataset.data_vars.items() if variable.dtype.kind in "fi"]
    write_dataset(path, dataset, {name: dict(COMPRESSED) for name in numbers})
    std = tuple(float(np.median(dataset[f"{axis}_std"])) for axis in "xyz")
    return TrackResult(path, {k: len(p.light) for k, p in sorted(frames.items())}, [len(e.a) for *_, e in links], std)


def linked(
    first: FrameParticles, second: FrameParticles, field: DisplacementField, grid: VoxelGrid, table: TrackingTable
) -> Links:
    """The links of a pair, the correlation's ``field`` (voxels of ``grid``) saying where to look."""
    most = table.max_displacement_mm
    if most is None:
        lengths = np.linalg.norm(field.displacement * np.reshape(grid.voxel_mm, (3, 1, 1, 1)), axis=0)
        most = FARTHER * float(np.nanmax(lengths)) + grid.voxel_mm[2]
    return link(first, second, predictor(field, grid), SCATTER_VOXELS * np.asarray(grid.voxel_mm), most)


def predictor(field: DisplacementField, grid: VoxelGrid) -> Callable[[Array], Array]:
    """Displacements (n, 3) in mm at points (n, 3) in mm of a field in voxels: linear between vectors, beyond them as at
    the nearest one; 0 in a body."""
    axes = [np.asarray(axis, np.float64) for axis in (field.z, field.y, field.x)]
    values = np.nan_to_num(np.moveaxis(field.displacement, 0, -1)) * np.asarray(grid.voxel_mm)
    for k, axis in enumerate(axes):
        if len(axis) == 1:  # one layer of windows
            axes[k], values = np.array([axis[0], axis[0] + 1.0]), np.repeat(values, 2, k)
    between = RegularGridInterpolator(axes, values)
    low, high = (np.array([end(axis) for axis in axes]) for end in (np.min, np.max))

    def at(points_mm: Array) -> Array:
        index = (points_mm - np.asarray(grid.first_mm)) / np.asarray(grid.voxel_mm)
        return np.asarray(between(np.clip(index[:, ::-1], low, high)))

    return at


def _pairs(
    chain: Chain, recording: Recording, of_points: PointLights, report: Progress
) -> Iterator[tuple[int, int, _Found, _Found]]:
    """Each pair's frames, numbers and particles; a frame that two pairs share is made once."""
    held: dict[int, _Found] = {}
    for pair in recording.pairs:
        held = {k: found for k, found in held.items() if k in pair}
        for k in pair:
            if k not in held:
                held[k] = _found(chain, recording, k, of_points, report)
        yield pair[0], pair[1], held[pair[0]], held[pair[1]]


def _found(chain: Chain, recording: Recording, number: int, of_points: PointLights, report: Progress) -> _Found:
    """The volume and the particles of frame ``number``."""
    name = recording.frames[number].name
    image, static = recording.light(number)
    behind = None if static is None else [static]
    made = chain.reconstruct([image], name, partial(report, f"reconstruction of {name}"), behind)
    sensor = chain.camera.sensor
    unusable: Any = chain.unusable[0] if chain.unusable else None
    pixels = Pixels.of_image(
        image, sensor.black_level, sensor.full_scale, made.noise.dark, chain.counts_per_electron, unusable, static
    )
    position, light = peaks(made.volume)
    limits = _around(chain.grid)
    particles = particles_of_frame(of_points, pixels, position, light, limits, partial(report, f"particles of {name}"))
    return _Found(made.volume, particles)


def _around(grid: VoxelGrid) -> Limits:
    x, y, z = ((lo - AROUND * d, hi + AROUND * d) for (lo, hi), d in zip(grid.limits_mm(), grid.voxel_mm, strict=True))
    return x, y, z
