"""Pinhole cameras on the device (Tomo-PIV): ``projection.pinhole`` with dense volumes, by reads alone.

Back, a voxel reads the pixels that its footprint covers. Forward, a pixel reads the voxels of each plane that may cover
it, a window about the place where its line of sight crosses the plane; their weights are the same numbers. Where voxels
are imaged is computed in double precision, as in the kernels, and kept as a pixel and a rest, which single precision
holds to 1e-7 px. Programs run with JAX's double precision switched on (``double``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from math import floor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.device.form import Update
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.volume import VoxelGrid

MARGIN = 1.02  # on windows of voxels about a line of sight, whose size is known at some places of the volume
ROUNDING = 0.02  # voxels


class PinholeTable(NamedTuple):
    """Of each camera, (camera, ...): ``place`` (4, 3), the centre of voxel (0, 0, 0) and the steps along x, y and z in
    the camera's frame, mm; ``lens`` (5,), focal length and principal point, px, k1 and k2; ``half`` (2,), half a
    footprint along columns and rows, px; ``size`` (2,), columns and rows; ``ends`` (4, pixel): x and y, in voxels,
    where the line of sight of each pixel crosses the first plane, then the last; ``reach`` (2,): half the window of
    voxels about that place, along y and x. The first two and ``half`` are float64."""

    place: jax.Array
    lens: jax.Array
    half: jax.Array
    size: jax.Array
    ends: jax.Array
    reach: jax.Array


class Imaged(NamedTuple):
    """Where voxels are imaged: pixel (``column``, ``row``) and the rest (``beyond_x``, ``beyond_y``), px."""

    column: jax.Array
    beyond_x: jax.Array
    row: jax.Array
    beyond_y: jax.Array


@dataclass(frozen=True)
class PinholeForm:
    """What programs for pinhole cameras and a grid are compiled for: pixels of the largest of them; how many voxels
    along y and x may cover a pixel (``window``); how many pixels along rows and columns a footprint may cover
    (``taps``)."""

    grid: tuple[int, int, int]
    cameras: int
    pixels: int
    window: tuple[int, int]
    taps: tuple[int, int]

    @property
    def double(self) -> bool:
        """Whether programs need double precision."""
        return True

    def padded(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """Values (view, pixel) as the device has them."""
        del views
        return values

    def inner(self, values: NDArray, views: NDArray | None = None) -> NDArray:
        """The inverse of ``padded``."""
        del views
        return values

    def forward(self, tables: PinholeTable, views: jax.Array, volume: jax.Array) -> jax.Array:
        """The volume's light in several cameras, (views, pixels)."""
        return lax.map(partial(self._image, tables, volume), views)

    def listed(self, volume: jax.Array, like: tuple[()] | None = None) -> tuple[()]:
        """Nothing: all voxels are (``Form``)."""
        del volume, like
        return ()

    def listed_shape(self, share: float) -> tuple[()]:
        """Nothing."""
        del share
        return ()

    def back(
        self,
        tables: PinholeTable,
        views: jax.Array,
        images: jax.Array,
        volume: jax.Array,
        listed: tuple[()],
        update: Update,
    ) -> jax.Array:
        """``volume`` with its voxels replaced by ``update(voxels, total)`` (``Form``)."""
        del listed
        nz, ny, nx = self.grid

        def of_plane(volume: jax.Array, k: jax.Array) -> tuple[jax.Array, None]:
            def of_view(n: jax.Array, total: jax.Array) -> jax.Array:
                cam = _camera(tables, views[n])
                return total + self._footprint_sums(cam, images[n], _imaged(cam, k, ny, nx))

            total = lax.fori_loop(0, images.shape[0], of_view, jnp.zeros((ny, nx), jnp.float32))
            before = lax.dynamic_index_in_dim(volume, k, keepdims=False)
            return lax.dynamic_update_index_in_dim(volume, update(before, total), k, 0), None

        return lax.scan(of_plane, volume, jnp.arange(nz, dtype=jnp.int32))[0]

    def lit(self, tables: PinholeTable, images: jax.Array, threshold: jax.Array) -> jax.Array:
        """``PinholeProjector.candidates`` of ``images`` (camera, pixel): the voxels' values, 0 where there is none."""
        nz, ny, nx = self.grid

        def of_plane(k: jax.Array) -> jax.Array:
            def of_camera(n: jax.Array, found: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
                (least, product), cam = found, _camera(tables, n)
                at = _imaged(cam, k, ny, nx)
                columns, rows = cam.size
                inside = (at.column >= 0) & (at.column < columns) & (at.row >= 0) & (at.row < rows)
                light = jnp.where(inside, jnp.maximum(self._footprint_sums(cam, images[n], at), 0.0), 0.0)
                return jnp.minimum(least, light), product * light.astype(jnp.float64)

            start = jnp.full((ny, nx), jnp.inf, jnp.float32), jnp.ones((ny, nx), jnp.float64)
            least, product = lax.fori_loop(0, self.cameras, of_camera, start)
            return jnp.where(least > threshold, product ** (1.0 / self.cameras), 0.0).astype(jnp.float32)

        return lax.map(of_plane, jnp.arange(nz, dtype=jnp.int32))

    def _image(self, tables: PinholeTable, volume: jax.Array, view: jax.Array) -> jax.Array:
        """The volume's light in one camera, (pixels,)."""
        cam, (nz, ny, nx) = _camera(tables, view), self.grid
        number = jnp.arange(self.pixels, dtype=jnp.int32)
        row, column = number // cam.size[0], number % cam.size[0]
        first, last = cam.ends[:2], cam.ends[2:]

        def add(light: jax.Array, k: jax.Array) -> tuple[jax.Array, None]:
            at = _imaged(cam, k, ny, nx)
            values = lax.dynamic_index_in_dim(volume, k, keepdims=False).reshape(-1)
            share = k.astype(jnp.float32) / max(nz - 1, 1)
            x, y = first + share * (last - first)
            lowest = jnp.ceil(y - cam.reach[0]).astype(jnp.int32), jnp.ceil(x - cam.reach[1]).astype(jnp.int32)

            def of_voxel(number: jax.Array, light: jax.Array) -> jax.Array:
                j, i = lowest[0] + number // self.window[1], lowest[1] + number % self.window[1]
                here = (j >= 0) & (j < ny) & (i >= 0) & (i < nx)
                voxel = jnp.where(here, j * nx + i, 0)
                c, beyond_x, r, beyond_y, value = (
                    each.reshape(-1).at[voxel].get(mode="promise_in_bounds") for each in (*at, values)
                )
                of_x = _covered((c - column) + beyond_x, cam.half[0])
                of_y = _covered((r - row) + beyond_y, cam.half[1])
                return light + jnp.where(here, value * of_x * of_y, 0.0)

            return lax.fori_loop(0, self.window[0] * self.window[1], of_voxel, light), None

        light, _ = lax.scan(add, jnp.zeros(self.pixels, jnp.float32), jnp.arange(nz, dtype=jnp.int32))
        return light

    def _footprint_sums(self, cam: PinholeTable, image: jax.Array, at: Imaged) -> jax.Array:
        """``kernels.footprint_sum`` of ``image`` (pixel,) for voxels imaged ``at``."""
        columns, rows = cam.size
        first_column, first_row = (
            jnp.floor(beyond - half + 0.5).astype(jnp.int32)
            for beyond, half in ((at.beyond_x, cam.half[0]), (at.beyond_y, cam.half[1]))
        )

        def add(number: jax.Array, total: jax.Array) -> jax.Array:
            down, along = first_row + number // self.taps[1], first_column + number % self.taps[1]
            r, c = at.row + down, at.column + along
            here = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            light = image.at[jnp.where(here, r * columns + c, 0)].get(mode="promise_in_bounds")
            weight = _covered(at.beyond_x - along, cam.half[0]) * _covered(at.beyond_y - down, cam.half[1])
            return total + jnp.where(here, weight * light, 0.0)

        return lax.fori_loop(0, self.taps[0] * self.taps[1], add, jnp.zeros(at.row.shape, jnp.float32))


def _camera(tables: PinholeTable, view: jax.Array) -> PinholeTable:
    """The table of one camera."""
    return PinholeTable(*(each[view] for each in tables))


def _imaged(cam: PinholeTable, k: jax.Array, ny: int, nx: int) -> Imaged:
    """Where the voxels (ny, nx) of plane k are imaged: ``kernels.image_of``."""
    j, i = jnp.arange(ny, dtype=jnp.float64)[:, None], jnp.arange(nx, dtype=jnp.float64)[None]
    x, y, z = (
        cam.place[0, a] + i * cam.place[1, a] + j * cam.place[2, a] + k.astype(jnp.float64) * cam.place[3, a]
        for a in range(3)
    )
    focal, column0, row0, k1, k2 = cam.lens
    a, b = x / z, y / z
    squared = a * a + b * b
    stretch = focal * (1.0 + squared * (k1 + squared * k2))
    found = list[jax.Array]()
    for middle in (column0 + stretch * a, row0 - stretch * b):
        pixel = jnp.floor(middle + 0.5)
        found += [pixel.astype(jnp.int32), (middle - pixel).astype(jnp.float32)]
    return Imaged(*lax.optimization_barrier(tuple(found)))


def _covered(distance: jax.Array, half: jax.Array) -> jax.Array:
    """Part of a footprint ``distance`` px beyond a pixel's middle that the pixel covers, along one axis:
    ``kernels.weight_along``."""
    size = half.astype(jnp.float32)
    apart = distance.astype(jnp.float32)
    covered = jnp.minimum(jnp.float32(0.5), apart + size) - jnp.maximum(jnp.float32(-0.5), apart - size)
    return jnp.maximum(covered, 0) / (2 * size)


@dataclass(frozen=True)
class PinholeOnDevice:
    """Pinhole cameras (``host``), and the same for the device in use."""

    host: PinholeProjector

    @classmethod
    def of(cls, host: PinholeProjector) -> PinholeOnDevice:
        """Of a projector."""
        return cls(host)

    @cached_property
    def _reach(self) -> NDArray[np.float64]:
        return np.array(
            [
                window_reach(camera, self.host.grid, half)
                for camera, half in zip(self.host.cameras, self._halves, strict=True)
            ]
        )

    @property
    def _halves(self) -> list[tuple[float, float]]:
        return [(cam.half_column, cam.half_row) for cam in self.host._constants]

    @cached_property
    def form(self) -> PinholeForm:
        """What programs are compiled for."""
        host, most = self.host, self._reach.max(0)
        column, row = np.max(self._halves, axis=0)
        taps = floor(2 * row) + 2, floor(2 * column) + 2
        window = floor(2 * most[0]) + 1, floor(2 * most[1]) + 1
        return PinholeForm(host.grid.shape, host.views, max(host.pixels), window, taps)

    @cached_property
    def tables(self) -> PinholeTable:
        """What they work with."""
        host, cams = self.host, self.host._constants
        ends = np.full((host.views, 4, max(host.pixels)), -1e6, np.float32)
        for view, count in enumerate(host.pixels):
            ends[view, :, :count] = _crossings(host.cameras[view], host.grid)
        arrays = PinholeTable(
            np.array([[cam.first, cam.along_x, cam.along_y, cam.along_z] for cam in cams]),
            np.array([[cam.focal, cam.column0, cam.row0, cam.k1, cam.k2] for cam in cams]),
            np.array(self._halves),
            np.array([[cam.columns, cam.rows] for cam in cams], np.int32),
            ends,
            self._reach.astype(np.float32),
        )
        with jax.enable_x64(True):
            return jax.tree.map(jnp.asarray, arrays)

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> jax.Array:
        """``PinholeProjector.candidates``, (nz, ny, nx): the voxels' values, 0 where there is none."""
        with jax.enable_x64(True):
            return _lit(self.form, self.tables, most, np.float32(np.max(particle)))

    def visible_voxels(self) -> jax.Array:
        """``PinholeProjector.visible_voxels``, (nz, ny, nx): 1 where every camera sees a voxel, else 0."""
        seen = np.ones((self.host.views, max(self.host.pixels)), np.float32)
        return (self.candidates(seen, 0.0) > 0).astype(jnp.float32)


@partial(jax.jit, static_argnums=0)
def _lit(form: PinholeForm, tables: PinholeTable, images: jax.Array, threshold: jax.Array) -> jax.Array:
    return form.lit(tables, images, threshold)


def _crossings(camera: PinholeCamera, grid: VoxelGrid) -> NDArray[np.float64]:
    """x and y, in voxels, of where lines of sight cross the first plane, then the last, (4, pixel)."""
    column, row = np.meshgrid(np.arange(camera.sensor.columns), np.arange(camera.sensor.rows))
    pixels = np.stack([column, row], -1).reshape(-1, 2)
    met = [camera.on_plane(pixels, z)[:, :2] for z in grid.axes()[2][[0, -1]]]
    return np.concatenate([((at - grid.first_mm[:2]) / grid.voxel_mm[:2]).T for at in met])


def window_reach(camera: PinholeCamera, grid: VoxelGrid, half: tuple[float, float]) -> NDArray[np.float64]:
    """Half the window of voxels of one plane whose footprints may cover a pixel, along y and x: what columns and rows
    change by per voxel is inverted at corners and middles of the volume."""
    x, y, z = (np.linspace(axis[0], axis[-1], 5) for axis in grid.axes())
    points = np.stack(np.meshgrid(x, y, z), -1).reshape(-1, 3)
    steps = np.diag(grid.voxel_mm)
    change = np.stack([camera.project(points + steps[a]) - camera.project(points) for a in (0, 1)], -1)
    wide = np.abs(np.linalg.inv(change)) @ (np.array(half) + 0.5)  # (point, x y)
    along_x, along_y = wide.max(0) * MARGIN + ROUNDING
    return np.array([along_y, along_x])
