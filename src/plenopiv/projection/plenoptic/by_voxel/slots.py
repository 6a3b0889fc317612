"""Which microlenses a voxel may light in a view, and where they are: the regular lattice, then what the array departs.

Lenses are found by the regular lattice. Where the array departs from it, a voxel is moved by as much as the lens next
to it is (``moved``), and each lens by what it differs from that one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import part
from plenopiv.projection.plenoptic.geometry import CameraConstants, Plane
from plenopiv.projection.plenoptic.pixel_weights import floor_of

F = np.float32


@part
def block_centres(
    cam: CameraConstants,
    plane: Plane,
    m: np.float32,
    n: np.float32,
    count: int,
    column: NDArray[np.int32],
    row: NDArray[np.int32],
    cx: NDArray[np.float32],
    cy: NDArray[np.float32],
) -> None:
    """Voxels of a block, seen through the view's nominal portion, in cells from lens (0, 0)."""
    for k in range(count):
        ax = plane.cell_x * (cam.x0 + F(column[k])) + plane.move * m - plane.origin_x
        ay = plane.cell_y * (cam.y0 + F(row[k])) - plane.move * n - plane.origin_y
        cx[k], cy[k] = cam.cos * ax + cam.sin * ay, cam.cos * ay - cam.sin * ax


@part
def move_block(
    cam: CameraConstants,
    box: tuple[int, int, int, int],
    plane: Plane,
    moved: NDArray[np.float32],
    count: int,
    cx: NDArray[np.float32],
    cy: NDArray[np.float32],
    by: NDArray[np.int64],
) -> None:
    """Move the voxels of a block (cx, cy), in cells, to where they lie on the regular lattice: by as much as the array
    moves the lens nearest to them, whose number goes into ``by``."""
    i0, j0, ni, nj = box
    for k in range(count):
        x, y, lens = cx[k], cy[k], 0
        for _ in range(4):
            j = floor_of(y / (plane.pitch * cam.row) + F(0.5))
            odd = F(j & 1) if cam.hexagonal else F(0)
            i = floor_of(x / plane.pitch - F(0.5) * odd + F(0.5))
            i, j = min(max(i - i0, 0), ni - 1), min(max(j - j0, 0), nj - 1)
            lens = j * ni + i
            x, y = cx[k] - plane.pitch * moved[lens, 0], cy[k] - plane.pitch * moved[lens, 1]
        cx[k], cy[k], by[k] = x, y, lens


@part
def first_rows(
    cam: CameraConstants,
    plane: Plane,
    count: int,
    cy: NDArray[np.float32],
    j_of: NDArray[np.int64],
    high: np.float32,
) -> None:
    """The first row of lenses that each voxel of a block may light."""
    spacing = plane.pitch * cam.row
    for k in range(count):
        j_of[k] = floor_of((cy[k] - high) / spacing) + 1


@part
def first_lenses(
    cam: CameraConstants,
    plane: Plane,
    count: int,
    cx: NDArray[np.float32],
    j_of: NDArray[np.int64],
    dj: int,
    wide: np.float32,
    first_i: NDArray[np.int64],
) -> None:
    """The first lens that each voxel of a block may light in row ``dj`` of its window."""
    for k in range(count):
        odd = F((j_of[k] + dj) & 1) if cam.hexagonal else F(0)
        first_i[k] = floor_of((cx[k] - wide) / plane.pitch - F(0.5) * odd) + 1


@part
def slot_places(
    cam: CameraConstants,
    box: tuple[int, int, int, int],
    phase: NDArray[np.float32],
    moved: NDArray[np.float32],
    plane: Plane,
    count: int,
    cx: NDArray[np.float32],
    cy: NDArray[np.float32],
    by: NDArray[np.int64],
    first_i: NDArray[np.int64],
    j_of: NDArray[np.int64],
    dj: int,
    di: int,
    lens: NDArray[np.int64],
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    qx: NDArray[np.float32],
    qy: NDArray[np.float32],
    m: np.float32,
    n: np.float32,
) -> None:
    """For one slot: each voxel's lens, its place relative to its footprint's centre (cells), and q of the pixel.
    ``lens`` is the flat number, or -1 outside the block of lenses."""
    i0, j0, ni, nj = box
    spacing = plane.pitch * cam.row
    for k in range(count):
        j = j_of[k] + dj
        odd = (j & 1) if cam.hexagonal else 0
        i = first_i[k] + di
        half_pitches = 2 * i + odd
        here = (i >= i0) & (i < i0 + ni) & (j >= j0) & (j < j0 + nj)
        at = (j - j0) * ni + (i - i0) if here else 0
        phase_c, phase_r = phase[at, 0], phase[at, 1]
        px, py = -plane.move * phase_c, plane.move * phase_r
        x[k] = cx[k] - F(0.5) * plane.pitch * F(half_pitches) + cam.cos * px + cam.sin * py
        y[k] = cy[k] - spacing * F(j) + cam.cos * py - cam.sin * px
        qx[k], qy[k] = m - phase_c, phase_r - n
        lens[k] = at if here else -1
        if moved.shape[0] > 1:
            x[k] -= plane.pitch * (moved[at, 0] - moved[by[k], 0])
            y[k] -= plane.pitch * (moved[at, 1] - moved[by[k], 1])
