"""Projection between a volume and the views of a plenoptic camera. Weights are computed, never stored."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import Layout, decode
from plenopiv.projection.plenoptic import pixel_weights
from plenopiv.projection.plenoptic.by_voxel.views import ViewsByVoxel
from plenopiv.projection.plenoptic.candidates.rule import candidate_planes, weight_sums
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.projection.plenoptic.plane_maps.maps import ACROSS
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.projection.protocol import Projection
from plenopiv.volume import SparseVolume, VoxelGrid

RULES = {
    "1-ray": pixel_weights.ONE_RAY,
    "9-rays": pixel_weights.NINE_RAYS,
    "exact": pixel_weights.EXACT,
    "polygons": pixel_weights.EXACT,
}


class PlenopticProjector:
    """Between a volume and the views of a plenoptic camera (``projection.protocol.Projection``).

    A voxel's value is its light: the sum of the counts that it gives in all pixels when the whole aperture sees it.
    Images of a view are float32 (lens,), in counts. ``gather`` and ``multiply`` weigh a pixel by the share of it that
    the voxel's light covers.

    ``weights``: "1-ray" (the centre of each pixel's portion of the main lens), "9-rays", "exact" areas by maps of each
    plane (``plane_maps``) with ``across`` points across a footprint, or "polygons", the same areas voxel by voxel and
    lens by lens (``by_voxel``): slower, the reference of the maps. ``shifts``: of each view, as ``CameraOnGrid``.
    Rays take the main lens as sharp (``PlenopticCamera.blur_mm``).

    Raises PlenoPIVError for a volume that reaches to the main lens or behind it.
    """

    def __init__(
        self,
        layout: Layout,
        grid: VoxelGrid,
        weights: str = "exact",
        across: float = ACROSS,
        shifts: NDArray[np.float32] | None = None,
    ):
        nearest, lens_z = grid.limits_mm()[2][1], layout.camera.main_lens.object_distance_mm
        if nearest >= lens_z:
            raise PlenoPIVError(
                f"volume.z_mm: as the camera sees it, the volume reaches z = {nearest:.6g} mm, which is not in front "
                f"of the main lens at {lens_z:.6g} mm; is the calibration this camera's, and are all lengths in mm?"
            )
        focus_z = lens_z - layout.camera.main_lens.focal_length_mm
        if nearest >= focus_z:
            raise PlenoPIVError(
                f"volume.z_mm: as the camera sees it, the volume reaches z = {nearest:.6g} mm, beyond the main lens' "
                f"front focal plane at {focus_z:.6g} mm: nothing there is imaged; end it well before"
            )
        self.layout, self.grid, self.weights, self.across = layout, grid, weights, across
        self.rule, self.camera = RULES[weights], CameraOnGrid(layout, grid, shifts)
        self._equations: NDArray[np.bool_] | None = None  # of a tile; all that the layout has otherwise
        self.images: MappedViews | ViewsByVoxel = (
            MappedViews(self.camera, across) if weights == "exact" else ViewsByVoxel(self.camera, self.rule)
        )

    @property
    def views(self) -> int:
        """Number of views."""
        return self.layout.views

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(view, lens): where a pixel is an equation."""
        return self.layout.seen if self._equations is None else self._equations

    @property
    def whole_views(self) -> NDArray[np.int64]:
        """The views whose pixels lie inside the aperture under every microlens."""
        return np.flatnonzero(~self.camera.rim)

    @property
    def light_in_focus(self) -> float:
        """Share of a particle's light in focus that a wholly lit pixel collects."""
        return 1 / (pi * self.layout.camera.aperture_radius_px**2)

    def every_voxel(self) -> SparseVolume:
        """All voxels of the grid, each of value 1."""
        return SparseVolume.from_planes(
            self.grid, (np.ones(self.grid.shape[1:], bool) for _ in range(self.grid.shape[0]))
        )

    def visible_voxels(self) -> SparseVolume:
        """The voxels that the middle of the aperture sees, each of value 1."""
        return SparseVolume.from_planes(self.grid, self.camera.visible_planes())

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> SparseVolume:
        """The visible voxels in which a particle of ``particle`` counts gives no pixel more than ``most`` (view, lens),
        by dense ray tracing (``candidates.rule``)."""
        return SparseVolume.from_planes(
            self.grid, candidate_planes(self.camera, self.rule, most, float(np.max(particle)))
        )

    def values_of(self, images: Sequence[NDArray]) -> NDArray[np.float32]:
        """The frame's one image (rows, columns), in counts, as (view, lens) above the black level.

        Raises PlenoPIVError for another number of images, another shape, or a pixel that is no finite number.
        """
        sensor, shapes = self.layout.camera.sensor, [np.shape(image) for image in images]
        if isinstance(images, np.ndarray) and images.ndim == 2:
            raise PlenoPIVError("frame: one image, give a list of the cameras' images")
        if shapes != [(sensor.rows, sensor.columns)]:
            found = ", ".join(" x ".join(map(str, shape[::-1])) for shape in shapes) or "none"
            raise PlenoPIVError(
                f"frame: images of {found} px; give one of {sensor.columns} x {sensor.rows} px, as the camera's sensor"
            )
        return decode(images[0], self.layout).values

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in one view, (lens,), or in several, (views, lens), which cost less than one by one; 0
        where the pixel is no equation."""
        return self.images.forward(np.atleast_1d(views), volume).reshape(*np.shape(views), -1)

    def gather(self, views: ArrayLike, images: NDArray[np.float32], volume: SparseVolume) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` over the pixels that it lights, by weights; of one view,
        ``images`` (lens,), or of several, (views, lens)."""
        return self.images.gather(np.atleast_1d(views), np.atleast_2d(images), volume)

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the weighted sum of ``corrections`` over the pixels that it lights; it becomes
        0 where that is negative. Several views at once (as ``gather``) by ``correction.factor_of``."""
        self.images.multiply(np.atleast_1d(views), np.atleast_2d(corrections), volume)

    def light_of_planes(self) -> NDArray[np.float32]:
        """Share of a voxel's light that a wholly lit pixel collects, for each plane (nz,)."""
        return self.camera.column("light")

    def weight_sums(self) -> NDArray[np.float64]:
        """How widely each plane spreads a voxel's light over pixels, (nz, 3).

        For a plane without borders: the sum of the exact weights of its voxels in one pixel, the sum of these weights'
        squares, and the largest weight.
        """
        return weight_sums(self.camera)

    def rays_inside_grid(self, view: int) -> NDArray[np.bool_]:
        """The lenses (lens,) whose pixel in a view is an equation and whose central ray crosses every plane inside the
        grid."""
        column, row = self.camera.ray_ends(view)
        _, ny, nx = self.grid.shape
        inside = (column >= 0) & (column <= nx - 1) & (row >= 0) & (row <= ny - 1)
        return self.layout.seen[view] & inside.all(0)

    @property
    def passage(self) -> int:
        """Rows of voxels that the light of one pixel crosses between the first plane and the last, at the most, with
        its own width."""
        crossed = max(float(np.ptp(rows, axis=0).max()) for rows in map(self._ray_rows, range(self.views)))
        return ceil(crossed + 2 * self._half_width)

    def tile(self, low: int, high: int) -> PlenopticProjector:
        """The same camera with rows low <= j < high of the voxels; ``seen`` only where no light comes from others."""
        rows = self.grid.shape[1]
        if (low, high) == (0, rows):
            return self
        part = PlenopticProjector(
            self.layout, self.grid.y_range(low, high), self.weights, self.across, self.camera.shifts
        )
        part._equations = part._rays_within(0 if low else -np.inf, high - low if high < rows else np.inf)
        return part

    @property
    def is_tile(self) -> bool:
        """Whether it is a ``tile`` of another."""
        return self._equations is not None

    def whole(self) -> PlenopticProjector:
        """The same, were all pixels usable."""
        return PlenopticProjector(self.layout.whole(), self.grid, self.weights, self.across, self.camera.shifts)

    @property
    def lost_share(self) -> float:
        """``Layout.lost_share``."""
        return self.layout.lost_share

    def each_camera(self, values: NDArray) -> list[tuple[Projection, NDArray]]:
        """This one."""
        return [(self, values)]

    def _rays_within(self, low: float, high: float) -> NDArray[np.bool_]:
        """(view, lens): the equations to which no light comes from rows of voxels below ``low`` or from ``high`` on."""
        low, high = low + self._half_width, high - 1 - self._half_width
        met = map(self._ray_rows, range(self.views))
        return self.layout.seen & np.array([((rows >= low) & (rows <= high)).all(0) for rows in met])

    def _ray_rows(self, view: int) -> NDArray[np.float64]:
        """Rows of voxels (2, lens) at which the central rays of a view's pixels cross the first and the last plane."""
        return self.camera.ray_ends(view)[1]

    @property
    def _half_width(self) -> float:
        """Half the width of what a pixel sees in a plane, in rows of voxels."""
        blur = pixel_weights.CUT * self.layout.camera.blur_mm / self.layout.camera.lattice.pitch_mm
        return (0.5 + blur) / float(np.abs(self.camera.column("cell_y")).min()) + 1
