"""The light of many particles in the pixels of a plenoptic camera, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import ceil, cos, floor, pi, sin
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.ray_model import on_disc
from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVError
from plenopiv.threads import in_threads
from plenopiv.tracking import entry_kernels
from plenopiv.tracking import light_kernels as kernels
from plenopiv.tracking import soft_light_kernels as soft_kernels
from plenopiv.tracking.bent_cells import SHIFT_POWERS
from plenopiv.tracking.edge_integrals import EDGE, TAIL
from plenopiv.tracking.light_kernels import LightConstants
from plenopiv.tracking.search import places_of_light
from plenopiv.tracking.soft_cells import LEAST, soft_cell, weights_of_sub_pixels
from plenopiv.tracking.whole_cells import CellTables, cell_tables
from plenopiv.volume import Limits, as_points

WAVELENGTH_NM = 532.0  # of the lasers that particles are lit by
SHIFT_PLACES = 31  # of the main lens, at which a point's shifts of rays are taken
ROOM = 24, 12  # entries more than a point has that there is room for, where it moves: so many, and one of so many
TOGETHER = 1000  # points whose shifts are taken at a time
UNIT_MM = np.array([0.01, 0.01, 0.05])  # of the unknowns at M = -1: all of a particle's information is of one order
SHARPEST_PX = 0.05  # standard deviation of a boundary that nothing blurs: sharper ones would need more nodes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lights:
    """Where the light of n points goes. Entries ``start[i]`` to ``start[i + 1]`` are point i's.

    ``start`` (n + 1,); ``pixel`` (m,), row * columns + column of an upright image; ``share`` (m,) of the point's light;
    ``gradient`` (m, 3): change of the share per mm of x, y, z. A pixel that two microlenses of a point light is listed
    twice. ``unit_mm`` (3,): of x, y, z in the equations that these make, about what moves a point's light by a pixel.
    ``overlap``: many faint entries, of several microlenses, add up in a pixel; ``roomy``: points have room for more
    entries, some without light.
    """

    start: NDArray[np.int64]
    pixel: NDArray[np.int32]
    share: NDArray[np.float32]
    gradient: NDArray[np.float32]
    unit_mm: Array = field(default_factory=UNIT_MM.copy)
    overlap: bool = False
    roomy: bool = False

    @property
    def point(self) -> NDArray[np.int64]:
        """Which point each entry is of (m,)."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def image(self, light: Array, pixels: int) -> Array:
        """Counts in each of ``pixels`` of points of so much ``light`` (n,)."""
        out = np.zeros(pixels)
        self.add_to(out, light)
        return out

    def add_to(self, image: Array, light: Array) -> None:
        """Add the counts of points of so much ``light`` (n,) to an image of all pixels."""
        entry_kernels.sum_light(self.start, self.pixel, self.share, np.asarray(light, np.float64), image)

    def of_lit(self) -> tuple[NDArray[np.int64], Lights]:
        """The pixels (k,) that any point lights, ascending, and the same lights in an image of these alone."""
        if not len(self.pixel):
            return np.empty(0, np.int64), self
        first, last = int(self.pixel.min()), int(self.pixel.max())
        number, own = np.zeros(last + 1 - first, np.int32), np.empty_like(self.pixel)
        lit = np.empty(min(number.size, own.size), np.int64)
        count = entry_kernels.number_lit(self.pixel, first, number, lit, own)
        return lit[:count], replace(self, pixel=own)

    def of(self, which: NDArray[np.int64]) -> Lights:
        """The light of the points ``which`` alone."""
        return _taken(self, self, which)

    def with_others(self, which: NDArray[np.int64], others: Lights) -> Lights:
        """The light of the points ``which`` and then of ``others``."""
        source = np.concatenate([which, len(self.start) - 1 + np.arange(len(others.start) - 1)])
        return _taken(self, others, source)

    def replaced(self, places: NDArray[np.int64], others: Lights) -> Lights:
        """The same, with the points ``places`` (k,) those of ``others``: these lists, changed, where there is room for
        their entries, or else new ones with more room, entries without light. Lists that share these arrays, as those
        that are ``shifted`` from them, must not be used any more."""
        needed, room = np.diff(others.start), np.diff(self.start)
        if (needed <= room[places]).all():
            in_threads(entry_kernels.replace_entries, len(places), *_arrays(others), places, *_arrays(self))
            return self
        source = np.arange(len(room))
        source[places] = len(room) + np.arange(len(places))
        if not self.roomy:
            room = _with_room(room)
        room[places] = np.where(needed > 0, np.maximum(room[places], _with_room(needed)), 0)
        return replace(_taken(self, others, source, room), roomy=True)

    def shifted(self, which: NDArray[np.int64], by_mm: Array) -> Lights:
        """The same with the points ``which`` (k,) moved by small steps (k, 3) in mm, to first order."""
        share = self.share.copy()
        entry_kernels.shift_shares(self.start, self.gradient, which, np.asarray(by_mm, np.float64), share)
        return replace(self, share=share)

    def whole(self) -> Array:
        """The share of each point's light that falls on the sensor (n,)."""
        return np.asarray(np.bincount(self.point, self.share, len(self.start) - 1), np.float64)


def _taken(first: Lights, second: Lights, source: NDArray[np.int64], count: NDArray[np.int64] | None = None) -> Lights:
    """The points ``source`` of those of ``first``, counted from 0, and of ``second``, counted on, with room for
    ``count`` (n,) entries of each, or as many as there are."""
    if count is None:
        count = np.concatenate([np.diff(first.start), np.diff(second.start)])[source]
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    out = Lights(
        start,
        np.empty(start[-1], np.int32),
        np.empty(start[-1], np.float32),
        np.empty((start[-1], 3), np.float32),
        first.unit_mm,
        first.overlap,
        first.roomy,
    )
    parts = (*_arrays(first), *_arrays(second), source.astype(np.int64), *_arrays(out))
    in_threads(entry_kernels.take_entries, len(source), *parts)
    return out


def _with_room(count: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.where(count > 0, count + ROOM[0] + count // ROOM[1], 0)


def _arrays(lights: Lights) -> tuple[NDArray, ...]:
    return lights.start, lights.pixel, lights.share, lights.gradient


class LightOfPoints(Protocol):
    """Where the light of points goes in all pixels of a frame, of one camera or of several one after the other."""

    @property
    def prior_std_mm(self) -> Array:
        """Standard deviations (3,) of where a particle may be that pixels tell next to nothing of."""

    @property
    def frame_pixels(self) -> int:
        """How many pixels a frame has."""

    def __call__(self, position_mm: ArrayLike) -> Lights:
        """The light of points at ``position_mm`` (n, 3)."""

    def places(self, excess: Array, limits_mm: Limits) -> tuple[Array, Array]:
        """Places (n, 3) in mm within ``limits_mm`` that may hold a particle more, and their scores (n,), best first.

        ``excess`` (pixels,): standard deviations by which each pixel is brighter than the known particles make it; NaN
        where it cannot be used.

        Raises PlenoPIVError where ``excess`` has another number of pixels than the cameras.
        """


def check_number(pixels: int, of_cameras: int) -> None:
    """Raise PlenoPIVError where so many ``pixels`` are given and the cameras have another number."""
    if pixels != of_cameras:
        raise PlenoPIVError(
            f"tracking: {pixels} pixels are given, the cameras have {of_cameras}; give the image of each camera, in "
            "their order"
        )


def unit_mm(camera: PlenopticCamera) -> Array:
    """UNIT_MM (3,) of a camera: light moves with M across, and with M^2 along depth. A unit sets the longest step."""
    across = 1.0 / abs(camera.main_lens.magnification)
    return UNIT_MM * [across, across, across**2]


def prior_std_mm(camera: PlenopticCamera) -> Array:
    """Standard deviations (3,) of a particle somewhere in a dead zone: even within a microlens' cell, as the focal
    plane sees it, and within the zone's depth."""
    across = camera.lattice.pitch_mm / abs(camera.main_lens.magnification) / 12.0**0.5
    low, high = camera.dead_zone_mm()
    return np.array([across, across, 0.5 * (high - low) / 3.0**0.5])


def diffraction_px(camera: PlenopticCamera, wavelength_nm: float = WAVELENGTH_NM) -> float:
    """Standard deviation in pixels of the Gaussian nearest to a microlens' Airy disc, 0.42 lambda f_l / p_l."""
    blur_mm = 0.42e-6 * wavelength_nm * camera.microlens_focal_length_mm / camera.lattice.pitch_mm
    return blur_mm / camera.sensor.pixel_pitch_mm


class PointLights:
    """Makes the ``Lights`` of points for one camera.

    ``blur_px``: standard deviation of the Gaussian that blurs micro-images, by default ``diffraction_px`` of green
    light. ``left``: how far rays fall beside those of a thin lens (``SpaceMap.left``), points then being those of lens
    space. Cells are bent by it, and so are derivatives (``bent_cells``); the places of pixels leave it out.
    ``growth``: by what share micro-images are wider, per mm of a microlens' s and t (``SpaceMap.growth``).
    """

    def __init__(
        self,
        camera: PlenopticCamera,
        blur_px: float | None = None,
        left: ViewShift | None = None,
        growth: tuple[float, float] = (0.0, 0.0),
    ):
        self.camera, self.left, self.unit_mm = camera, left, unit_mm(camera)
        self.blur_px = max(diffraction_px(camera) if blur_px is None else blur_px, SHARPEST_PX)
        self._centres, self._cell, self.constants = _constants(camera, self.blur_px, growth)
        self._soft = camera.blur_mm > LEAST * camera.lattice.pitch_mm
        self._kernel: Any
        self._of_cells: tuple[Any, ...]
        if self._soft:
            cell = soft_cell(self._cell, camera.lattice.pitch_mm, camera.blur_mm)
            self._kernel = soft_kernels.soft_light_of_points
            self._of_cells = cell, weights_of_sub_pixels(soft_kernels.PARTS, self.blur_px)
        else:
            outline = self._cell * [1.0, -1.0] / camera.lattice.pitch_mm
            straight = left is None
            self._tables = cell_tables(outline, self.blur_px) if straight else CellTables(outline, self.blur_px, 0.0)
            self._kernel = kernels.light_of_points
            self._of_cells = self._cell, self._tables.profile, self._tables.cells
        radius = self.constants.radius
        self._u_mm = on_disc(radius, SHIFT_PLACES)
        u, v = self._u_mm.T / radius
        self._of_places = np.linalg.pinv(np.stack([u**p * v**q for p, q in SHIFT_POWERS], 1))
        if left is not None:
            most = np.abs(left(np.repeat(self._u_mm, 2, 0), np.tile([[left.s_mm] * 2, [0.0, 0.0]], (SHIFT_PLACES, 1))))
            beside = float(most.max()) / camera.lattice.pitch_mm
            self.constants = self.constants._replace(moved=self.constants.moved + beside)

    @property
    def prior_std_mm(self) -> Array:
        """See ``prior_std_mm``."""
        return prior_std_mm(self.camera)

    @property
    def frame_pixels(self) -> int:
        """How many pixels a frame has."""
        return self.camera.sensor.rows * self.camera.sensor.columns

    def places(self, excess: Array, limits_mm: Limits) -> tuple[Array, Array]:
        """See ``LightOfPoints`` and ``search``."""
        check_number(len(excess), self.frame_pixels)
        return places_of_light(self.camera, self.constants, self._centres, excess, limits_mm)

    def __call__(self, position_mm: ArrayLike) -> Lights:
        """The light of points at ``position_mm`` (n, 3), x, y, z in mm.

        Raises:
            PlenoPIVError: a point is not in front of the main lens, or not a number.
        """
        position = as_points("tracking", position_mm)
        nearest = self.camera.main_lens.object_distance_mm
        if not (np.isfinite(position).all() and (position[:, 2] < nearest).all()):
            raise PlenoPIVError(f"tracking: a particle is not in front of the main lens at z = {nearest:g} mm")
        start, count = np.zeros(len(position) + 1, np.int64), np.empty(len(position), np.int64)
        nothing = np.empty(0, np.int32), np.empty(0, np.float32), np.empty((0, 3), np.float32)
        if not self._soft:
            spread = self.camera.spread(position[:, 2])
            of_pitch = np.abs(1.0 - spread) / np.maximum(np.abs(spread), kernels.SMALLEST_SPREAD)
            pixels_a_pitch = self.camera.lattice.pitch_mm / self.constants.pixel
            self._tables.make(self.constants.image_scale * of_pitch * pixels_a_pitch)
        fixed = self.constants, self._centres, *self._of_cells, position, self._shifts(position)
        in_threads(self._kernel, len(position), *fixed, True, start, count, *nothing)
        np.cumsum(count, out=start[1:])
        filled = (
            np.empty(start[-1], np.int32),
            np.empty(start[-1], np.float32),
            np.empty((start[-1], 3), np.float32),
        )
        in_threads(self._kernel, len(position), *fixed, False, start, count, *filled)  # fewer than there may be
        entry_kernels.close_up(start, count, *filled)
        pixel, share, gradient = filled
        entries = pixel[: start[-1]], share[: start[-1]], gradient[: start[-1]]
        return Lights(start, *entries, self.unit_mm, overlap=self._soft)

    def _shifts(self, position: Array) -> Array:
        """Of each point (n, terms, 2): the polynomial in a ray's place on the main lens of how far it falls beside."""
        if self.left is None:
            return np.empty((len(position), 0, 2))
        places, out = len(self._u_mm), np.empty((len(position), len(SHIFT_POWERS), 2))
        spread, scale = self.camera.spread(position[:, 2]), self.camera.scale(position[:, 2])
        for low in range(0, len(position), TOGETHER):
            some = slice(low, low + TOGETHER)
            middle = scale[some, None] * position[some, :2]
            s = spread[some, None, None] * self._u_mm + middle[:, None]
            beside = self.left(np.tile(self._u_mm, (len(s), 1)), s.reshape(-1, 2)).reshape(len(s), places, 2)
            out[some] = self._of_places @ beside
        return out


def _constants(
    camera: PlenopticCamera, blur_px: float, growth: tuple[float, float]
) -> tuple[Array, Array, LightConstants]:
    """Centres of the microlenses (nj, ni, 2), corners of a cell (n, 2), clockwise, and the other constants."""
    lattice, sensor, lens = camera.lattice.aligned(), camera.sensor, camera.main_lens
    half_s, half_t = 0.5 * sensor.columns * sensor.pixel_pitch_mm, 0.5 * sensor.rows * sensor.pixel_pitch_mm
    s, t = np.array([-half_s, half_s, -half_s, half_s]), np.array([-half_t, -half_t, half_t, half_t])
    a, b = lattice.coordinates(s, t)
    b = b / lattice.row_spacing
    i0, i1, j0, j1 = floor(a.min()) - 2, ceil(a.max()) + 2, floor(b.min()) - 2, ceil(b.max()) + 2
    j, i = np.mgrid[j0 : j1 + 1, i0 : i1 + 1]
    centres = np.stack(lattice.centres(i, j), -1)
    moved = centres - np.stack(lattice.regular_centres(i, j), -1)
    sides = 6 if lattice.kind == "hexagonal" else 4
    far = lattice.pitch_mm / (2.0 * cos(pi / sides))
    turned = lattice.rotation_rad + pi / sides - 2.0 * pi / sides * np.arange(sides)
    cell = far * np.stack([np.cos(turned), np.sin(turned)], -1)
    if lattice.map is not None:  # cells are stretched as the array is, taken where it is on the optical axis
        cell = cell + np.stack(lattice.map.displacement(*cell.T), -1)
    column0, row0 = sensor.axis
    return (
        np.ascontiguousarray(centres),
        cell,
        LightConstants(
            lattice.kind == "hexagonal",
            cos(lattice.rotation_rad),
            sin(lattice.rotation_rad),
            lattice.pitch_mm,
            lattice.row_spacing,
            float(lattice.offset_mm[0]),
            float(lattice.offset_mm[1]),
            int(i0),
            int(j0),
            camera.image_scale,
            0.5 * lens.aperture_mm,
            *growth,
            sensor.pixel_pitch_mm,
            column0,
            row0,
            sensor.columns,
            sensor.rows,
            lens.object_distance_mm,
            lens.image_distance_mm,
            lens.focal_length_mm,
            0.5 + TAIL * blur_px,
            0.5 + EDGE * blur_px,
            sides,
            float(np.hypot(*moved.T).max()) / lattice.pitch_mm,
        ),
    )
