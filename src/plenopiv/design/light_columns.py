"""Light columns: the rays between a point and the portions of the main lens, and the microlenses that they meet.

Source: Shi, Ding & New (2016), section 2 and Fig. 3. A pixel sees one portion of the main lens; the rays of a point
through a portion are a light column, bounded by the rays through the portion's corners. Two points are distinguished
where "the location variation results in any light columns be captured by different microlens", so a point is coded by
the microlenses that its boundary rays meet, and points of one code are one unresolvable block.

The ray through u meets the microlens plane at s = A(z) u + B(z) x. It stays in the microlens S while n.(s - S) <= p/2
for the normals n of the sides of the microlens' cell. Times d = S_o - z > 0, with A d = |M| z and B d = -S_i, that is

    |M| z n.u - S_i n.x <= (n.S + p/2)(S_o - z),

linear in (x, y, z): boundaries are planes (the paper's lines), a block is an intersection of half-spaces, hence convex,
and the distance of a point to the nearest boundary is a quotient.

Two idealisations are the paper's. Portions are the same under every microlens, symmetric about the axis. And only
*which* pixels are lit counts: a column that two microlenses share sends each of them a part of its light, and those
parts change inside a block too. No column is split only in the blocks about the focal plane, whose points send all of
their light under one microlens.
"""

from __future__ import annotations

from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice

Array = NDArray[np.float64]

RIM = 1e-9  # of a portion: rounding at the rim of the aperture
SIDES = {"square": 4, "hexagonal": 6}


def portion_edges_mm(camera: PlenopticCamera) -> Array:
    """Boundaries u_k of the portions along an axis of the main lens, rising, (PMR + 1,) mm when f-numbers match.

    Portions are ``camera.portion_mm`` wide and symmetric about the axis; the outermost boundaries are the rim.
    """
    width, rim = camera.portion_mm, 0.5 * camera.main_lens.aperture_mm
    k = np.arange(-ceil(rim / width) - 1, ceil(rim / width) + 2)
    edges = (k + 0.5 * (round(camera.pixels_per_microlens) % 2)) * width
    return np.concatenate([[-rim], edges[np.abs(edges) < rim - RIM * width], [rim]])


def fan_mm(camera: PlenopticCamera, axis: str = "y") -> Array:
    """Points (u, v) in mm, (n, 2), on the main lens of the rays in the plane of ``axis`` and z: the paper's Fig. 3."""
    edges = portion_edges_mm(camera)
    pair = (np.zeros_like(edges), edges) if axis == "y" else (edges, np.zeros_like(edges))
    return np.stack(pair, 1)


def corners_mm(camera: PlenopticCamera) -> Array:
    """Corners (u, v) of all portions that lie in the round aperture, and the rim on both axes: (n, 2) mm."""
    edges = portion_edges_mm(camera)
    rim = edges[-1]
    u, v = (grid.ravel() for grid in np.meshgrid(edges, edges))
    inside = np.hypot(u, v) <= rim + RIM * camera.portion_mm
    on_axes = [(-rim, 0.0), (rim, 0.0), (0.0, -rim), (0.0, rim)]
    return np.unique(np.concatenate([np.stack([u, v], 1)[inside], on_axes]), axis=0)


def side_normals(lattice: Lattice) -> Array:
    """Unit normals (4 or 6, 2) of the sides of a microlens' cell; each side is half a pitch from the centre."""
    n = SIDES[lattice.kind]
    angle = lattice.rotation_rad + 2.0 * pi / n * np.arange(n)
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def codes(camera: PlenopticCamera, points_mm: ArrayLike, rays_mm: ArrayLike | None = None) -> NDArray[np.int64]:
    """Microlenses that a point's boundary rays meet: lens numbers (i, j), shape (n, rays, 2).

    ``points_mm`` (n, 3) hold x, y, z; ``rays_mm`` (rays, 2) are u, v on the main lens, by default ``fan_mm``. Points of
    equal code are in one block. The lattice is taken to go on beyond the sensor.

    Raises:
        PlenoPIVError: a point is not in front of the main lens, or is not finite.
    """
    points, rays = checked_points(camera, points_mm), _rays(camera, rays_mm)
    return np.stack([np.stack(lens_met(camera, points, ray), 1) for ray in rays], 1)


def free_shift_mm(
    camera: PlenopticCamera, points_mm: ArrayLike, direction: ArrayLike, rays_mm: ArrayLike | None = None
) -> Array:
    """How far each point can move along ``direction`` (3,) before its code changes: (n,) mm, inf where it never does.

    In closed form, see the module's text. Other arguments and errors as of ``codes``.
    """
    points, rays = checked_points(camera, points_mm), _rays(camera, rays_mm)
    e = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    shift = np.full(len(points), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for ray in rays:
            for gradient, limit in half_spaces(camera, points, ray):
                rate = gradient @ e
                distance = (limit - np.einsum("nc,nc->n", gradient, points)) / rate
                shift = np.minimum(shift, np.where(rate > 0, np.maximum(distance, 0.0), np.inf))
    return shift


def half_spaces(camera: PlenopticCamera, points_mm: Array, ray_mm: Array) -> list[tuple[Array, Array]]:
    """The half-spaces g.(x, y, z) <= c in which the ray through ``ray_mm`` (u, v) keeps the microlens of each point.

    A list over the sides of the cell of (g, c), (n, 3) and (n,), in mm and mm^2.
    """
    lens = camera.main_lens
    centre = np.stack(camera.lattice.centres(*lens_met(camera, points_mm, ray_mm)), 1)
    out = []
    for normal in side_normals(camera.lattice):
        reach = centre @ normal + 0.5 * camera.lattice.pitch_mm
        gradient = np.empty((len(points_mm), 3))
        gradient[:, :2] = -lens.image_distance_mm * normal
        gradient[:, 2] = -lens.magnification * (normal @ ray_mm) + reach
        out.append((gradient, reach * lens.object_distance_mm))
    return out


def boundary_lines(camera: PlenopticCamera, z_mm: tuple[float, float], y_mm: tuple[float, float]) -> Array:
    """Lines of Figs. 4 to 6: boundaries of light columns traced back from the microlenses' edges, (n, 2) mm.

    Each row is (v, t) of a line through v on the main lens and the edge t of a microlens; it is at
    y(z) = (t - A v)/B, a straight line. Those that enter the window ``z_mm`` x ``y_mm`` are returned.

    Raises:
        PlenoPIVError: the lattice is not square with rows along x: its edges are then no lines in this plane alone.
    """
    lattice = square_and_aligned(camera)
    ends = np.array(z_mm, np.float64)
    a, b = camera.spread(ends), camera.scale(ends)
    edges = portion_edges_mm(camera)
    t = (a * edges[:, None])[..., None] + b[:, None] * np.array(y_mm)  # (line, z, y): where the window's corners go
    lowest, highest = t.min((1, 2)), t.max((1, 2))
    number = np.arange(
        np.floor((lowest.min() - lattice.offset_mm[1]) / lattice.pitch_mm) - 1,
        np.ceil((highest.max() - lattice.offset_mm[1]) / lattice.pitch_mm) + 1,
    )
    edge = lattice.offset_mm[1] + (number + 0.5) * lattice.pitch_mm
    v, t_edge = np.meshgrid(edges, edge, indexing="ij")
    met = (t_edge >= lowest[:, None]) & (t_edge <= highest[:, None])
    return np.stack([v[met], t_edge[met]], 1)


def square_and_aligned(camera: PlenopticCamera) -> Lattice:
    """The camera's lattice, if its cells are squares with sides along s and t; else PlenoPIVError."""
    lattice = camera.lattice
    if lattice.kind != "square" or abs(lattice.turn_rad) > 1e-12:
        raise PlenoPIVError(
            f"design: light columns are lines in a plane for a square lattice with rows along x or y, this one is "
            f"{lattice.kind}, turned by {lattice.turn_rad:.4g} rad; use codes or free_shift_mm with corners_mm"
        )
    return lattice


def lens_met(camera: PlenopticCamera, points: Array, ray: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers (i, j), each (n,), of the microlenses that the rays from ``points`` (n, 3) through (u, v) meet; in mm."""
    a, b = camera.spread(points[:, 2]), camera.scale(points[:, 2])
    return camera.lattice.nearest(a * ray[0] + b * points[:, 0], a * ray[1] + b * points[:, 1])


def _rays(camera: PlenopticCamera, rays_mm: ArrayLike | None) -> Array:
    return fan_mm(camera) if rays_mm is None else np.atleast_2d(np.asarray(rays_mm, np.float64))


def checked_points(camera: PlenopticCamera, points_mm: ArrayLike) -> Array:
    """Points as float64 (n, 3) in mm; PlenoPIVError where light cannot come from."""
    points = np.atleast_2d(np.asarray(points_mm, np.float64))
    if points.ndim != 2 or points.shape[1] != 3:
        raise PlenoPIVError(f"design: points have shape {points.shape}, give (n, 3): x, y, z in mm")
    farthest = camera.main_lens.object_distance_mm
    if not (np.isfinite(points).all() and (points[:, 2] < farthest).all()):
        raise PlenoPIVError(
            f"design: points must be finite and in front of the main lens, keep z below {farthest:g} mm"
        )
    return points
