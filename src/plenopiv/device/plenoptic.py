"""A plenoptic camera on the device: a volume's light in a few views, and what their pixels give back, by plane maps.

Forward, each plane is spread into its map, and each view is read off it between four points. Back is the transpose,
made of reads alone: a point of a map adds up what the microlenses about it have for it. Which these are follows from
the lattice: light of pixel q under the microlens at S is centred at  x = x0 + a S + b q,  so that a microlens may light
a point only if S is within (1 + |b| times half the range of q)/|a| of where the point's own S would be, a window of a
few microlenses. The places themselves are those that forward reads at. No two sums meet in one place, so that nothing
waits for anything, and nothing depends on the order in which threads arrive.

Each view of a group is read off the same map, and written into the same, and planes far from focus share maps in twos
where several views come at once, as in ``plane_maps``.
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

from plenopiv.device.candidates import Judges, candidate_voxels, judges, visible_voxels
from plenopiv.device.form import Update
from plenopiv.device.plane_tables import Bucket, PlaneTable, buckets
from plenopiv.device.planes import PAD, collect, map_shape, spread
from plenopiv.device.view_places import LensBlock, LensTable, Pixels, lens_of, near, pixels_of
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.plenoptic.plane_maps.views import MappedViews
from plenopiv.projection.plenoptic.projector import PlenopticProjector

WRITTEN_OUT = 32  # microlenses about a point whose sum is written out, as one loop; more take as long to compile


class PlenopticTables(NamedTuple):
    """What a ``PlenopticForm`` works with, on the device. Of the planes, (1, ...) each plane by itself, and (2, ...) in
    twos, the one way and the other (``MappedViews.pairs``)."""

    lenses: LensTable
    planes: tuple[PlaneTable, ...]
    twos: tuple[PlaneTable, ...]


@dataclass(frozen=True)
class PlenopticForm:
    """What programs for a camera and a grid are compiled for: ``buckets`` of planes by themselves, and in ``twos``.
    Views are (view, lens) float32, lenses with their ring."""

    grid: tuple[int, int, int]
    lenses: LensBlock
    buckets: tuple[Bucket, ...]
    twos: tuple[Bucket, ...]

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
                shared = sum(
                    spread(bucket, lax.dynamic_index_in_dim(volume, group.number[m], keepdims=False), *weights)
                    for m, weights in enumerate(zip(group.down, group.across, strict=True))
                )
                x, y, lit = _places(group, pixels)
                return light + group.light * lit * _read(lax.optimization_barrier(shared), x, y), None

            light, _ = lax.scan(add, light, planes)
        return light

    def back(
        self, tables: PlenopticTables, views: jax.Array, images: jax.Array, volume: jax.Array, update: Update
    ) -> jax.Array:
        """``volume`` with each plane (ny, nx) replaced by ``update(plane, total)``: of each voxel the sum of ``images``
        (views, lens) over the pixels that it lights, by weights, but for the planes' ``light``."""
        pixels = pixels_of(tables.lenses, views)
        for bucket, planes in self._groups(tables, views):

            def add(volume: jax.Array, group: PlaneTable, bucket: Bucket = bucket) -> tuple[jax.Array, None]:
                light = self._written(bucket, group, tables.lenses, pixels, images)
                for m in range(bucket.members):
                    total = collect(bucket, light, group.down[m], group.across[m], self.grid[1:])
                    before = lax.dynamic_index_in_dim(volume, group.number[m], keepdims=False)
                    after = jnp.where(group.real[m], update(before, total), before)
                    volume = lax.dynamic_update_index_in_dim(volume, after, group.number[m], 0)
                return volume, None

            volume, _ = lax.scan(add, volume, planes)
        return volume

    def _groups(self, tables: PlenopticTables, views: jax.Array) -> Iterator[tuple[Bucket, PlaneTable]]:
        """The buckets for so many views, and their tables: in twos, either way, where there are several."""
        several = views.size > 1
        way = views[0] % 2 if several else 0
        tables_of = tables.twos if several else tables.planes
        for bucket, planes in zip(self.twos if several else self.buckets, tables_of, strict=True):
            yield bucket, PlaneTable(*(each[way] for each in planes))

    def _written(
        self, bucket: Bucket, plane: PlaneTable, lenses: LensTable, pixels: Pixels, images: jax.Array
    ) -> jax.Array:
        """The map (rows, columns) that ``images`` give: the transpose of ``_read``."""
        rows, columns = map_shape(bucket, self.grid[1:])
        x, y, lit = _places(plane, pixels)
        x, y, value = lax.optimization_barrier((x, y, lit * images))
        row = 1.0 + jnp.arange(rows, dtype=jnp.float32)[:, None]
        column = 1.0 + jnp.arange(columns, dtype=jnp.float32)[None]
        x0, xs, xq, y0, ys, yq = plane.place

        def add(n: jax.Array, light: jax.Array) -> jax.Array:
            middle, of_view = pixels.middle[n], (x[n], y[n], value[n])
            s, t = (column - x0 - xq * middle[0]) / xs, (row - y0 - yq * middle[1]) / ys
            moved = None if pixels.moved is None else pixels.moved[n % pixels.moved.shape[0]]
            about = near(self.lenses, lenses, s, t, plane.reach[0], moved)

            def of_lens(number: int | jax.Array, light: jax.Array) -> jax.Array:
                along, across = number % bucket.window[1], number // bucket.window[1]
                lens = lens_of(self.lenses, lenses, about, across, along, plane.reach[1])
                at_x, at_y, light_of = (each.at[lens].get(mode="promise_in_bounds") for each in of_view)
                return light + light_of * _hat(column - at_x) * _hat(row - at_y)

            if (count := bucket.window[0] * bucket.window[1]) > WRITTEN_OUT:
                return lax.fori_loop(0, count, of_lens, light)
            for number in range(count):
                light = of_lens(number, light)
            return light

        return lax.fori_loop(0, images.shape[0], add, jnp.zeros((rows, columns), jnp.float32))


def _places(plane: PlaneTable, pixels: Pixels) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Where the footprints of pixels are centred on a plane's map, columns and rows (views, lens), and lit shares. By
    themselves, so that forward and back have the same bits."""
    x0, xs, xq, y0, ys, yq = plane.place
    x = x0 + xs * pixels.s + xq * (pixels.qx + plane.off * pixels.dqx)
    y = y0 + ys * pixels.t + yq * (pixels.qy + plane.off * pixels.dqy)
    return lax.optimization_barrier((x, y, pixels.lit + plane.off * pixels.dlit))


def _read(light: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """A map with dark borders at places (views, lens), between points linearly; 0 beside the map."""
    rows, columns = (n - sum(PAD) for n in light.shape)
    x, y = jnp.clip(x, 0.0, columns + 1.0), jnp.clip(y, 0.0, rows + 1.0)
    i, j = x.astype(jnp.int32), y.astype(jnp.int32)
    beyond_x, beyond_y, at = x - i, y - j, j * light.shape[1] + i
    flat = light.reshape(-1)
    one, two, three, four = (
        flat.at[at + step].get(mode="promise_in_bounds") for step in (0, 1, light.shape[1], light.shape[1] + 1)
    )
    above, below = one + beyond_x * (two - one), three + beyond_x * (four - three)
    return above + beyond_y * (below - above)


def _hat(distance: jax.Array) -> jax.Array:
    """Share of a place so many steps from a point."""
    return jnp.maximum(1.0 - jnp.abs(distance), 0.0)


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
        forms, planes = zip(*buckets(mapped, [mapped.singles], half), strict=True)
        twos, planes_in_twos = zip(*buckets(mapped, mapped.pairs, half), strict=True)
        tables = PlenopticTables(lens_table(mapped, block, (low + high) / 2), planes, planes_in_twos)
        nz, ny, nx = host.grid.shape
        rows = tile_rows(ny) if alike and host.is_tile else ny
        return cls(host, PlenopticForm((nz, rows, nx), block, forms, twos), jax.tree.map(jnp.asarray, tables), half)

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
