"""The voxel grid and the two forms of a reconstructed volume: dense planes or a sparse list of voxels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, isfinite
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError

Limits = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]  # (lo, hi) in mm along x, y, z
SAME = 1e-6  # of a voxel: grids that differ by less do by rounding alone


@dataclass(frozen=True)
class VoxelGrid:
    """A regular grid of voxels. ``shape`` is (nz, ny, nx); ``first_mm`` the centre (x, y, z) of voxel (0, 0, 0)."""

    first_mm: tuple[float, float, float]
    voxel_mm: tuple[float, float, float]
    shape: tuple[int, int, int]

    @classmethod
    def covering(
        cls,
        x_mm: tuple[float, float],
        y_mm: tuple[float, float],
        z_mm: tuple[float, float],
        voxel_mm: tuple[float, float, float],
    ) -> VoxelGrid:
        """The grid between outer faces ``(lo, hi)`` in mm: ceil((hi - lo)/voxel - 1e-6) voxels, centred.

        Raises PlenoPIVError for voxels that are not positive, and limits between which there is no voxel.
        """
        first, count = [], []
        for axis, (lo, hi), d in zip("xyz", (x_mm, y_mm, z_mm), voxel_mm, strict=True):
            if not (isfinite(d) and d > 0):
                raise PlenoPIVError(f"volume.voxel_mm: {d} along {axis}; give a positive number of mm")
            n = ceil((hi - lo) / d - 1e-6) if isfinite(hi - lo) else 0
            if n < 1:
                raise PlenoPIVError(
                    f"volume.{axis}_mm: [{lo}, {hi}] holds no voxel of {d} mm; give the lower limit, then the upper one"
                )
            count.append(n)
            first.append(0.5 * (lo + hi) - 0.5 * (n - 1) * d)
        dx, dy, dz = (float(d) for d in voxel_mm)
        return cls((first[0], first[1], first[2]), (dx, dy, dz), (count[2], count[1], count[0]))

    def __repr__(self) -> str:
        limits = ", ".join(f"{n} {a:.4g} to {b:.4g}" for n, (a, b) in zip("xyz", self.limits_mm(), strict=True))
        counts, sides = " x ".join(map(str, self.shape[::-1])), " x ".join(f"{d:.4g}" for d in self.voxel_mm)
        return f"<VoxelGrid {limits} mm, {counts} voxels of {sides} mm>"

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def agrees_with(self, other: VoxelGrid) -> bool:
        """Whether both are the same but for rounding, which differs between machines: to SAME of a voxel."""
        if self.shape != other.shape:
            return False
        first, voxel = np.subtract(self.first_mm, other.first_mm), np.array(self.voxel_mm)
        apart = np.abs(first) + np.abs(voxel - other.voxel_mm) * self.shape[::-1]
        return bool((apart <= SAME * voxel).all())

    def axes(self) -> tuple[NDArray, NDArray, NDArray]:
        """Voxel centres in mm along x, y and z."""
        nz, ny, nx = self.shape
        x, y, z = (f + d * np.arange(n) for f, d, n in zip(self.first_mm, self.voxel_mm, (nx, ny, nz), strict=True))
        return x, y, z

    def y_range(self, low: int, high: int) -> VoxelGrid:
        """The voxels low <= j < high along y."""
        (x, y, z), (nz, _, nx) = self.first_mm, self.shape
        return VoxelGrid((x, y + low * self.voxel_mm[1], z), self.voxel_mm, (nz, high - low, nx))

    def limits_mm(self) -> Limits:
        """Outer faces along x, y and z."""
        nz, ny, nx = self.shape
        x, y, z = (
            (f - d / 2, f + (n - 0.5) * d) for f, d, n in zip(self.first_mm, self.voxel_mm, (nx, ny, nz), strict=True)
        )
        return x, y, z


def as_points(of: str, position_mm: ArrayLike) -> NDArray[np.float64]:
    """Points (n, 3) in mm, of one (3,) or none too. Raises PlenoPIVError, which says ``of`` what, for another shape."""
    points = np.asarray(position_mm, np.float64)
    if points.size and (points.ndim > 2 or points.shape[-1] != 3):
        raise PlenoPIVError(f"{of}: points of shape {points.shape}, give x, y, z of each: (n, 3)")
    return np.ascontiguousarray(points.reshape(-1, 3))


def check_limits(of: str, limits_mm: Limits) -> None:
    """Raise PlenoPIVError, which says ``of`` what, for limits that are no three rising pairs."""
    limits = np.asarray(limits_mm, np.float64)
    if limits.shape != (3, 2) or not (limits[:, 0] < limits[:, 1]).all():
        raise PlenoPIVError(f"{of}: limits {limits_mm}, give lowest and highest x, y and z: three rising pairs")


def within(points_mm: NDArray[np.float64], limits_mm: Limits) -> NDArray[np.bool_]:
    """Which of the points (n, 3) lie within the limits, (n,)."""
    low, high = np.transpose(limits_mm)
    return np.asarray(((points_mm >= low) & (points_mm <= high)).all(1))


class Volume(Protocol):
    """What the correlation needs of a reconstructed volume."""

    @property
    def grid(self) -> VoxelGrid:
        """Where its voxels are."""

    @property
    def values(self) -> NDArray[np.float32]:
        """Intensity of the voxels that it holds."""

    def slab(self, lo: int, hi: int) -> NDArray[np.float32]:
        """Planes lo <= k < hi as a dense float32 array (hi - lo, ny, nx), to be read only; zero outside the volume."""


@dataclass(frozen=True)
class DenseVolume:
    """Intensity of every voxel, float32 (nz, ny, nx).

    Raises PlenoPIVError for values of another shape than the grid's, beyond which kernels would read.
    """

    grid: VoxelGrid
    values: NDArray[np.float32]

    def __post_init__(self) -> None:
        if np.shape(self.values) != tuple(self.grid.shape):
            raise PlenoPIVError(
                f"volume: values {np.shape(self.values)} on a grid of {self.grid.shape} voxels (z, y, x); give one "
                "value for each voxel"
            )

    def __repr__(self) -> str:
        return f"<DenseVolume {self.grid!r}>"

    def with_values(self, values: NDArray[np.float32]) -> DenseVolume:
        """The same voxels with other intensities."""
        return DenseVolume(self.grid, values)

    def slab(self, lo: int, hi: int) -> NDArray[np.float32]:
        """See ``Volume.slab``."""
        nz, ny, nx = self.grid.shape
        if lo >= 0 and hi <= nz:
            return self.values[lo:hi]
        out = np.zeros((hi - lo, ny, nx), np.float32)
        a, b = max(lo, 0), min(hi, nz)
        if a < b:
            out[a - lo : b - lo] = self.values[a:b]
        return out


@dataclass(frozen=True)
class SparseVolume:
    """Intensity of the voxels that are not empty, row by row (compressed rows, 6 bytes a voxel).

    Row ``r = k * ny + j`` holds the voxels ``row_start[r]`` to ``row_start[r + 1]`` (int64); ``column`` is their index
    along x (uint16, ascending within a row), ``values`` their intensity (float32).
    """

    grid: VoxelGrid
    row_start: NDArray[np.int64]
    column: NDArray[np.uint16]
    values: NDArray[np.float32]

    def __repr__(self) -> str:
        return f"<SparseVolume {self.values.size} voxels not empty of {self.grid!r}>"

    @classmethod
    def from_mask(cls, grid: VoxelGrid, mask: NDArray[np.bool_], value: float = 1.0) -> SparseVolume:
        """The voxels where ``mask`` (nz, ny, nx) is True, all of one intensity."""
        return cls.from_planes(grid, mask, value)

    @classmethod
    def from_planes(cls, grid: VoxelGrid, planes: Iterable[NDArray[np.bool_]], value: float = 1.0) -> SparseVolume:
        """The same from one plane (ny, nx) after the other: no list of indices longer than a plane's is made."""
        counts, columns = [], []
        for plane in planes:
            counts.append(np.count_nonzero(plane, axis=1))
            columns.append(np.nonzero(plane)[1].astype(np.uint16))
        start = np.zeros(grid.shape[0] * grid.shape[1] + 1, np.int64)
        np.cumsum(np.concatenate(counts), out=start[1:])
        column = np.concatenate(columns)
        return cls(grid, start, column, np.full(column.size, value, np.float32))

    @classmethod
    def of(cls, volume: Volume) -> SparseVolume:
        """The voxels of any volume in which there is light, listed plane by plane."""
        counts, columns, values = [np.zeros(1, np.int64)], [], []
        for k in range(volume.grid.shape[0]):
            (plane,) = volume.slab(k, k + 1)
            lit = plane != 0
            counts.append(np.count_nonzero(lit, axis=1))
            columns.append(np.nonzero(lit)[1].astype(np.uint16))
            values.append(plane[lit])
        return cls(volume.grid, np.cumsum(np.concatenate(counts)), np.concatenate(columns), np.concatenate(values))

    @classmethod
    def stacked(cls, grid: VoxelGrid, parts: Sequence[SparseVolume]) -> SparseVolume:
        """The volume of ``grid`` made of ``parts``, one after the other along y."""
        counts = np.concatenate([np.diff(p.row_start).reshape(grid.shape[0], -1) for p in parts], 1)
        planes = [[p._plane(k) for p in parts] for k in range(grid.shape[0])]
        column, values = (
            np.concatenate([getattr(p, name)[part] for plane in planes for p, part in zip(parts, plane, strict=True)])
            for name in ("column", "values")
        )
        return cls(grid, np.concatenate([[0], np.cumsum(counts)]), column, values)

    def y_range(self, low: int, high: int) -> SparseVolume:
        """The voxels low <= j < high along y."""
        nz, ny, _ = self.grid.shape
        start = self.row_start[:-1].reshape(nz, ny)[:, low]
        counts = np.diff(self.row_start).reshape(nz, ny)[:, low:high]
        parts = [slice(a, a + n) for a, n in zip(start, counts.sum(1), strict=True)]
        column, values = (np.concatenate([v[part] for part in parts]) for v in (self.column, self.values))
        return SparseVolume(self.grid.y_range(low, high), np.concatenate([[0], np.cumsum(counts)]), column, values)

    def _plane(self, k: int) -> slice:
        """Where the voxels of a plane are listed."""
        ny = self.grid.shape[1]
        return slice(self.row_start[k * ny], self.row_start[(k + 1) * ny])

    @property
    def occupancy(self) -> float:
        """Share of the grid's voxels that the list holds."""
        return self.column.size / self.grid.size

    def row_chunks(self, count: int) -> NDArray[np.int64]:
        """Bounds (count + 1,) of ``count`` runs of rows with about as many listed voxels each."""
        bounds = np.searchsorted(self.row_start, np.linspace(0, self.column.size, count + 1))
        bounds[0], bounds[-1] = 0, self.row_start.size - 1
        return bounds.astype(np.int64)

    def with_values(self, values: NDArray[np.float32]) -> SparseVolume:
        """The same voxels with other intensities."""
        return SparseVolume(self.grid, self.row_start, self.column, values)

    def slab(self, lo: int, hi: int) -> NDArray[np.float32]:
        """See ``Volume.slab``."""
        nz, ny, nx = self.grid.shape
        out = np.zeros((hi - lo, ny, nx), np.float32)
        a, b = max(lo, 0), max(min(hi, nz), 0)
        if a < b:
            start = self.row_start[a * ny : b * ny + 1]
            row = np.repeat(np.arange((a - lo) * ny, (b - lo) * ny), np.diff(start))
            listed = slice(start[0], start[-1])
            out.reshape(-1, nx)[row, self.column[listed]] = self.values[listed]
        return out

    def mask(self) -> NDArray[np.bool_]:
        """Which voxels are listed, (nz, ny, nx)."""
        out = np.zeros(self.grid.shape, bool)
        ny = self.grid.shape[1]
        for k, plane in enumerate(out):  # one by one: a row's number for every voxel would take more than the list
            counts = np.diff(self.row_start[k * ny : (k + 1) * ny + 1])
            plane[np.repeat(np.arange(ny), counts), self.column[self._plane(k)]] = True
        return out

    def dense(self) -> DenseVolume:
        """The same volume with every voxel stored."""
        return DenseVolume(self.grid, self.slab(0, self.grid.shape[0]))
