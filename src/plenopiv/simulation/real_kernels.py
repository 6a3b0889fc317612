"""A ray's way through a real camera: fluid, window, stop, rim, lens, microlens, pixel. Double precision, lengths in mm.

The lens is thin: it changes a ray's slopes by -u/f. Refraction at the window is exact. The radial distortion moves
where a ray meets the microlens plane, the ray then coming straight from its place in the exit pupil. A point sends its
light evenly over the entrance pupil, and the microlenses fill the plane; reflection at surfaces is left out.
"""

from __future__ import annotations

from math import floor, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.kernels import plain_kernel, plain_part
from plenopiv.simulation.kernels import HEXAGONAL_ROW, nearest_lens

Pair = tuple[float, float]
NEWTON = 30  # steps at most; five do for slopes of 0.3
CLOSE, ROUGH = 1e-15, 1e-8
UNBENT = 5  # steps of the inverse of a distortion of some per cent


class Constants(NamedTuple):
    """A ``RealCamera`` as numbers. Lengths in mm."""

    focal: float
    image: float  # from lens to microlenses
    entrance: float  # entrance pupil in front of the lens
    radius: float  # of the entrance pupil
    rim: float
    bend: float  # distortion: s (1 + bend |s|^2)
    to_exit: float  # 1 / distance from exit pupil to microlenses
    lens_z: float
    refracts: bool
    n_fluid: float
    fluid: float
    n_window: float
    window: float
    nx: float
    ny: float
    nz: float
    gap: float  # behind the microlenses, on the axis: their focal length
    tilt_s: float  # share of the gap per mm
    tilt_t: float
    micro_radius: float  # of the stop's image under a microlens
    hexagonal: bool
    pitch: float
    stretch: float  # of the distance between rows
    turn_c: float
    turn_s: float
    offset_s: float
    offset_t: float
    array_bend: float  # by what share of their distance from the axis microlenses are further off it, per mm^2
    column0: float
    row0: float
    pixel: float


@plain_part
def slopes_to_pupil(cam: Constants, x: float, y: float, z: float, qx: float, qy: float) -> Pair:
    """Slopes dx/dz, dy/dz in air of the ray from a point to (qx, qy) in the entrance pupil.

    Faces of the window are parallel, so the ray stays in one plane with their normal. In it the lateral way is
    sum t_i tau / sqrt(n_i^2 + (n_i^2 - 1) tau^2) over fluid, window and air, tau the tangent in air against the normal:
    concave in tau, so Newton's steps from the paraxial tangent rise to the root.
    """
    qz = cam.lens_z - cam.entrance
    dx, dy, dz = qx - x, qy - y, qz - z
    if not cam.refracts:
        return dx / dz, dy / dz
    nx, ny, nz = cam.nx, cam.ny, cam.nz
    fluid = -(x * nx + y * ny + (z - cam.fluid) * nz)
    along = dx * nx + dy * ny + dz * nz
    air = along - fluid - cam.window
    lx, ly, lz = dx - along * nx, dy - along * ny, dz - along * nz
    lateral = sqrt(lx * lx + ly * ly + lz * lz)
    if lateral == 0.0:
        return nx / nz, ny / nz
    n2, g2 = cam.n_fluid**2, cam.n_window**2
    tau = lateral / (fluid / cam.n_fluid + cam.window / cam.n_window + air)
    for _ in range(NEWTON):
        a, b = n2 + (n2 - 1.0) * tau * tau, g2 + (g2 - 1.0) * tau * tau
        ra, rb = sqrt(a), sqrt(b)
        way = tau * (fluid / ra + cam.window / rb + air)
        step = (lateral - way) / (fluid * n2 / (a * ra) + cam.window * g2 / (b * rb) + air)
        tau += step
        if abs(step) <= CLOSE * tau:
            break
    share = tau / lateral
    vx, vy, vz = nx + share * lx, ny + share * ly, nz + share * lz
    return vx / vz, vy / vz


@plain_part
def onto_microlenses(cam: Constants, qx: float, qy: float, mx: float, my: float) -> tuple[float, float, float, float]:
    """Where a ray of slopes (mx, my) in air at (qx, qy) in the entrance pupil meets the microlens plane, (s, t), and
    its slopes there; NaN for a ray that the lens' rim stops."""
    u, v = qx + cam.entrance * mx, qy + cam.entrance * my
    if u * u + v * v > cam.rim * cam.rim:
        return np.nan, np.nan, np.nan, np.nan
    mx -= u / cam.focal
    my -= v / cam.focal
    s, t = u + cam.image * mx, v + cam.image * my
    off = cam.bend * (s * s + t * t)
    return s + off * s, t + off * t, mx + off * s * cam.to_exit, my + off * t * cam.to_exit


@plain_part
def lens_of(cam: Constants, s: float, t: float) -> Pair:
    """Centre (s, t) of the microlens whose cell holds a point."""
    a, b = lattice_place(cam, s, t)
    a, b = nearest_lens(a, b, cam.hexagonal)
    return lattice_point(cam, a, b)


@plain_part
def lattice_place(cam: Constants, s: float, t: float) -> Pair:
    """Lattice coordinates of (s, t), in pitches: the inverse of ``lattice_point``."""
    if cam.array_bend != 0.0:
        there_s, there_t = s, t
        for _ in range(UNBENT):
            grown = 1.0 + cam.array_bend * (s * s + t * t)
            s, t = there_s / grown, there_t / grown
    ds, dt = s - cam.offset_s, t - cam.offset_t
    along, across = cam.turn_c * ds + cam.turn_s * dt, cam.turn_c * dt - cam.turn_s * ds
    return along / cam.pitch, across / (cam.pitch * cam.stretch)


@plain_part
def lattice_point(cam: Constants, a: float, b: float) -> Pair:
    """(s, t) of lattice coordinates, in pitches."""
    a, b = a * cam.pitch, b * cam.pitch * cam.stretch
    s, t = cam.offset_s + cam.turn_c * a - cam.turn_s * b, cam.offset_t + cam.turn_s * a + cam.turn_c * b
    if cam.array_bend == 0.0:
        return s, t
    grown = 1.0 + cam.array_bend * (s * s + t * t)
    return s * grown, t * grown


@plain_part
def gap_behind(cam: Constants, s: float, t: float) -> float:
    """From the microlens at (s, t) to the sensor."""
    return cam.gap * (1.0 + cam.tilt_s * s + cam.tilt_t * t)


@plain_part
def onto_sensor(cam: Constants, s: float, t: float, ms: float, mt: float) -> Pair:
    """Where on the sensor, (s, t), the microlens sends a ray that meets it at (s, t) with slopes (ms, mt)."""
    lens_s, lens_t = lens_of(cam, s, t)
    gap = gap_behind(cam, lens_s, lens_t)
    return s + gap * (ms - (s - lens_s) / cam.gap), t + gap * (mt - (t - lens_t) / cam.gap)


@plain_part
def undistorted(cam: Constants, s: float, t: float) -> Pair:
    """Where a ray would have met the microlens plane that distortion brought to (s, t)."""
    if cam.bend == 0.0:
        return s, t
    far = cam.bend * (s * s + t * t)
    scale = 1.0 - far * (1.0 - 3.0 * far)  # the root of scale (1 + far scale^2) = 1, to the third order
    for _ in range(NEWTON):
        off = far * scale * scale
        step = (scale * (1.0 + off) - 1.0) / (1.0 + 3.0 * off)
        scale -= step
        if abs(step) <= ROUGH:  # the step squared is left
            break
    return s * scale, t * scale


@plain_part
def back_to_pupil(cam: Constants, s: float, t: float, ms: float, mt: float) -> tuple[float, float, float, float]:
    """Place in the entrance pupil and slopes in air of the ray that meets the microlens plane at (s, t) with slopes
    (ms, mt); NaN for one that stop or rim would have kept away."""
    s0, t0 = undistorted(cam, s, t)
    ms -= (s - s0) * cam.to_exit
    mt -= (t - t0) * cam.to_exit
    u, v = s0 - cam.image * ms, t0 - cam.image * mt
    ms += u / cam.focal
    mt += v / cam.focal
    qx, qy = u - cam.entrance * ms, v - cam.entrance * mt
    if qx * qx + qy * qy > cam.radius * cam.radius or u * u + v * v > cam.rim * cam.rim:
        return np.nan, np.nan, np.nan, np.nan
    return qx, qy, ms, mt


@plain_part
def back_into_fluid(
    cam: Constants, qx: float, qy: float, mx: float, my: float
) -> tuple[float, float, float, float, float, float]:
    """A point and the direction (per unit of z) in the fluid of a ray given by place and slopes in air."""
    x, y, z = qx, qy, cam.lens_z - cam.entrance
    if not cam.refracts:
        return x, y, z, mx, my, 1.0
    nx, ny, nz = cam.nx, cam.ny, cam.nz
    length = sqrt(mx * mx + my * my + 1.0)
    dx, dy, dz = mx / length, my / length, 1.0 / length
    cosine = dx * nx + dy * ny + dz * nz
    tx, ty, tz = dx - cosine * nx, dy - cosine * ny, dz - cosine * nz
    sine2 = tx * tx + ty * ty + tz * tz
    way = (x * nx + y * ny + (z - cam.fluid) * nz - cam.window) / cosine
    x, y, z = x - way * dx, y - way * dy, z - way * dz
    tangent = 1.0 / sqrt(cam.n_window**2 - sine2)  # of the angle in glass, over the sine in air
    x -= cam.window * (tx * tangent + nx)
    y -= cam.window * (ty * tangent + ny)
    z -= cam.window * (tz * tangent + nz)
    tangent = 1.0 / sqrt(cam.n_fluid**2 - sine2)
    dx, dy, dz = tx * tangent + nx, ty * tangent + ny, tz * tangent + nz
    return x, y, z, dx / dz, dy / dz, 1.0


@plain_kernel
def trace_rays(
    begin: int, end: int, cam: Constants, point: NDArray[np.float64], pupil: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Rays from ``point`` (n, 3) through ``pupil`` (n, 2): (s, t), slopes and place on the sensor into ``out`` (n, 6).
    NaN for rays that stop or rim keep away."""
    for k in range(begin, end):
        qx, qy = pupil[k, 0], pupil[k, 1]
        mx, my = slopes_to_pupil(cam, point[k, 0], point[k, 1], point[k, 2], qx, qy)
        s, t, ms, mt = onto_microlenses(cam, qx, qy, mx, my)
        if qx * qx + qy * qy > cam.radius * cam.radius * (1.0 + 1e-12):
            s = np.nan
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = s, t, ms, mt
        if np.isfinite(s):
            out[k, 4], out[k, 5] = onto_sensor(cam, s, t, ms, mt)
        else:
            out[k] = np.nan


@plain_kernel
def trace_back(
    begin: int, end: int, cam: Constants, st: NDArray[np.float64], pupil: NDArray[np.float64], out: NDArray[np.float64]
) -> None:  # fmt: skip
    """Rays that reach ``st`` (n, 2) through ``pupil`` (n, 2): a point in the fluid and the direction per unit of z into
    ``out`` (n, 6). NaN for rays that the rim keeps away."""
    bent = 1.0 + cam.entrance * (1.0 / cam.image - 1.0 / cam.focal)
    for k in range(begin, end):
        qx, qy = pupil[k, 0], pupil[k, 1]
        s, t = undistorted(cam, st[k, 0], st[k, 1])
        # s = u + image (m - u/focal), q = u - entrance m
        u = (qx + cam.entrance * s / cam.image) / bent
        v = (qy + cam.entrance * t / cam.image) / bent
        mx, my = (s - u) / cam.image + u / cam.focal, (t - v) / cam.image + v / cam.focal
        if u * u + v * v > cam.rim * cam.rim:
            out[k] = np.nan
        else:
            out[k] = back_into_fluid(cam, qx, qy, mx, my)


@plain_part
def pixel_of(cam: Constants, s: float, t: float) -> tuple[int, int]:
    """Column and row of the upright image that hold a point of the sensor."""
    return floor(cam.column0 - s / cam.pixel + 0.5), floor(cam.row0 + t / cam.pixel + 0.5)


@plain_part
def cell_offset(cam: Constants, a: float, b: float) -> Pair:
    """A place in a microlens' cell, (s, t) from its centre, evenly over the cell for (a, b) evenly over [0, 1)^2."""
    row = HEXAGONAL_ROW if cam.hexagonal else 1.0
    a, b = a + 0.5 * b if cam.hexagonal else a, b * row
    i, j = nearest_lens(a, b, cam.hexagonal)
    a, b = (a - i) * cam.pitch, (b - j) * cam.pitch * cam.stretch
    return cam.turn_c * a - cam.turn_s * b, cam.turn_s * a + cam.turn_c * b
