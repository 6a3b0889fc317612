"""A plenoptic camera on the device: a volume's light in a few views, and what their pixels give back, by plane maps.

Forward, each plane is spread into its map, and each view is read off it between four points. Back is the transpose,
made of reads alone: listed voxels ask the microlenses about them (``asking``).

Each view of a group is read off the same map, and planes far from focus share maps in twos where several views come at
once, as in ``plane_maps``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import ArrayLike, NDArray

from plenopiv.device.asking import corrected
from plenopiv.device.candidates import Judges, candidate_voxels, judges, visible_voxels
from plenopiv.device.form import Update
from plenopiv.device.listed import Listed, listed, listed_shape
from plenopiv.device.plane_tables import Bucket, PlaneTable, buckets, rectangles_of
from plenopiv.device.planes import read, spread
from plenopiv.device.view_places import LensBlock, LensTable, footprints, pixels_of
from plenopiv.device.voxel_tables import Asking, VoxelTable, voxel_tables
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.projection.plenoptic.projector import PlenopticProjector


class PlenopticTables(NamedTuple):
    """What a ``PlenopticForm`` works with, on the device. Of the planes, (1, ...) each plane by itself, and (2, ...) in
    twos, the one way and the other (``MappedViews.pairs``); of ``voxels`` all three."""

    lenses: LensTable
    planes: tuple[PlaneTable, ...]
    twos: tuple[PlaneTable, ...]
    voxels: tuple[VoxelTable, ...]


@dataclass(frozen=True)
class PlenopticForm:
    """What programs for a camera and a grid are compiled for: ``buckets`` of planes by themselves, and in ``twos``;
    ``asking``: of planes whose voxels ask alike. Views are (view, lens) float32, lenses with their ring."""

    grid: tuple[int, int, int]
    lenses: LensBlock
    buckets: tuple[Bucket, ...]
    twos: tuple[Bucket, ...]
    asking: tuple[Asking, ...]

    @property
    def pixels(self) -> int:
        """Of each view."""
        return self.lenses.size

    @property
    def double(self) -> bool:
        """Whether programs need double precision."""
        return False

    def padded(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """Values (views, lens) of the camera's microlenses, as the device has them."""
        del views
        return self.lenses.ringed(values)

    def inner(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """The inverse of ``padded``."""
        del views
        return self.lenses.inner(values)

    def forward(self, tables: PlenopticTables, views: jax.Array, volume: jax.Array) -> jax.Array:
        """The light of ``volume`` (nz, ny, nx) in ``views``, (views, lens), whether or not a pixel is an equation."""
        pixels = pixels_of(tables.lenses, views)
        light = jnp.zeros((views.size, self.lenses.size), jnp.float32)
        for bucket, planes in self._groups(tables, views):

            def add(light: jax.Array, group: PlaneTable, bucket: Bucket = bucket) -> tuple[jax.Array, None]:
                shared = lax.optimization_barrier(spread(bucket, volume[group.number], group.weights))
                x, y, lit = footprints(group.place, group.off, pixels)
                return light + group.light * lit * read(bucket, shared, x, y), None

            light, _ = lax.scan(add, light, planes)
        return light

    def back(
        self,
        tables: PlenopticTables,
        views: jax.Array,
        images: jax.Array,
        volume: jax.Array,
        listed: Listed,
        update: Update,
    ) -> jax.Array:
        """``volume`` (nz, ny, nx) with its ``listed`` voxels replaced by ``update(voxels, total)``: of each the sum of
        ``images`` (views, lens) over the pixels that it lights, by weights, but for the planes' ``light``."""
        pixels, variant = pixels_of(tables.lenses, views), 1 + views[0] % 2 if views.size > 1 else 0
        for asking, voxels in zip(self.asking, tables.voxels, strict=True):
            planes = voxels._replace(place=voxels.place[:, variant], off=voxels.off[:, variant])
            about = asking, planes, self.lenses, tables.lenses, pixels, images
            volume = corrected(*about, listed, volume, update)
        return volume

    def listed(self, volume: jax.Array, like: Listed | None = None) -> Listed:
        """The voxels of a volume that are not 0 (``Form``)."""
        return listed(volume, 0 if like is None else len(like.voxels))

    def listed_shape(self, share: float) -> Listed:
        """What holds a ``share`` of the voxels (``Form``)."""
        return listed_shape(self.grid, share)

    def _groups(self, tables: PlenopticTables, views: jax.Array) -> Iterator[tuple[Bucket, PlaneTable]]:
        """The buckets for so many views, and their tables: in twos, either way, where there are several."""
        several = views.size > 1
        way = views[0] % 2 if several else 0
        tables_of = tables.twos if several else tables.planes
        for bucket, planes in zip(self.twos if several else self.buckets, tables_of, strict=True):
            yield bucket, PlaneTable(*(each[way] for each in planes))


@dataclass(frozen=True)
class PlenopticOnDevice:
    """A projector with exact weights (``host``), and the same for the device in use. ``q_half`` (2,): half of what q of
    a view's pixels ranges over, along x and y, px, at the most."""

    host: PlenopticProjector
    form: PlenopticForm
    tables: PlenopticTables
    q_half: NDArray[np.float64]

    @classmethod
    def of(cls, host: PlenopticProjector, alike: bool = True) -> PlenopticOnDevice:
        """``alike``: a tile has some rows of voxels more than it needs, so that tiles share programs.

        Raises PlenoPIVError where its weights are of rays, or the main lens blurs.
        """
        mapped, where = host.images, host.layout
        if not isinstance(mapped, MappedViews):
            raise PlenoPIVError(
                f'reconstruction.weights: "{host.weights}" is not computed on a graphics processor; use "exact", or '
                'compute.device = "cpu"'
            )
        if where.camera.blur_mm > 0:
            raise PlenoPIVError(
                f"main_lens.blur_mm: {where.camera.blur_mm:g} is not computed on a graphics processor; use "
                'compute.device = "cpu"'
            )
        block = LensBlock(where.ni, where.nj, where.camera.lattice.kind == "hexagonal")
        low, high = ranges_of_q(mapped)
        half = ((high - low) / 2).max(0, initial=0.0)
        weights = [rectangles_of(mapped.maps, k) for k in range(host.grid.shape[0])]
        forms, planes = zip(*buckets(mapped, [mapped.singles], weights), strict=True)
        twos, planes_in_twos = zip(*buckets(mapped, mapped.pairs, weights), strict=True)
        asking, voxels = zip(*voxel_tables(mapped, [mapped.singles, *mapped.pairs], weights, half), strict=True)
        tables = PlenopticTables(lens_table(mapped, block, (low + high) / 2), planes, planes_in_twos, voxels)
        nz, ny, nx = host.grid.shape
        rows = tile_rows(ny) if alike and host.is_tile else ny
        form = PlenopticForm((nz, rows, nx), block, forms, twos, asking)
        return cls(host, form, jax.tree.map(jnp.asarray, tables), half)

    @cached_property
    def judges(self) -> Judges:
        """What dense ray tracing needs, made on first use."""
        return judges(self.host, self.form.lenses, self.q_half)

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> jax.Array:
        """``PlenopticProjector.candidates``, (nz, ny, nx): 1 where a voxel may hold a particle, else 0."""
        about = self.form.lenses, self.tables.lenses, self.judges
        return self._with_rows(candidate_voxels(self.host, *about, most, float(np.max(particle))))

    def visible_voxels(self) -> jax.Array:
        """``PlenopticProjector.visible_voxels``, (nz, ny, nx): 1 where a voxel is seen, else 0."""
        return self._with_rows(visible_voxels(self.host.camera))

    def _with_rows(self, mask: jax.Array) -> jax.Array:
        """A mask as a volume, with the rows that the form has more."""
        more = self.form.grid[1] - mask.shape[1]
        return jnp.pad(mask.astype(jnp.float32), ((0, 0), (0, more), (0, 0)))


def tile_rows(rows: int) -> int:
    """As many rows or some more, an eighth at the most, so that tiles of nearly as many have the same number."""
    step = 1 << max(rows.bit_length() - 4, 0)
    return -(-rows // step) * step


def ranges_of_q(mapped: MappedViews) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest q along x and y, (views, 2) px, of each view's pixels in any plane."""
    spread, out = mapped.camera.column("spread").astype(np.float64), np.zeros((2, mapped.layout.views, 2))
    for view in range(mapped.layout.views):
        _, found = mapped.view_pixels(np.array([view]))
        if found.pixels.shape[1]:
            q = found.pixels[2:4].astype(np.float64)
            both = np.stack([q, q + (spread[-1] - spread[0]) * found.pixels[5:7]])
            out[:, view] = both.min((0, 2)), both.max((0, 2))
    return out[0], out[1]


def lens_table(mapped: MappedViews, block: LensBlock, middle: NDArray[np.float64]) -> LensTable:
    """The table of a camera; ``middle`` (view, 2) as there."""
    where, camera = mapped.layout, mapped.camera
    lattice = where.camera.lattice
    c, s = np.cos(lattice.rotation_rad) / lattice.pitch_mm, np.sin(lattice.rotation_rad) / lattice.pitch_mm
    turned = np.array([[c, s], [-s / lattice.row_spacing, c / lattice.row_spacing]])
    first = -turned @ np.array(lattice.offset_mm) - (where.i0, where.j0)
    regular = None
    if lattice.map is not None or camera.shifts is not None:
        j, i = np.mgrid[where.j0 : where.j0 + where.nj, where.i0 : where.i0 + where.ni]
        regular = block.ringed(np.stack(lattice.regular_centres(i.ravel(), j.ravel()))).astype(np.float32)
    return LensTable(
        s=block.ringed(camera.lens_mm[:, 0]),
        t=block.ringed(camera.lens_mm[:, 1]),
        phase=block.ringed(where.phase.T),
        offset=where.offsets.astype(np.float32),
        rim=camera.rim,
        middle=middle.astype(np.float32),
        light=None if where.light is None else block.ringed(where.light),
        shifts=camera.shifts,
        regular=regular,
        radius=np.float32(mapped.cam.radius),
        ends=camera.column("spread")[[0, -1]],
        from_mm=np.column_stack([turned, first]).astype(np.float32),
        odd=np.int32(where.j0 & 1),
    )
