"""Camera, layout and voxel grid as the few numbers that a ray kernel needs.

Derivation. A ray of a voxel (x, z) through the main lens at u meets the microlens plane at s = A u + B x and, under
the microlens S, the sensor at S + e ((A - 1) u + B x) (optics.py). A sensor position -e q away from the micro-image's
centre S (1 + e) is thus reached by u = (q + B x - S) / (1 - A), and that ray lies under S where

    A q + B x - S   is in the microlens' cell scaled by (1 - A).

With lengths in *cells*, pitches divided by (1 - A), what a pixel receives of a voxel is the area that its square of
side |A| portion / ((1 - A) pitch) shares with a cell of unit size: exact for every lattice and depth. A lattice turned
by a few degrees against the pixels is taken to first order in the angle (``pixel_weights.patch_area``).

At the aperture's rim the pixel is cut by the disc |u| <= P_m/2: in pixels of q, one of radius (1 - A) R around
(S - B x)/portion.

Names: ``camera`` is the ``PlenopticCamera`` here, and the ``CameraOnGrid`` in what is built on it; ``cam``, in kernels,
is always the ``CameraConstants``.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.coverage import half_sensor_mm
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.space_map import PLACE_POWERS
from plenopiv.lightfield import Layout
from plenopiv.volume import VoxelGrid

SMALLEST = 0.01  # half side of a pixel's square, cells: float32 does not resolve the area of a smaller one


class Plane(NamedTuple):
    """The constants of one plane of voxels, as kernels take them; ``planes`` has those of all planes."""

    voxel_s: np.float32  # voxels along x per mm of s: 1 / (B dx)
    voxel_t: np.float32
    step_x: np.float32  # voxels along x that a footprint moves per pixel of q: -A portion / (B dx)
    step_y: np.float32
    cell_x: np.float32  # cells per voxel along x: B dx / ((1 - A) pitch)
    cell_y: np.float32
    half: np.float32  # half side of a pixel's square, cells
    move: np.float32  # cells per pixel of q: A portion / ((1 - A) pitch)
    spread: np.float32  # A
    drift: np.float32  # pixels of q that the disc moves per cell: (1 - A) pitch / portion
    light: np.float32  # share of a voxel's light that a wholly lit pixel collects
    pitch: np.float32  # cells per pitch: 1 / (1 - A)
    origin_x: np.float32  # microlens (0, 0) in cells
    origin_y: np.float32


def planes(camera: PlenopticCamera, grid: VoxelGrid) -> NDArray[np.float32]:
    """The constants of every plane, float32 (nz, 14): column by column the fields of ``Plane``."""
    z = grid.axes()[2]
    dx, dy, _ = grid.voxel_mm
    a, b = camera.spread(z), camera.scale(z)
    pitch, portion = camera.lattice.pitch_mm, camera.portion_mm
    move = a * portion / ((1 - a) * pitch)
    columns = {
        "voxel_s": 1 / (b * dx),
        "voxel_t": 1 / (b * dy),
        "step_x": -a * portion / (b * dx),
        "step_y": -a * portion / (b * dy),
        "cell_x": b * dx / ((1 - a) * pitch),
        "cell_y": b * dy / ((1 - a) * pitch),
        "half": np.maximum(np.abs(move) / 2, SMALLEST),
        "move": move,
        "spread": a,
        "drift": (1 - a) * pitch / portion,
        "light": (portion / (1 - a)) ** 2 / (pi / 4 * camera.main_lens.aperture_mm**2),
        "pitch": 1 / (1 - a),
        "origin_x": camera.lattice.offset_mm[0] / ((1 - a) * pitch),
        "origin_y": camera.lattice.offset_mm[1] / ((1 - a) * pitch),
    }
    return np.stack([np.broadcast_to(columns[name], z.shape) for name in Plane._fields], -1).astype(np.float32)


def column_of(table: NDArray[np.float32], *names: str) -> NDArray[np.float32]:
    """The columns of ``planes`` that ``Plane`` calls so: of one name (nz,), of several (nz, names)."""
    index = [Plane._fields.index(name) for name in names]
    return table[:, index[0]] if len(index) == 1 else table[:, index]


class CameraConstants(NamedTuple):
    """The constants of a camera and a grid that are the same for every plane: what kernels call ``cam``."""

    hexagonal: bool
    radius: np.float32  # of the aperture, pixels of q
    cos: np.float32
    sin: np.float32
    turn: np.float32  # sine of the angle between the lattice's rows and the nearer axis of the sensor
    swapped: bool  # that axis is t: rows run along y
    row: np.float32  # row spacing of the lattice in pitches
    x0: np.float32  # first voxel centre in voxels from the axis: x0 / dx
    y0: np.float32
    blur: np.float32  # standard deviation of the main lens' blur along each axis, cells (``blurred``)


def camera_constants(camera: PlenopticCamera, grid: VoxelGrid) -> CameraConstants:
    """The ``CameraConstants`` of a camera and a grid."""
    lattice, f = camera.lattice, np.float32
    return CameraConstants(
        lattice.kind == "hexagonal",
        f(camera.aperture_radius_px),
        f(cos(lattice.rotation_rad)),
        f(sin(lattice.rotation_rad)),
        f(sin(lattice.turn_rad)),
        bool(round(lattice.rotation_rad / (pi / 2)) % 2),
        f(lattice.row_spacing),
        f(grid.first_mm[0] / grid.voxel_mm[0]),
        f(grid.first_mm[1] / grid.voxel_mm[1]),
        f(camera.blur_mm / lattice.pitch_mm),
    )


class CameraOnGrid:
    """A camera's layout of pixels and a grid of voxels, with the constants that kernels need of both.

    ``cam``, ``planes`` (nz, 14): the constants (``CameraConstants``, ``planes``). ``lens_mm`` (lens, 2): centres of the
    microlenses, s and t. ``rim`` (view,): the views with pixels that the aperture's rim cuts.

    ``shifts`` (view, terms, 2): by how far light falls beside that of a thin lens in each view, (s, t) on the microlens
    plane in mm as sums of ``PLACE_POWERS`` of s and t in mm; None for a thin lens.
    """

    def __init__(self, layout: Layout, grid: VoxelGrid, shifts: NDArray[np.float32] | None = None):
        self.layout, self.grid, self.shifts = layout, grid, shifts
        self.cam, self.planes = camera_constants(layout.camera, grid), planes(layout.camera, grid)
        self.blurred: NDArray[np.float32] | None = (
            None  # weights with the main lens' blur, once asked for (``blurred``)
        )
        self.lens_mm = lenses_mm(layout)
        m, n = np.abs(layout.offsets).T
        self.rim = np.hypot(m + 1.05, n + 1.05) > layout.camera.aperture_radius_px  # phase and drift move it by 0.55

    def places_mm(self, view: int | np.int64) -> NDArray[np.float32]:
        """Centres of the microlenses (lens, 2) as a view sees them: light that falls beside its place is taken for that
        of a thin lens under a microlens beside its own place."""
        if self.shifts is None:
            return self.lens_mm
        s, t = self.lens_mm.T
        of_s, of_t = [np.ones_like(s), s, s * s, s * s * s], [np.ones_like(t), t, t * t, t * t * t]
        out = self.lens_mm.copy()
        for (ds, dt), (p, q) in zip(self.shifts[view], PLACE_POWERS, strict=True):
            term = of_s[p] * of_t[q]
            out[:, 0] -= ds * term
            out[:, 1] -= dt * term
        return out

    def lenses_moved(self, view: int | np.int64) -> tuple[NDArray[np.float32], np.float32]:
        """How far each microlens is from its place on the regular lattice in a view, (lens, 2), along and across the
        rows, in pitches, and the most that this changes from one lens to the next; (1, 2) of 0 for a regular array."""
        lattice, layout = self.layout.camera.lattice, self.layout
        if lattice.map is None and self.shifts is None:
            return np.zeros((1, 2), np.float32), np.float32(0)
        j, i = np.mgrid[layout.j0 : layout.j0 + layout.nj, layout.i0 : layout.i0 + layout.ni]
        s, t = lattice.regular_centres(i, j)
        ds, dt = np.moveaxis(self.places_mm(view).reshape(*s.shape, 2), -1, 0) - np.stack([s, t])
        c, sine = cos(lattice.rotation_rad) / lattice.pitch_mm, sin(lattice.rotation_rad) / lattice.pitch_mm
        moved = np.stack([c * ds + sine * dt, c * dt - sine * ds], -1)
        change = max(float(np.linalg.norm(np.diff(moved, axis=axis), axis=-1).max(initial=0.0)) for axis in (0, 1))
        return moved.reshape(-1, 2).astype(np.float32), np.float32(1.5 * change)

    def column(self, *names: str) -> NDArray[np.float32]:
        """``column_of`` its planes."""
        return column_of(self.planes, *names)

    def visible_planes(self) -> Iterator[NDArray[np.bool_]]:
        """Plane by plane the voxels (ny, nx) that the middle of the aperture sees; about half the views see one at the
        border."""
        half_s, half_t = half_sensor_mm(self.layout.camera)
        x, y, z = self.grid.axes()
        for scale in np.abs(self.layout.camera.scale(z)):
            yield (scale * np.abs(y) <= half_t)[:, None] & (scale * np.abs(x) <= half_s)

    def ray_ends(self, view: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where the central rays of a view's pixels cross the first and the last plane: columns and rows, each (2,
        lens), in voxels. In between they are straight."""
        (m, n), layout, found = self.layout.offsets[view], self.layout, []
        s, t = self.places_mm(view).T
        for k in (0, -1):
            plane = Plane(*self.planes[k].astype(np.float64))
            column = plane.voxel_s * s + plane.step_x * (m - layout.phase[:, 0]) - self.cam.x0
            row = plane.voxel_t * t + plane.step_y * (layout.phase[:, 1] - n) - self.cam.y0
            found.append((column, row))
        columns, rows_of_voxels = zip(*found, strict=True)
        return np.stack(columns), np.stack(rows_of_voxels)


def lenses_mm(layout: Layout) -> NDArray[np.float32]:
    """Centres of the microlenses, (lens, 2), s and t."""
    j, i = np.mgrid[layout.j0 : layout.j0 + layout.nj, layout.i0 : layout.i0 + layout.ni]
    return np.stack(layout.camera.lattice.centres(i.ravel(), j.ravel()), -1).astype(np.float32)
