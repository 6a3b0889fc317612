"""The measuring chain as plain data: images of a frame -> volume, two volumes -> displacement -> velocity.

A run, a preview, the design twin, the paper's cases and the examples all call this. A ``Chain`` holds what does not
change from frame to frame; it pickles, and gives the same bits on the other side.

    chain = Chain((camera,), grid, counts_per_electron=gain)
    a, b = (chain.reconstruct([image]).volume for image in pair)
    field = chain.velocity(a, b, dt_s=0.5e-3)           # xarray, m/s on coordinates in mm
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.pose import FRONT, Pose
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.device.backend import CPU, Device
from plenopiv.displacement.compression import compressed
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.ensemble import EachVolume, PairsOfVolumes, measure_ensemble
from plenopiv.displacement.field import DisplacementField, near_face
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.pairs import Progress as CorrelationProgress
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import Layout, layout
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.protocol import Projection
from plenopiv.projection.several_cameras import SeveralCameras
from plenopiv.reconstruction.focus import focus_weight, near_focus
from plenopiv.reconstruction.mart import Progress
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE
from plenopiv.reconstruction.reconstruct import Guess, Reconstruction, reconstruct
from plenopiv.reconstruction.resampling import lens_grid, resampled
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import Tile
from plenopiv.reconstruction.usable import usable_share
from plenopiv.velocity import Frame, velocity_dataset
from plenopiv.volume import SparseVolume, Volume, VoxelGrid

if TYPE_CHECKING:
    import xarray

Camera = PlenopticCamera | PinholeCamera
LARGEST_SIDE = 2**16 - 1  # voxels: sparse volumes keep 16 bits for a voxel's place in its row
PLACES = 17  # along x and y, at which weights by depth are found in the laboratory
LOST = 0.1  # of a microlens' pixels: fewer make no difference to the voxels
HIDDEN = 4  # power of the share of its light that is seen, by which a voxel counts less
DEFAULT_RECONSTRUCTION, DEFAULT_CORRELATION = ReconstructionSettings(), CorrelationSettings()


@dataclass(frozen=True)
class Chain:
    """What a recording is measured with.

    ``cameras``: one plenoptic camera, several around the volume, or two and more pinhole cameras, calibrated.
    ``poses``: of several plenoptic cameras, how each stands; the first camera's frame is the object frame.
    ``counts_per_electron``: of the pixels' shot noise. ``tiles``: rows of voxels to be reconstructed one after the
    other, none for the whole volume at once. ``unusable``: of each plenoptic camera, pixels of an upright image (rows,
    columns) that are no equations; empty for none. ``solid``: the parts of the volume that a body fills.

    ``space``: of one plenoptic camera, the map between the laboratory, where ``grid``, body and vectors are, and lens
    space, where volumes are reconstructed on ``lens_grid``. None: they are the same. ``device``: ``device.backend``.
    """

    cameras: tuple[Camera, ...]
    grid: VoxelGrid
    reconstruction: ReconstructionSettings = DEFAULT_RECONSTRUCTION
    correlation: CorrelationSettings = DEFAULT_CORRELATION
    counts_per_electron: float = NO_WHITE_IMAGE
    poses: tuple[Pose, ...] = (FRONT,)
    tiles: tuple[Tile, ...] = ()
    unusable: tuple[NDArray[np.bool_] | None, ...] = field(default=(), compare=False)
    solid: Solid | None = field(default=None, compare=False)
    space: SpaceMap | None = None
    device: Device = CPU

    def __repr__(self) -> str:
        seen = repr(self.cameras[0]) if len(self.cameras) == 1 else f"{len(self.cameras)} cameras"
        return f"<Chain {seen},\n {self.grid!r}, {len(self.correlation.passes)} correlation passes>"

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: the projection is made again where it is needed."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def with_tiles(self, tiles: Sequence[Tile]) -> Chain:
        """The same, the volume reconstructed in ``tiles``."""
        return self._with_projection_of(replace(self, tiles=tuple(tiles)))

    def on_device(self, device: Device) -> Chain:
        """The same on another device."""
        return self._with_projection_of(replace(self, device=device))

    def with_noise(self, counts_per_electron: float) -> Chain:
        """The same for pixels of another shot noise."""
        return self._with_projection_of(replace(self, counts_per_electron=counts_per_electron))

    def _with_projection_of(self, other: Chain) -> Chain:
        """A chain of the same cameras and grid with this one's projection, if it was made."""
        if "projection" in self.__dict__:
            other.__dict__["projection"] = self.projection
        return other

    @property
    def camera(self) -> PlenopticCamera:
        """The one plenoptic camera.

        Raises:
            PlenoPIVError: there are others.
        """
        camera = self.cameras[0]
        if len(self.cameras) > 1 or not isinstance(camera, PlenopticCamera):
            raise PlenoPIVError(f"cameras: {len(self.cameras)} given; this takes one plenoptic camera")
        return camera

    @property
    def layout(self) -> Layout:
        """Of the one plenoptic camera: which pixel is which view's of which microlens.

        Raises:
            PlenoPIVError: there are others.
        """
        projection = self.projection
        if not isinstance(projection, PlenopticProjector):
            raise PlenoPIVError(f"cameras: {len(self.cameras)} given; this takes one plenoptic camera")
        return projection.layout

    @property
    def frame(self) -> Frame:
        """The frame of ``grid`` and of the vectors."""
        return "camera" if self.space is None else "laboratory"

    @cached_property
    def lens_grid(self) -> VoxelGrid:
        """The voxels that are reconstructed: ``grid``, or those of lens space that cover its image.

        Raises:
            PlenoPIVError: a ``space`` of other than one plenoptic camera, or too many voxels.
        """
        if self.space is None:
            return self.grid
        _ = self.camera  # one, of which alone a space is known
        found = lens_grid(self.space, self.grid)
        if max(found.shape) > LARGEST_SIDE:
            raise PlenoPIVError(f"volume.voxel_mm: {max(found.shape)} voxels along one axis of lens space are too many")
        return found

    @cached_property
    def projection(self) -> Projection:
        """Between ``lens_grid`` and the cameras' views, made on first use.

        Raises:
            PlenoPIVError: cameras of both kinds, poses or masks that are not as many as the cameras, a camera that does
                not see the volume or stands in it, or as ``lens_grid`` and ``layout``.
        """
        grid, weights = self.lens_grid, self.reconstruction.weights
        plenoptic = [camera for camera in self.cameras if isinstance(camera, PlenopticCamera)]
        pinholes = [camera for camera in self.cameras if isinstance(camera, PinholeCamera)]
        if pinholes and not plenoptic:
            if any(masked is not None for masked in self.unusable):
                raise PlenoPIVError("unusable: pinhole cameras have no masks; set such pixels to their black level")
            return PinholeProjector(pinholes, grid)
        masks = self.unusable or (None,) * len(plenoptic)
        if pinholes or not len(plenoptic) == len(self.poses) == len(masks):
            raise PlenoPIVError(
                f"cameras: {len(plenoptic)} plenoptic, {len(pinholes)} pinhole, {len(self.poses)} poses, {len(masks)} "
                "masks; give plenoptic cameras with a pose each, or pinhole cameras alone, masks of all or none"
            )
        projectors = [
            self._projector(layout(camera, masked), pose.grid(grid), weights)
            for camera, pose, masked in zip(plenoptic, self.poses, masks, strict=True)
        ]
        return projectors[0] if self.poses == (FRONT,) else SeveralCameras(grid, projectors, self.poses)

    def _projector(self, where: Layout, grid: VoxelGrid, weights: str) -> PlenopticProjector:
        """Of one camera, with what ``space`` leaves of its views.

        Raises PlenoPIVError where the main lens blurs and rays are asked for.
        """
        if where.camera.blur_mm > 0 and weights != "exact":
            raise PlenoPIVError(
                f'reconstruction.weights: "{weights}" takes the main lens as sharp: use "exact", or '
                "main_lens.blur_mm = 0"
            )
        left, portion = None if self.space is None else self.space.left, where.camera.portion_mm
        shifts = None if left is None else left.of_views(where.offsets * (portion, -portion))
        return PlenopticProjector(where, grid, weights, shifts=shifts)

    @cached_property
    def _whole(self) -> Projection | None:
        """The projection, were all pixels usable; None where so few are lost that it makes no difference."""
        if all(masked is None for masked in self.unusable):
            return None  # without a projection, which takes as long as half a pass
        projection = self.projection
        if not isinstance(projection, PlenopticProjector | SeveralCameras) or projection.lost_share < LOST:
            return None
        return projection.whole()

    @cached_property
    def depth_weights(self) -> DepthWeights | None:
        """What light counts in the correlation by its distance from focus (``focus``), on ``grid``; None where all
        counts alike."""
        reach, camera = self.reconstruction.focus_reach, self.cameras[0]
        if len(self.cameras) > 1 or not isinstance(camera, PlenopticCamera) or reach == 0:
            return None
        x, y, z = self.grid.axes()
        if self.space is None:
            return DepthWeights(focus_weight(camera, z, reach)[:, None, None], np.zeros(1), np.zeros(1))
        rows, columns = (np.unique(np.linspace(0, n - 1, PLACES).round()) for n in self.grid.shape[1:])
        at = np.stack(np.meshgrid(z, y[rows.astype(int)], x[columns.astype(int)], indexing="ij")[::-1], -1)
        return DepthWeights(focus_weight(camera, self.space.to_lens(at)[..., 2], reach), rows, columns)

    def reconstruct(
        self,
        images: Sequence[NDArray],
        name: str = "frame",
        progress: Progress | None = None,
        static: Sequence[NDArray] | None = None,
        guess: Guess | None = None,
    ) -> Reconstruction:
        """The volume of one frame, on ``lens_grid``; ``images``: an upright image (rows, columns), in counts, of each
        camera.

        ``static``: images of the static light, counts above the black level, that was taken off them; its shot noise is
        left. ``guess``: as for ``reconstruct``, on this processor.

        Raises:
            PlenoPIVError: images that are not the cameras', or a frame ``name`` that shows no particles.
        """
        background = None
        if static is not None:
            levels = cycle(np.float32(each.sensor.black_level) for each in self.cameras)  # whatever number is given
            background = self.projection.values_of([light + b for light, b in zip(static, levels, strict=False)])
        values = self.projection.values_of(images)
        more: dict[str, Any] = {"counts_per_electron": self.counts_per_electron, "background": background}
        more |= {"tiles": self.tiles, "name": name, "progress": progress}
        if self.device.kind == "cpu" or guess is not None:
            return reconstruct(values, self.projection, self.reconstruction, **more, guess=guess)
        with self.device.in_use():
            from plenopiv.device.reconstruct import reconstruct as reconstruct_on_device

            return reconstruct_on_device(values, self.projection, self.reconstruction, **more)

    def displacement(
        self, a: SparseVolume, b: SparseVolume, progress: CorrelationProgress | None = None
    ) -> DisplacementField:
        """Displacement from volume ``a`` to volume ``b``, voxels; light near focus and voxels behind unusable pixels
        count less.

        Raises:
            PlenoPIVError: windows do not fit, nothing is found, or a volume lies on another grid than ``lens_grid``.
        """
        volumes, settings = (self.correlated(a), self.correlated(b)), self._of_correlated
        if self.device.kind == "cpu":
            return measure(*volumes, settings, progress, self.solid, depth=self.depth_weights)
        with self.device.in_use():
            from plenopiv.device.correlation import measure as measure_on_device

            return measure_on_device(*volumes, settings, progress, self.solid, self.device.memory, self.depth_weights)

    def weighted(self, volume: SparseVolume) -> SparseVolume:
        """A reconstructed volume with less light in voxels behind unusable pixels."""
        if (whole := self._whole) is None:
            return volume
        return volume.with_values(volume.values * usable_share(self.projection, whole, volume) ** HIDDEN)

    def correlated(self, volume: SparseVolume) -> Volume:
        """A reconstructed volume as it is correlated: ``weighted``, compressed, on ``grid``.

        Light is shared among the laboratory's voxels after it is compressed: its centre stays where it is. The square
        root of light that is shared already is off its centre by where that lies between voxels, and as lines of sight
        are slanted against the grid, that changes as particles move in depth. Raises PlenoPIVError for another grid's.
        """
        if not volume.grid.agrees_with(self.lens_grid):
            raise PlenoPIVError(f"volume: {volume.grid!r}, but the chain's is {self.lens_grid!r}")
        light = compressed(self.weighted(volume), self.correlation.intensity_exponent)
        return light if self.space is None else self.in_laboratory(SparseVolume.of(light))

    @property
    def _of_correlated(self) -> CorrelationSettings:
        """The settings for volumes that are compressed."""
        return replace(self.correlation, intensity_exponent=1.0)

    def in_laboratory(self, volume: SparseVolume) -> SparseVolume:
        """A reconstructed volume on ``grid``."""
        return volume if self.space is None else resampled(volume, self.space.to_laboratory, self.grid)

    def velocity(
        self,
        a: SparseVolume,
        b: SparseVolume,
        dt_s: float,
        time_s: float = 0.0,
        progress: CorrelationProgress | None = None,
    ) -> xarray.Dataset:
        """The velocity field between two volumes ``dt_s`` apart, m/s at mid-time ``time_s`` (``velocity_dataset``).

        Raises:
            PlenoPIVError: as ``displacement``; ``dt_s`` is not positive.
        """
        return self.dataset(self.displacement(a, b, progress), dt_s, time_s)

    def ensemble(
        self,
        pairs: PairsOfVolumes[SparseVolume],
        dt_s: float,
        time_s: float = 0.0,
        progress: CorrelationProgress | None = None,
    ) -> xarray.Dataset:
        """The one velocity field that many ``pairs`` of volumes share, each ``dt_s`` apart, in a steady or phase-locked
        flow: their correlations are summed (``displacement.ensemble``), weighted as for ``velocity``. ``pairs[k]`` is
        asked for several times, one pair is held at a time, so they may lie on disk.

        Raises:
            PlenoPIVError: there is no pair; else as ``velocity``.
        """
        shown = EachVolume(pairs, self.correlated)
        found = measure_ensemble(shown, self._of_correlated, progress, self.solid, self.depth_weights)
        return self.dataset(found, dt_s, time_s)

    def dataset(self, field: DisplacementField, dt_s: float, time_s: float = 0.0) -> xarray.Dataset:
        """The velocity field of a displacement field in ``dt_s``, m/s at mid-time ``time_s``, by ``velocity_dataset``.
        Of one plenoptic camera it says which vectors lie near focus, and which at the volume's front and back.

        Raises:
            PlenoPIVError: ``dt_s`` is not positive.
        """
        near, at_face, camera, count = None, None, self.cameras[0], len(self.cameras)
        kind = "plenoptic" if isinstance(camera, PlenopticCamera) else "pinhole"
        title = "Volumetric velocity from " + (f"one {kind} camera" if count == 1 else f"{count} {kind} cameras")
        if count == 1 and isinstance(camera, PlenopticCamera):
            deep, ends = self.correlation.windows[-1][2], []
            for z in (field.z - 0.25 * deep, field.z + 0.25 * deep):  # of the middle half of each window
                index = zip(self.grid.first_mm, self.grid.voxel_mm, (field.x, field.y, z), strict=True)
                at = np.stack(np.meshgrid(*(f + v * n for f, v, n in index), indexing="ij"), -1).transpose(2, 1, 0, 3)
                ends += [(at if self.space is None else self.space.to_lens(at))[..., 2]]
            near = near_focus(camera, *ends)
            at_face = np.broadcast_to(near_face(field.z, self.grid.shape[0], deep)[:, None, None], near.shape)
        return velocity_dataset(field, self.grid, dt_s, time_s, self.frame, near, at_face, title)
