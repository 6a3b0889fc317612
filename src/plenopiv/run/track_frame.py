"""The volume and the particles of one frame of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.chain import Chain
from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError
from plenopiv.recording import Recording
from plenopiv.run.frame import Frame, Progress, reconstructed
from plenopiv.run.inputs import frame_entry, read_entry
from plenopiv.run.judged import Judged
from plenopiv.tracking.frame import FrameParticles, particles_of_frame, particles_of_second_frame
from plenopiv.tracking.frame import Progress as Steps
from plenopiv.tracking.light import PointLights, diffraction_px
from plenopiv.tracking.peaks import peaks
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.predict import Predicted
from plenopiv.tracking.rim import clipped_by_rim
from plenopiv.tracking.shaken import particles_of_prediction
from plenopiv.volume import Limits, SparseVolume, VoxelGrid, within

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
Expected = Callable[[SparseVolume], "tuple[Array, Array] | None"]

AROUND = 4  # voxels beyond the volume in which particles count as its own


@dataclass(frozen=True)
class TrackedFrame:
    """A reconstructed frame, its particles in the frame of the chain's grid, what was warned of, and the displacement
    that correlation found between the first frame of its pair and this one, where that was asked for."""

    frame: Frame
    particles: FrameParticles
    warned: tuple[str, ...] = ()
    moved: DisplacementField | None = None

    @property
    def number(self) -> int:
        """From 0."""
        return self.frame.number

    @property
    def volume(self) -> SparseVolume:
        """That it was reconstructed to."""
        return self.frame.found.volume

    @property
    def entry(self) -> dict[str, Any]:
        """In the manifest."""
        return self.frame.entry

    @property
    def dark(self) -> float:
        """Standard deviation of a dark pixel in counts."""
        return self.frame.found.noise.dark

    @property
    def shown(self) -> Judged:
        """What it is judged by."""
        return self.frame


@dataclass(frozen=True)
class PredictedFrame:
    """A frame whose particles began where they were predicted, without a volume: its image, its particles as of a
    ``TrackedFrame``, and ``origin`` (n,): which of the predicted ones each is, -1 for those that were found."""

    shown: ImageOfFrame
    particles: FrameParticles
    origin: NDArray[np.int64]
    entry: dict[str, Any]
    warned: tuple[str, ...] = ()


@dataclass(frozen=True)
class ImageOfFrame:
    """A frame that was not reconstructed, as it is judged: its ``name``, and its upright ``image`` in counts without
    static light."""

    name: str
    image: NDArray
    unexplained: float | None = None


@dataclass(frozen=True)
class FrameTracker:
    """Finds the particles of the frames of a ``recording``; ``wavelength_nm`` of the light."""

    chain: Chain
    recording: Recording
    wavelength_nm: float

    @cached_property
    def of_points(self) -> PointLights:
        """Where the light of points of lens space goes."""
        camera, space = self.chain.camera, self.chain.space
        blur = diffraction_px(camera, self.wavelength_nm)
        return PointLights(camera, blur) if space is None else PointLights(camera, blur, space.left, space.growth)

    @cached_property
    def unusable(self) -> NDArray[np.bool_] | None:
        """Pixels that are no equations: those of the chain, and those that the main lens' rim clips."""
        of_chain: Any = self.chain.unusable[0] if self.chain.unusable else None
        clipped = clipped_by_rim(self.chain.camera)
        if of_chain is None or clipped is None:
            return clipped if of_chain is None else of_chain
        return np.asarray(of_chain | clipped)

    def limits(self, grid: VoxelGrid) -> Limits:
        """The limits of a grid, of lens space or of the laboratory, in which particles are looked for, mm."""
        return beside(grid, spread_mm(self.chain.camera, self.chain.lens_grid))

    def pixels(self, image: NDArray, dark: float, static: NDArray | None) -> Pixels:
        """The pixels of an upright image (rows, columns) in counts. ``dark``: standard deviation of a dark pixel;
        ``static``: counts of static light that were taken off."""
        sensor, noise = self.chain.camera.sensor, self.chain.counts_per_electron
        return Pixels.of_image(image, sensor.black_level, sensor.full_scale, dark, noise, self.unusable, static)

    def frame(self, number: int, report: Progress, expected: Expected | None = None) -> TrackedFrame:
        """Frame ``number``, from 0. ``expected``: of its volume, the positions (n, 3) mm of particles that are expected
        in it, in the frame of the chain's grid, and their light (n,); or None. Where there are none, or these are not
        there, the brightest voxels are the first guess.

        Raises:
            PlenoPIVError: its image cannot be used, or shows no particles.
        """
        chain = self.chain
        made = reconstructed(chain, self.recording, number, report, with_static=True)
        volume, name = made.found.volume, made.name
        known = None if expected is None else expected(volume)
        pixels = self.pixels(made.image, made.found.noise.dark, made.static)
        stage, limits = partial(report, f"particles of {name}"), self.limits(chain.lens_grid)
        particles = None if known is None else self._expected(pixels, *known, limits, stage)
        if particles is None:
            particles = particles_of_frame(self.of_points, pixels, *peaks(volume), limits, stage)
        if chain.space is not None:
            particles = in_laboratory(particles, chain.space)
            # lens space is a box around the volume's image
            particles = particles.of(within(particles.position_mm, self.limits(chain.grid)))
        return TrackedFrame(replace(made, static=None), particles)

    def _expected(
        self, pixels: Pixels, position_mm: Array, light: Array, limits: Limits, stage: Steps
    ) -> FrameParticles | None:
        """The particles of a frame where they are expected; None where they are not there."""
        if self.chain.space is not None:
            position_mm = self.chain.space.to_lens(position_mm)
        inside = within(position_mm, limits)
        try:
            return particles_of_second_frame(self.of_points, pixels, position_mm[inside], light[inside], limits, stage)
        except PlenoPIVError:
            return None

    def volume(self, number: int, report: Progress) -> SparseVolume:
        """The volume of frame ``number``, whose particles are known.

        Raises:
            PlenoPIVError: as ``frame``.
        """
        source = self.recording.frames[number]
        image, static = self.recording.light(number)
        behind = None if static is None else [static]
        stage = partial(report, f"reconstruction of {source.name}")
        return self.chain.reconstruct([image], source.name, stage, behind).volume

    def predicted(self, number: int, by: Predicted, dark: float, report: Progress) -> PredictedFrame:
        """Frame ``number`` from where its particles are predicted, in the frame of the chain's grid; ``dark``: standard
        deviation of a dark pixel in counts.

        Raises:
            PlenoPIVError: as ``frame``.
        """
        source, chain = self.recording.frames[number], self.chain
        entry = frame_entry(source)
        image, static = self.recording.light(number)
        pixels = self.pixels(image, dark, static)
        stage = partial(report, f"particles of {source.name}")
        active = np.flatnonzero(by.active)
        position, covariance = by.position_mm[active], by.covariance[active]
        if chain.space is not None:
            position = chain.space.to_lens(position)
            turned = np.linalg.inv(chain.space.to_laboratory.jacobian(position))
            covariance = turned @ covariance @ np.swapaxes(turned, 1, 2)
        std = np.sqrt(np.einsum("nii->ni", covariance))
        found, origin = particles_of_prediction(
            self.of_points, pixels, position, std, by.light[active], self.limits(chain.lens_grid), stage
        )
        origin = np.where(origin >= 0, active[origin], -1)
        if chain.space is not None:
            found = in_laboratory(found, chain.space)
            inside = within(found.position_mm, self.limits(chain.grid))
            found, origin = found.of(inside), origin[inside]
        shown = ImageOfFrame(source.name, image)
        return PredictedFrame(shown, found, origin, read_entry(entry, image))


def around(grid: VoxelGrid) -> Limits:
    """The limits of the particles that are a volume's own, mm."""
    x, y, z = ((lo - AROUND * d, hi + AROUND * d) for (lo, hi), d in zip(grid.limits_mm(), grid.voxel_mm, strict=True))
    return x, y, z


def spread_mm(camera: PlenopticCamera, lens_grid: VoxelGrid) -> float:
    """How far from its middle the light of a particle spreads in the focal plane, at most, in a volume of lens
    space."""
    lens, (low, high) = camera.main_lens, around(lens_grid)[2]
    return 0.5 * lens.aperture_mm * max(-low, high) / lens.object_distance_mm


def beside(grid: VoxelGrid, spread: float) -> Limits:
    """The limits of a volume and what is beside it by as much as light spreads (``spread_mm``). Particles there light
    the same pixels, and without them ghosts stand for their light."""
    x, y, z = around(grid)
    return (x[0] - spread, x[1] + spread), (y[0] - spread, y[1] + spread), z


def own(position_mm: Array, grid: VoxelGrid) -> NDArray[np.bool_]:
    """Which particles at positions (n, 3) are in the volume of the ``grid``, not beside it."""
    return within(position_mm, around(grid))


def own_tracks(tracks: xarray.Dataset, grid: VoxelGrid) -> xarray.Dataset:
    """The entries of ``tracks`` that are in the volume of the ``grid``, without those beside it."""
    return tracks.isel(obs=np.flatnonzero(own(np.stack([tracks[axis].values for axis in "xyz"], -1), grid)))


def in_laboratory(particles: FrameParticles, space: SpaceMap) -> FrameParticles:
    """Particles of lens space where they are in the laboratory; covariances by the map's derivatives."""
    turned = np.zeros((len(particles.light), 4, 4))
    turned[:, :3, :3] = space.to_laboratory.jacobian(particles.position_mm)
    turned[:, 3, 3] = 1.0
    covariance = turned @ particles.covariance @ np.swapaxes(turned, 1, 2)
    information, pull = particles.information, particles.pull
    if information is not None and pull is not None:
        back = np.linalg.inv(turned[:, :3, :3])
        information = np.swapaxes(back, 1, 2) @ information @ back
        pull = np.einsum("nji,nj->ni", back, pull)
    position = space.to_laboratory(particles.position_mm)
    return replace(particles, position_mm=position, covariance=covariance, information=information, pull=pull)
