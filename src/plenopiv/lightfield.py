"""Raw image to light field: every raw pixel gets its microlens and its portion of the main lens.

Nothing is interpolated. A real micro-image pitch is 14.04 px on a rotated lattice, so pixels do not fall on a common
grid of main-lens portions; resampling onto one would blur the angles and correlate the noise. Instead a *view* is one
pixel offset ``(m, n)`` from the pixel nearest to each micro-image's centre, and what that pixel misses its nominal
portion by, the lens' ``phase`` (at most half a pixel), goes into the weights:

    portion seen by view (m, n) under lens S:   q = ((m - phase_c), -(n - phase_r)) * portion_mm

on the main lens, in the object's x and y (see ``projection``). Counts and their noise stay those of the raw pixels.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from math import cos, degrees, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.sensor import check_pixels, first_not_finite

LIT_SHARE = 0.5  # a pixel less lit by its own lens than this is no equation of the light field
LARGEST_TURN_RAD = radians(6.0)  # beyond this the projector's weights are off by more than 1 %
EVEN = 0.99  # of its light, where every pixel keeps more the rim is taken to clip none
FOREIGN_SHARE = 0.001  # nor is one that a neighbouring lens lights by more than this


@dataclass(frozen=True)
class Layout:
    """Which raw pixel is which (view, lens), for one camera. The same for every frame of a recording.

    Lenses are a rectangular block of lattice indices, flat lens number ``(j - j0) * ni + (i - i0)``.
    """

    camera: PlenopticCamera
    i0: int
    j0: int
    ni: int
    nj: int
    offsets: NDArray[np.int32]  # (view, 2): pixel offset (m along columns, n along rows)
    pixel: NDArray[np.int32]  # (lens, 2): column and row of the pixel nearest to the micro-image's centre
    phase: NDArray[np.float32]  # (lens, 2): micro-image centre minus that pixel, px
    fill: NDArray[np.float32]  # (view, lens): share of the pixel that the lens' image of the aperture lights
    seen: NDArray[np.bool_]  # (view, lens): the pixel exists, is lit by this lens and by no other, and can be used
    lost: NDArray[np.bool_] | None = None  # (view, lens): would be seen, but cannot be used
    light: NDArray[np.float32] | None = None  # (view, lens): of that light, what the lens' rim leaves; None for all

    def __repr__(self) -> str:
        return f"<Layout {self.views} views of {self.ni} x {self.nj} microlenses>"

    @property
    def views(self) -> int:
        """Number of views."""
        return self.offsets.shape[0]

    @property
    def lenses(self) -> int:
        """Number of lenses in the block."""
        return self.ni * self.nj

    @property
    def lost_share(self) -> float:
        """Share of the pixels lost under the microlens that lost most of them, of those with half of all views."""
        if self.lost is None:
            return 0.0
        lost, seen = self.lost.sum(0), self.seen.sum(0)
        full = 2 * (lost + seen) >= self.views
        return float((lost[full] / (lost + seen)[full]).max(initial=0.0))

    def whole(self) -> Layout:
        """The same, were all pixels usable."""
        return self if self.lost is None else replace(self, seen=self.seen | self.lost, lost=None)


@dataclass(frozen=True)
class LightField:
    """One frame as ``values`` (view, lens), float32 counts above the black level; 0 where ``layout.seen`` is False."""

    layout: Layout
    values: NDArray[np.float32]

    def __repr__(self) -> str:
        return f"<LightField {self.layout!r}, counts above the black level>"


def disc_share(x: NDArray, y: NDArray, radius: float, strips: int = 32) -> NDArray:
    """Area of the unit square centred at (x, y) that lies in the disc of ``radius`` around the origin (all px)."""
    x, y = np.broadcast_arrays(np.abs(x), np.abs(y))
    out = np.zeros(x.shape)
    near, far = np.hypot(np.maximum(x - 0.5, 0), np.maximum(y - 0.5, 0)), np.hypot(x + 0.5, y + 0.5)
    out[far <= radius] = 1.0
    rim = (far > radius) & (near < radius)
    if not rim.any():
        return out
    u, v = np.maximum(x[rim], y[rim]), np.minimum(x[rim], y[rim])  # strips along the steeper side of the rim
    total = np.zeros(u.shape)
    for k in range(strips):
        w = v - 0.5 + (k + 0.5) / strips
        reach = np.sqrt(np.maximum(radius**2 - w**2, 0.0))
        total += np.clip(np.minimum(u + 0.5, reach) - np.maximum(u - 0.5, -reach), 0.0, 1.0)
    out[rim] = total / strips
    return out


def rim_share(camera: PlenopticCamera, x: NDArray, y: NDArray, s_mm: NDArray, t_mm: NDArray) -> NDArray[np.float64]:
    """Of the light that the aperture sends to pixels (x, y) px, along columns and rows, from the centres of the
    micro-images of lenses at (s, t) mm, what the main lens' rim leaves."""
    rim, px = camera.rim, 1.0 / camera.portion_mm
    if rim is None:
        return np.ones(np.shape(x))
    at_x = x - px * (rim.slip * s_mm + rim.start_mm[0])  # a place on the main lens is seen at the same (x, -y)
    at_y = y + px * (rim.slip * t_mm + rim.start_mm[1])
    share, fill = disc_share(at_x, at_y, rim.radius_mm * px, 8), disc_share(x, y, camera.aperture_radius_px, 8)
    cosine = (x * at_x + y * at_y) / np.maximum(np.hypot(x, y) * np.hypot(at_x, at_y), 1e-9)
    along = 2.0 / np.pi * np.arcsin(np.clip(cosine, -1.0, 1.0))  # of edges at right angles the product, and so on
    both = (1 - np.abs(along)) * fill * share + np.maximum(along, 0) * np.minimum(fill, share)
    both += np.maximum(-along, 0) * np.maximum(fill + share - 1, 0)
    return np.where(fill > 0, both / np.maximum(fill, 1e-9), 1.0)


def _neighbour_offsets_px(camera: PlenopticCamera) -> NDArray:
    """Micro-image centres of a lens' neighbours relative to its own, (n, 2) px (column, row), for an even row."""
    i, j = np.meshgrid(np.arange(-2, 3), np.arange(-2, 3))
    s, t = camera.lattice.centres(i.ravel(), j.ravel())
    s0, t0 = camera.lattice.centres(0, 0)
    d = np.stack([-(s - s0), t - t0], -1) * ((1 + camera.image_scale) / camera.sensor.pixel_pitch_mm)
    length = np.hypot(*d.T)
    return d[(length > 0) & (length < 1.5 * camera.image_pitch_px)]


def _fractions(camera: PlenopticCamera, i: NDArray, j: NDArray, centre: NDArray) -> NDArray[np.float64]:
    """Fractional pixels (lens, 2) of micro-images centred at ``centre`` (lens, 2), column and row.

    Of a regular lattice they are counted in whole 2**-32 px from lens (0, 0) on, which no rounding disturbs.
    """
    lattice, sensor = camera.lattice, camera.sensor
    if lattice.map is not None:
        return np.asarray(centre - np.rint(centre), np.float64)
    scale = (1 + camera.image_scale) / sensor.pixel_pitch_mm
    c, s = cos(lattice.rotation_rad) * lattice.pitch_mm * scale, sin(lattice.rotation_rad) * lattice.pitch_mm * scale
    first = sensor.pixel_from_plane(*(o * (1 + camera.image_scale) for o in lattice.offset_mm))
    steps = np.array([first, (-c / 2, s / 2), (s * lattice.row_spacing, c * lattice.row_spacing)])
    ticks = wrapped(np.rint(steps * 2.0**32).astype(np.int64))
    half_pitches = 2 * i + ((j & 1) if lattice.kind == "hexagonal" else 0)
    ticks_of_lens = wrapped(ticks[0] + half_pitches[:, None] * ticks[1] + j[:, None] * ticks[2])
    return np.asarray(ticks_of_lens * 2.0**-32, np.float64)


def wrapped(ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ticks of 2**-32 px without whole pixels: -2**31 <= ticks < 2**31."""
    return (ticks + 2**31) % 2**32 - 2**31


def layout(camera: PlenopticCamera, unusable: NDArray[np.bool_] | None = None) -> Layout:
    """Assign the raw pixels of ``camera`` (with its calibrated lattice) to views and lenses. ``unusable``: pixels of an
    upright image (rows, columns) that are no equations, as hot and masked ones.

    Raises PlenoPIVError for a mask of another size than the sensor, and where no pixel is left.
    """
    if unusable is not None:
        check_pixels(unusable, camera.sensor, "unusable")
    camera = camera.with_lattice(camera.lattice.aligned())
    sensor, lattice = camera.sensor, camera.lattice
    if abs(lattice.turn_rad) > LARGEST_TURN_RAD:
        warnings.warn(
            f"the rows of microlenses are turned by {degrees(lattice.turn_rad):.1f} degrees against the pixels: "
            "weights are wrong by a few percent; turn the microlens array",
            PlenoPIVWarning,
            stacklevel=2,
        )
    e, radius = camera.image_scale, camera.aperture_radius_px
    reach = int(np.ceil(min(radius, 0.5 * camera.image_pitch_px * 1.1)))
    corner_s, corner_t = sensor.plane_from_pixel(
        np.array([0, 0, sensor.columns - 1, sensor.columns - 1]), np.array([0, sensor.rows - 1, 0, sensor.rows - 1])
    )
    a, b = lattice.coordinates(corner_s / (1 + e), corner_t / (1 + e))
    b = b / lattice.row_spacing
    i0, i1, j0, j1 = (
        int(np.floor(a.min())) - 1,
        int(np.ceil(a.max())) + 1,
        int(np.floor(b.min())) - 1,
        int(np.ceil(b.max())) + 1,
    )
    j, i = (g.ravel() for g in np.mgrid[j0 : j1 + 1, i0 : i1 + 1])
    s, t = lattice.centres(i, j)
    centre = np.stack(sensor.pixel_from_plane(s * (1 + e), t * (1 + e)), -1)
    fraction = _fractions(camera, i, j, centre)
    pixel = np.rint(centre - fraction).astype(np.int32)
    phase = fraction.astype(np.float32)

    n, m = (g.ravel() for g in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    near = np.hypot(np.maximum(np.abs(m) - 0.5, 0), np.maximum(np.abs(n) - 0.5, 0))
    offsets = np.stack([m, n], -1)[near < radius].astype(np.int32)
    neighbours = _neighbour_offsets_px(camera)
    drift = 1.2 * camera.lattice.pitch_mm / camera.portion_mm  # px that the disc moves with a point under its lens
    fill = np.empty((len(offsets), len(pixel)), np.float32)
    seen = np.empty(fill.shape, bool)
    lost = None if unusable is None else np.zeros(fill.shape, bool)
    light = None if camera.rim is None else np.ones(fill.shape, np.float32)
    for v, (m, n) in enumerate(offsets):
        x, y = m - phase[:, 0], n - phase[:, 1]
        fill[v] = disc_share(x, y, radius)
        column, row = pixel[:, 0] + m, pixel[:, 1] + n
        seen[v] = (column >= 0) & (column < sensor.columns) & (row >= 0) & (row < sensor.rows) & (fill[v] >= LIT_SHARE)
        if light is not None:
            light[v] = rim_share(camera, x, y, s, t)
            seen[v] &= fill[v] * light[v] >= LIT_SHARE
        if np.hypot(m, n) > camera.image_pitch_px - radius - 1.5:
            # Half a pixel across, and a phase of as much: the others' light is 0.
            beside = neighbours[np.hypot(*(neighbours - (m, n)).T) < radius + drift + 2**0.5]
            foreign = sum(disc_share(x - dx, y - dy, radius + drift, 8) for dx, dy in beside)
            seen[v] &= foreign <= FOREIGN_SHARE
        if unusable is not None and lost is not None:
            here = np.flatnonzero(seen[v])
            lost[v, here] = unusable[row[here], column[here]]
            seen[v] &= ~lost[v]
    keep = seen.any(1)
    if not keep.any():
        raise PlenoPIVError(
            "camera: no pixel shows one microlens alone; are all lengths in mm?"
            if lost is None or not lost.any()
            else "unusable: no pixel that shows a microlens is left; leave out fewer"
        )
    block = i0, j0, i1 - i0 + 1, j1 - j0 + 1
    left = None if lost is None else lost[keep]
    lit = None if light is None else light[keep]
    if lit is not None and lit[seen[keep]].min(initial=1.0) > EVEN:
        lit = None
    return Layout(camera, *block, offsets[keep], pixel, phase, fill[keep], seen[keep], left, lit)


def decode(image: ArrayLike, where: Layout) -> LightField:
    """An upright raw image (rows, columns) in counts as a light field.

    Raises PlenoPIVError for an image of another size than the sensor, masked pixels, and a pixel that is an equation
    and no finite number.
    """
    sensor = where.camera.sensor
    if np.ma.is_masked(image):  # counts beneath a mask would be taken as measured
        raise PlenoPIVError(
            "frame: is a masked array and hides pixels; leave them out with Chain(unusable=mask), and give image.data"
        )
    image = np.asarray(image)  # xarray and lists are indexed in other ways
    check_pixels(image, sensor, "frame")
    values = np.zeros((where.views, where.lenses), np.float32)
    for v, (m, n) in enumerate(where.offsets):
        lens = np.flatnonzero(where.seen[v])
        values[v, lens] = image[where.pixel[lens, 1] + n, where.pixel[lens, 0] + m]
    values -= np.float32(sensor.black_level)
    values[~where.seen] = 0.0
    if (at := first_not_finite(values)) is not None:
        column, row = where.pixel[at[1]] + where.offsets[at[0]]
        raise PlenoPIVError(
            f"frame: the pixel at column {column}, row {row} is {image[row, column]}, and would empty the volume; "
            "leave it out with Chain(unusable=...), or put a count there"
        )
    return LightField(where, values)


def encode(values: NDArray, where: Layout) -> NDArray[np.float32]:
    """The inverse of ``decode`` without the black level: (view, lens) back to an upright image; other pixels are 0."""
    sensor = where.camera.sensor
    image = np.zeros((sensor.rows, sensor.columns), np.float32)
    for v, (m, n) in enumerate(where.offsets):
        lens = np.flatnonzero(where.seen[v])
        image[where.pixel[lens, 1] + n, where.pixel[lens, 0] + m] = values[v, lens]
    return image
