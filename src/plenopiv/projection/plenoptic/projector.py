"""The projector: light of a volume in every view of a camera, and back. Weights are computed, never stored."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.coverage import half_sensor_mm
from plenopiv.lightfield import Layout
from plenopiv.projection.correction import correct
from plenopiv.projection.plenoptic import by_voxel, geometry, pixel_weights
from plenopiv.projection.plenoptic.candidates import kernels
from plenopiv.projection.plenoptic.candidates.in_focus import borders_coincide, rule_out_together
from plenopiv.projection.plenoptic.plane_maps.maps import ACROSS
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.threads import in_threads, in_turn
from plenopiv.volume import SparseVolume, VoxelGrid

RULES = {
    "1-ray": pixel_weights.ONE_RAY,
    "9-rays": pixel_weights.NINE_RAYS,
    "exact": pixel_weights.EXACT,
    "polygons": pixel_weights.EXACT,
}
CHUNKS = 64  # of rows of voxels, shared out among threads
NOTHING = np.empty(1, np.float32)
PARTIAL_IMAGES = 16  # of one view, summed in order
SLAB = 16  # planes pruned at once


class Projector:
    """Between a volume and the views of a plenoptic camera.

    A voxel's value is its light: the sum of the counts that it gives in all pixels when the whole aperture sees it.
    Images of a view are float32 (lens,), in counts.

    ``weights``: "1-ray" (the centre of each pixel's portion of the main lens), "9-rays", "exact" areas by maps of each
    plane (``maps``) with ``across`` points across a footprint, or "polygons", the same areas voxel by voxel and lens by
    lens, slower: what maps are held against.
    """

    def __init__(self, layout: Layout, grid: VoxelGrid, weights: str = "exact", across: float = ACROSS):
        camera = layout.camera
        self.layout, self.grid, self.rule = layout, grid, RULES[weights]
        self._lens_mm = geometry.lenses_mm(layout)
        self._box = (layout.i0, layout.j0, layout.ni, layout.nj)
        self._rows, self._planes = geometry.camera_constants(camera, grid), geometry.planes(camera, grid)
        m, n = np.abs(layout.offsets).T
        self._rim = np.hypot(m + 1.05, n + 1.05) > camera.aperture_radius_px  # phase and drift move a pixel by 0.55
        camera_and_grid = layout, grid, self._rows, self._planes, self._lens_mm
        self.mapped = MappedViews(*camera_and_grid, self._rim, across) if weights == "exact" else None

    @property
    def views(self) -> int:
        """Number of views."""
        return self.layout.views

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(view, lens): where a pixel is an equation."""
        return self.layout.seen

    @property
    def whole_views(self) -> NDArray[np.int64]:
        """The views whose pixels lie inside the aperture under every microlens."""
        return np.flatnonzero(~self._rim)

    @property
    def judging_views(self) -> NDArray[np.int64]:
        """The views that dense ray tracing asks, in order: every other one, as the fields of one colour of a
        chessboard, since neighbours say nearly the same; those inside the aperture before those at its rim, the
        outermost of them, which differ most, first."""
        order = np.lexsort((-np.hypot(*self.layout.offsets.T), self._rim))
        return order[self.layout.offsets[order].sum(1) % 2 == 0]

    @property
    def light_in_focus(self) -> float:
        """Share of a particle's light in focus that a wholly lit pixel collects."""
        return 1 / (pi * self.layout.camera.aperture_radius_px**2)

    def every_voxel(self) -> SparseVolume:
        """All voxels of the grid, each of value 1."""
        return SparseVolume.from_planes(
            self.grid, (np.ones(self.grid.shape[1:], bool) for _ in range(self.grid.shape[0]))
        )

    def seen_from_the_middle(self) -> Iterator[NDArray[np.bool_]]:
        """Plane by plane the voxels (ny, nx) that the middle of the aperture sees; about half the views see one at the
        border."""
        half_s, half_t = half_sensor_mm(self.layout.camera)
        x, y, z = self.grid.axes()
        for scale in np.abs(self.layout.camera.scale(z)):
            yield (scale * np.abs(y) <= half_t)[:, None] & (scale * np.abs(x) <= half_s)

    def seen_voxels(self) -> SparseVolume:
        """The voxels that the middle of the aperture sees, each of value 1."""
        return SparseVolume.from_planes(self.grid, self.seen_from_the_middle())

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in one view, (lens,), or in several, (views, lens), which cost less than one by one; 0
        where the pixel is no equation."""
        each = np.atleast_1d(views)
        if self.mapped is not None:
            images = self.mapped.forward(each, volume)
        else:
            images = np.array([self._forward(view, volume) for view in each])
        return images.reshape(*np.shape(views), -1)

    def gather(self, views: ArrayLike, images: NDArray[np.float32], volume: SparseVolume) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` over the pixels that it lights, each by its lit share of the
        pixel; of one view, ``images`` (lens,), or of several, (views, lens)."""
        each, images = np.atleast_1d(views), np.atleast_2d(images)
        out = np.zeros(volume.values.size, np.float32)
        if self.mapped is not None:
            self.mapped.gather(each, images, volume, out)
            return out
        for view, image in zip(each, images, strict=True):
            seen, part = np.where(self.layout.seen[view], image, 0.0).astype(np.float32), np.empty_like(out)
            self._walk(view, volume, CHUNKS, seen, np.empty((1, 1), np.float32), part, False)
            out += part
        return out

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the share-weighted sum of ``corrections`` over the pixels that it lights, or
        empty it where that is negative; in several views at once (as ``gather``) by what ``factor_of`` makes of it."""
        if self.mapped is not None:
            self.mapped.multiply(np.atleast_1d(views), np.atleast_2d(corrections), volume)
        else:
            correct(volume, self.gather(views, corrections, volume), np.size(views))

    def light_of_planes(self) -> NDArray[np.float32]:
        """Share of a voxel's light that a wholly lit pixel collects, by plane (nz,)."""
        return self._planes[:, geometry.Plane._fields.index("light")]

    def sharpness(self) -> NDArray[np.float64]:
        """Of a voxel's share of a pixel, by plane: its sum and its squares' sum over all voxels of an endless plane,
        and the largest, (nz, 3)."""
        out = np.empty((self.grid.shape[0], 3))
        in_threads(kernels.sharpness_of_planes, len(out), self._rows, self._planes, out)
        cells = self._planes[:, [geometry.Plane._fields.index(c) for c in ("cell_x", "cell_y")]]
        out[:, :2] /= np.abs(cells[:, :1] * cells[:, 1:])
        return out

    def looks_through(self, view: int) -> NDArray[np.bool_]:
        """The lenses (lens,) whose pixel in a view meets every plane inside the grid."""
        column, row = geometry.ends(self.layout, self._rows, self._planes, self._lens_mm, view)
        _, ny, nx = self.grid.shape
        inside = (column >= 0) & (column <= nx - 1) & (row >= 0) & (row <= ny - 1)
        return self.layout.seen[view] & inside.all(0)

    @property
    def passage(self) -> int:
        """Rows of voxels that the light of one pixel crosses between the first plane and the last, at the most, with
        its own width."""
        crossed = max(float(np.ptp(rows, axis=0).max()) for rows in map(self._rows_met, range(self.views)))
        return ceil(crossed + 2 * self._half_width)

    def keeps_within(self, low: float, high: float) -> NDArray[np.bool_]:
        """(view, lens): the equations of which no light comes from rows of voxels below ``low`` or from ``high`` on."""
        low, high = low + self._half_width, high - 1 - self._half_width
        met = map(self._rows_met, range(self.views))
        return self.seen & np.array([((rows >= low) & (rows <= high)).all(0) for rows in met])

    def _rows_met(self, view: int) -> NDArray[np.float64]:
        """Rows of voxels (2, lens) that the pixels of a view meet in the first and in the last plane."""
        return geometry.ends(self.layout, self._rows, self._planes, self._lens_mm, view)[1]

    @property
    def _half_width(self) -> float:
        """Of a pixel's light, voxels."""
        return 0.5 / float(np.abs(self._planes[:, geometry.Plane._fields.index("cell_y")]).min()) + 1

    def voxels_within(self, bound: NDArray[np.float32], particle: float) -> SparseVolume:
        """The seen voxels in which a particle of ``particle`` counts gives no pixel more than ``bound`` (view, lens).

        ``judging_views`` are asked. Exact weights are the least within a voxel; voxels in focus that lie across
        microlenses are judged by all of their pixels together (``borders``).
        """
        where, order = self.layout, self.judging_views
        bound = np.where(where.seen, bound, np.float32(np.inf))
        largest = self.sharpness()[:, 2].astype(np.float32)
        if self.rule != pixel_weights.EXACT:
            largest[:] = 1.0
        move = self._planes[:, geometry.Plane._fields.index("move")]
        blur = 0.5 * np.abs(np.gradient(move)) if move.size > 1 else np.zeros(1)
        parameters = where.offsets, order, self._lens_mm, where.phase, where.fill, bound, np.float32(particle)
        nz, ny, nx = self.grid.shape

        seen, whole = self.seen_from_the_middle(), order[~self._rim[order]]

        def planes() -> Iterator[NDArray[np.bool_]]:
            for lo in range(0, nz, SLAB):
                slab = slice(lo, min(lo + SLAB, nz))
                alive = np.zeros((slab.stop - lo, ny, nx + kernels.LANES), np.uint8)
                for plane in alive:
                    plane[:, :nx] = next(seen)
                table, most, half_step = self._planes[slab], largest[slab], blur[slab].astype(np.float32)
                about = (
                    in_turn(len(alive)),
                    self._rows,
                    table,
                    most,
                    self.rule,
                    self._rim,
                    *parameters,
                    half_step,
                    alive,
                )
                in_threads(kernels.prune, len(alive), *about)
                for k, plane in enumerate(alive[:, :, :nx], lo):
                    if self.rule == pixel_weights.EXACT and borders_coincide(where, self.grid, k):
                        counts = particle * float(self.light_of_planes()[k])
                        rule_out_together(where, self.grid, k, plane, bound, counts, whole)
                    yield plane > 0

        return SparseVolume.from_planes(self.grid, planes())

    def _forward(self, view: int, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in one view by polygons or rays."""
        partial = np.empty((PARTIAL_IMAGES, self.layout.lenses), np.float32)
        self._walk(view, volume, PARTIAL_IMAGES, NOTHING, partial, NOTHING, True)
        image = partial.sum(0)
        image[~self.layout.seen[view]] = 0.0
        return image

    def _row_chunks(self, volume: SparseVolume, count: int) -> NDArray[np.int64]:
        """Bounds of ``count`` runs of rows with about as many listed voxels each."""
        bounds = np.searchsorted(volume.row_start, np.linspace(0, volume.column.size, count + 1))
        bounds[0], bounds[-1] = 0, volume.row_start.size - 1
        return bounds.astype(np.int64)

    def _walk(self, view: int, volume: SparseVolume, chunks: int, image, partial, out, scatter: bool) -> None:
        m, n = self.layout.offsets[view].astype(np.float32)
        in_threads(
            by_voxel.walk,
            chunks,
            self._rows,
            self._box,
            self.layout.clock,
            self._planes,
            self.grid.shape[1],
            self.rule,
            bool(self._rim[view]),
            m,
            n,
            self.layout.fill[view],
            self._row_chunks(volume, chunks),
            volume.row_start,
            volume.column,
            volume.values,
            image,
            partial,
            out,
            scatter,
        )
