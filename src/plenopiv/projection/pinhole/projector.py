"""Projection between a volume and pinhole cameras around it: a view is one camera, its pixels are the equations.

Elsinga et al. (2006, Eq. 1): the counts of a pixel are the sum of the voxels on its line of sight, each by its weight,
the part of the voxel's light that falls on the pixel. The image of a voxel is that of a turned box; here its footprint
is a square (a rectangle where voxels are not cubes) whose variance along columns and rows is that of the box's image:

    side^2 = sum over x, y, z of (voxel size x change of the column per mm)^2

For cubes that is the voxel's size in pixels, however the camera is turned. Weights are the parts of the square that
pixels cover, computed when they are needed; its size is that at the volume's centre (``kernels``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.pinhole import PinholeCamera, share_seen
from plenopiv.errors import PlenoPIVError
from plenopiv.projection.correction import correct
from plenopiv.projection.pinhole import kernels
from plenopiv.projection.pinhole.kernels import PinholeConstants
from plenopiv.projection.protocol import Projection
from plenopiv.sensor import first_not_finite
from plenopiv.threads import in_threads
from plenopiv.volume import SparseVolume, VoxelGrid

CHUNKS = 8  # partial images of one camera, summed in order
SLAB = 16  # planes worked on at once
NARROWEST = 1e-3  # px, of a footprint


class PinholeProjector:
    """Between a volume and the images of two or more pinhole cameras.

    A voxel's value is its light: the sum of the counts that it gives in all pixels of any one camera. Cameras are taken
    as equally bright. Images are float32 (pixel,), rows one after the other, in counts; cameras with fewer pixels than
    the largest have no equations beyond their last.

    Raises PlenoPIVError for fewer than two cameras, and for one that does not see the volume or stands in it.
    """

    def __init__(self, cameras: Sequence[PinholeCamera], grid: VoxelGrid):
        if len(cameras) < 2:
            raise PlenoPIVError(
                f"cameras: {len(cameras)} given; lines of sight cross from two cameras on, give two or more"
            )
        self.cameras, self.grid = tuple(cameras), grid
        for number, camera in enumerate(self.cameras, 1):
            _check_view(camera, grid, f"camera {number}")
        self.pixels = [camera.sensor.columns * camera.sensor.rows for camera in cameras]
        self._equations: NDArray[np.bool_] | None = None  # of a tile; every pixel otherwise
        self._constants = [pinhole_constants(camera, grid) for camera in self.cameras]

    @property
    def views(self) -> int:
        """Number of cameras."""
        return len(self.cameras)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(camera, pixel): where there is an equation."""
        if self._equations is not None:
            return self._equations
        return np.arange(max(self.pixels)) < np.array(self.pixels)[:, None]

    def values_of(self, images: Sequence[NDArray]) -> NDArray[np.float32]:
        """Upright images (rows, columns) in counts as (camera, pixel) above the black level.

        Raises PlenoPIVError where their number or a shape is not that of the cameras, or a pixel is no finite number.
        """
        if len(images) != self.views:
            raise PlenoPIVError(f"images: {len(images)} for {self.views} cameras; give one of each camera")
        values = np.zeros((self.views, max(self.pixels)), np.float32)
        for number, (image, camera, row) in enumerate(zip(images, self.cameras, values, strict=True), 1):
            sensor = camera.sensor
            if np.shape(image) != (sensor.rows, sensor.columns):
                raise PlenoPIVError(
                    f"camera {number}: its image has {' x '.join(map(str, np.shape(image)[::-1]))} px, its sensor "
                    f"{sensor.columns} x {sensor.rows}; give the image of this camera, not cut"
                )
            row[: sensor.rows * sensor.columns] = np.ravel(image).astype(np.float32) - np.float32(sensor.black_level)
            if (at := first_not_finite(row)) is not None:
                y, x = divmod(at[0], sensor.columns)
                raise PlenoPIVError(
                    f"camera {number}: the pixel at column {x}, row {y} is {row[at]}, and would empty the volume; put "
                    "a count there, as the median of the pixels about it"
                )
        return values

    def forward(self, views: ArrayLike, volume: SparseVolume) -> NDArray[np.float32]:
        """The volume's light in one camera, (pixel,), or in several, (camera, pixel)."""
        images = np.zeros((np.size(views), max(self.pixels)), np.float32)
        chunks = volume.row_chunks(CHUNKS)
        for view, image in zip(np.atleast_1d(views), images, strict=True):
            partial = np.empty((CHUNKS, self.pixels[view]), np.float32)
            listed = chunks, volume.row_start, volume.column, volume.values
            in_threads(kernels.project, CHUNKS, self._constants[view], self.grid.shape[1], *listed, partial)
            np.sum(partial, axis=0, out=image[: self.pixels[view]])
        return images.reshape(*np.shape(views), -1)

    def gather(self, views: ArrayLike, images: NDArray[np.float32], volume: SparseVolume) -> NDArray[np.float32]:
        """For each listed voxel the sum of ``images`` over the pixels that it lights, by weights; of one camera,
        ``images`` (pixel,), or of several, (camera, pixel)."""
        out = np.zeros(volume.values.size, np.float32)
        for view, image in zip(np.atleast_1d(views), np.atleast_2d(images), strict=True):
            self._back(view, image, volume, False, out)
        return out

    def multiply(self, views: ArrayLike, corrections: NDArray[np.float32], volume: SparseVolume) -> None:
        """Multiply each voxel by 1 plus the weighted sum of ``corrections`` over the pixels that it lights, or
        empty it where that is negative; n cameras at once whose corrections sum to S < 0 by (1 + S/n)^n."""
        if np.size(views) > 1:
            correct(volume, self.gather(views, corrections, volume), np.size(views))
        else:  # a list of hundreds of millions of voxels has no second one beside it
            self._back(np.atleast_1d(views)[0], np.atleast_2d(corrections)[0], volume, True, volume.values)

    def _back(self, view: int, image: NDArray, volume: SparseVolume, multiply: bool, out: NDArray[np.float32]) -> None:
        """``kernels.gather`` of the image of one camera."""
        listed = volume.row_chunks(CHUNKS), volume.row_start, volume.column
        about = self._constants[view], self.grid.shape[1], *listed, image.astype(np.float32), multiply, out
        in_threads(kernels.gather, CHUNKS, *about)

    def visible_voxels(self) -> SparseVolume:
        """The voxels whose centre every camera sees, each of value 1."""
        volume = self.candidates(np.ones((self.views, max(self.pixels)), np.float32), 0.0)
        return volume.with_values(np.ones_like(volume.values))

    def candidates(self, most: NDArray[np.float32], particle: ArrayLike) -> SparseVolume:
        """The voxels whose footprint shows more than ``particle`` counts of ``most`` (camera, pixel) in every camera.

        Multiplied line of sight (MLOS; Atkinson & Soria 2009, Exp. Fluids 47:553-568): a particle in focus lights about
        one pixel. The voxels' values are the cameras' counts there, multiplied, to the power of 1 over the number of
        cameras. Voxels that a camera does not see are not among them.
        """
        threshold = float(np.max(particle))
        nz, ny, nx = self.grid.shape
        values: list[NDArray[np.float32]] = []

        def planes() -> Iterator[NDArray[np.bool_]]:
            for lo in range(0, nz, SLAB):
                shape = (min(SLAB, nz - lo), ny, nx)
                least, product = np.full(shape, np.inf, np.float32), np.ones(shape)
                for cam, image in zip(self._constants, most, strict=True):
                    in_threads(kernels.least_along_lines_of_sight, shape[0], cam, lo, image, least, product)
                lit = least > threshold
                values.append((product[lit] ** (1 / self.views)).astype(np.float32))
                yield from lit

        volume = SparseVolume.from_planes(self.grid, planes())
        return volume.with_values(np.concatenate(values))

    @property
    def passage(self) -> int:
        """Twice the rows of voxels that one line of sight crosses between the first plane and the last, at the most,
        with a footprint's width. Lines of sight of a camera all lean one way: with a margin of half of them, voxels at
        the border of a tile would be without whole cameras."""
        crossed = max(float(np.ptp(rows, axis=0).max()) for rows in map(self._ray_rows, range(self.views)))
        return ceil(2 * (crossed + self._half_width))

    def tile(self, low: int, high: int) -> PinholeProjector:
        """The same cameras with rows low <= j < high of the voxels; ``seen`` only where a line of sight crosses no
        others."""
        rows = self.grid.shape[1]
        if (low, high) == (0, rows):
            return self
        part = PinholeProjector(self.cameras, self.grid.y_range(low, high))
        first = part._half_width if low else -np.inf
        last = high - low - 1 - part._half_width if high < rows else np.inf
        part._equations = np.zeros_like(self.seen)
        for view, count in enumerate(self.pixels):
            met = part._ray_rows(view)
            part._equations[view, :count] = ((met >= first) & (met <= last)).all(0)
        return part

    def each_camera(self, values: NDArray) -> list[tuple[Projection, NDArray]]:
        """All of them together, since lines of sight of several cameras make a candidate."""
        return [(self, values)]

    def _ray_rows(self, view: int) -> NDArray[np.float64]:
        """Rows of voxels (2, pixel) at which a camera's lines of sight cross the first and the last plane."""
        camera, z = self.cameras[view], self.grid.axes()[2]
        column, row = np.meshgrid(np.arange(camera.sensor.columns), np.arange(camera.sensor.rows))
        pixels = np.stack([column, row], -1).reshape(-1, 2)
        y = np.stack([camera.on_plane(pixels, depth)[:, 1] for depth in z[[0, -1]]])
        return (y - self.grid.first_mm[1]) / self.grid.voxel_mm[1]

    @property
    def _half_width(self) -> float:
        """Half of a voxel's footprint and of a pixel, in rows of voxels."""
        centre = np.array([0.5 * (lo + hi) for lo, hi in self.grid.limits_mm()])
        step, widths = np.array([0.0, self.grid.voxel_mm[1], 0.0]), []
        for camera, cam in zip(self.cameras, self._constants, strict=True):
            row_px = float(np.hypot(*(camera.project(centre + step) - camera.project(centre))))
            widths.append((max(cam.half_column, cam.half_row) + 0.5) / row_px)
        return max(widths)


def pinhole_constants(camera: PinholeCamera, grid: VoxelGrid) -> PinholeConstants:
    """The constants of a camera and a grid that the kernels take."""
    turned = camera.axes * np.array([[1.0], [1.0], [-1.0]])  # right, up, forward
    first = turned @ (np.array(grid.first_mm) - camera.position_mm)
    steps = np.array(grid.voxel_mm)[:, None] * turned.T
    centre = np.array([0.5 * (lo + hi) for lo, hi in grid.limits_mm()])
    half_step = 0.5 * np.diag(grid.voxel_mm)
    across = camera.project(centre + half_step) - camera.project(centre - half_step)  # (x y z, column row)
    side = np.maximum(np.sqrt((across**2).sum(0)), NARROWEST)
    column0, row0 = camera.principal_point
    k1, k2 = camera.distortion
    return PinholeConstants(
        _vector(first), _vector(steps[0]), _vector(steps[1]), _vector(steps[2]),
        camera.focal_length_px, column0, row0, k1, k2,
        0.5 * float(side[0]), 0.5 * float(side[1]), camera.sensor.columns, camera.sensor.rows,
    )  # fmt: skip


def _vector(vector: NDArray) -> kernels.Vector:
    x, y, z = (float(c) for c in vector)
    return x, y, z


def _check_view(camera: PinholeCamera, grid: VoxelGrid, name: str) -> None:
    """All of the grid in front of the camera, some of it on the sensor."""
    limits = grid.limits_mm()
    corners = np.stack(np.meshgrid(*limits), -1).reshape(-1, 3)
    if camera.in_camera(corners)[:, 2].max() >= 0:
        raise PlenoPIVError(
            f"{name}: the volume reaches behind it; check its rotation and its position, now "
            f"{', '.join(f'{c:g}' for c in camera.position_mm)} mm"
        )
    if share_seen(camera, limits) == 0:
        raise PlenoPIVError(
            f"{name}: sees nothing of the volume; check its position, its rotation and the volume's limits"
        )
