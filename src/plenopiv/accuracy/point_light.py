"""Where a point's light goes and how that changes as the point moves: exact boundaries, double precision, any lattice.

A point's rays fill the main lens' aperture evenly, u with |u| <= R. The microlens S = S(s), s = A u + B x, takes a ray
to the pixel at  S (1 + e) - e q,  where

    q = (1 - A) u - B x + S

is the portion of the main lens that the pixel sees. In q the pixels stand still, and light is spread evenly with a
density of 1/((1 - A)^2 pi R^2). Two boundaries move with the point, the edges of the microlenses' cells and the rim of
the aperture, both by

    cell edges, A u + B x fixed      dq/dx = -B/A     dq/dz = -(A' u + B' x)/A
    rim, u fixed                     dq/dx = -B       dq/dz = -(A' u + B' x)

(and the same for y), ' being d/dz. What a boundary sweeps is taken from the pixel in front of it and given to the one
behind; along z the density changes as well. That is Reynolds' transport theorem, so the derivative of a pixel's light
is a sum over pieces of boundary and needs no differences of areas. Edges take 24 nodes a pixel, which scatters single
derivatives by a few percent and their squared sum, the information, by less than one.
"""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.errors import PlenoPIVError

RAYS = 20_000  # that sample the aperture for the light of each pixel
RIM_NODES = 4_000
NODES_PER_PIXEL = 24  # along a cell's edge, for each pixel that it crosses
TINY = 1e-12  # stands for A in focus, where no edge is met
GOLDEN = (sqrt(5.0) - 1.0) / 2.0
# towards half of a cell's neighbours, so that each edge is met once; half an edge's length in pitches
NEIGHBOURS = {"square": (0.0, pi / 2), "hexagonal": (0.0, pi / 3, 2 * pi / 3)}
HALF_EDGE = {"square": 0.5, "hexagonal": 0.5 / sqrt(3.0)}

Array = NDArray[np.float64]


class PointLight(NamedTuple):
    """The pixels that a point lights.

    ``pixel`` int64 (m,), row * columns + column in an upright image; ``share`` (m,) of the point's light; ``gradient``
    (m, 3), change of the share per mm of x, y, z; ``one_lens``: all of the light goes through a single microlens, so
    that the split between microlenses carries no information on the position.
    """

    pixel: NDArray[np.int64]
    share: Array
    gradient: Array
    one_lens: bool


def point_light(camera: PlenopticCamera, position_mm: ArrayLike, rays: int = RAYS) -> PointLight:
    """Light of a point at (x, y, z) mm on the pixels of ``camera``.

    Shares are sampled by ``rays`` over the aperture; gradients are integrated along boundaries and do not depend on
    ``rays`` but for the change of density. Boundaries are sharp: no diffraction.

    Raises:
        PlenoPIVError: the point is not in front of the main lens.
    """
    x, y, z = (float(c) for c in np.asarray(position_mm, np.float64))
    if not z < camera.main_lens.object_distance_mm:
        raise PlenoPIVError(
            f"accuracy: z = {z:g} mm is not in front of the main lens, "
            f"keep z below {camera.main_lens.object_distance_mm:g} mm"
        )
    a, b, radius = float(camera.spread(z)), float(camera.scale(z)), 0.5 * camera.main_lens.aperture_mm
    image = b * np.array([x, y])  # where the ray through the main lens' centre meets the microlens plane
    whole = (1.0 - a) * pi * radius**2  # a length on the main lens times a speed of q, over this, is a share of light

    turns = 2.0 * pi * GOLDEN * np.arange(rays)
    u = _polar(radius * np.sqrt((np.arange(rays) + 0.5) / rays), turns)
    u_rim = _polar(radius, 2.0 * pi * (np.arange(RIM_NODES) + 0.5) / RIM_NODES)
    u_edge, length, normal, lens, neighbour = _cell_edges(camera, image, a)

    rim = _speed_along(camera, (x, y), z, u_rim, u_rim / radius) * (2.0 * pi * radius / RIM_NODES / whole)
    # an edge moves 1/A times as fast as the rim; where A < 0 the neighbour's side is that of smaller u
    edge = _speed_along(camera, (x, y), z, u_edge, normal) * (length / (max(abs(a), TINY) * whole))[:, None]

    pixels = np.concatenate(
        [
            _pixel(camera, u, image, a, _lens_at(camera, a * u + image)),
            _pixel(camera, u_rim, image, a, _lens_at(camera, a * u_rim + image)),
            _pixel(camera, u_edge, image, a, lens),
            _pixel(camera, u_edge, image, a, neighbour),
        ]
    )
    shares = np.zeros(len(pixels))
    shares[:rays] = 1.0 / rays
    swept = np.concatenate([np.zeros((rays, 3)), rim, edge, -edge])
    lit, where = np.unique(pixels, return_inverse=True)
    share: Array = np.bincount(where, shares).astype(np.float64)
    gradient: Array = np.stack([np.bincount(where, column) for column in swept.T], -1).astype(np.float64)
    gradient[:, 2] += 2.0 * _depth_rates(camera, z)[0] / (1.0 - a) * share
    # pixels that a boundary crosses but no ray reaches: without light they would carry too much information
    share = np.maximum(share, 0.5 / rays)
    on_sensor = lit >= 0
    return PointLight(lit[on_sensor], share[on_sensor], gradient[on_sensor], len(u_edge) == 0)


def _polar(radius: ArrayLike, angle: NDArray) -> Array:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)


def _depth_rates(camera: PlenopticCamera, z: float) -> tuple[float, float]:
    """A' and B' per mm: S_i/d^2 and -S_i/d^2."""
    d = camera.main_lens.object_distance_mm - z
    rate = camera.main_lens.image_distance_mm / d**2
    return rate, -rate


def _speed_along(camera: PlenopticCamera, point: tuple[float, float], z: float, u: Array, normal: Array) -> Array:
    """How fast the rim at u (n, 2) moves along ``normal`` (n, 2), in mm of q per mm of x, y and z: (n, 3)."""
    spread_rate, scale_rate = _depth_rates(camera, z)
    outward = -(spread_rate * u + scale_rate * np.array(point))
    return np.column_stack([-float(camera.scale(z)) * normal, (outward * normal).sum(1)])


def _lens_at(camera: PlenopticCamera, s: Array) -> Array:
    """Centres of the microlenses that hold points (n, 2) of the microlens plane."""
    return np.stack(camera.lattice.centres(*camera.lattice.nearest(s[:, 0], s[:, 1])), -1)


def _pixel(camera: PlenopticCamera, u: Array, image: Array, a: float, lens: Array) -> NDArray[np.int64]:
    """Flat pixel that rays through u reach under microlenses centred at ``lens`` (n, 2); -1 off the sensor."""
    e, sensor = camera.image_scale, camera.sensor
    q = (1.0 - a) * u - image + lens
    hit = lens * (1.0 + e) - e * q
    column, row = (np.rint(c).astype(np.int64) for c in sensor.pixel_from_plane(hit[:, 0], hit[:, 1]))
    on_sensor = (column >= 0) & (column < sensor.columns) & (row >= 0) & (row < sensor.rows)
    return np.where(on_sensor, row * sensor.columns + column, -1)


def _cell_edges(camera: PlenopticCamera, image: Array, a: float) -> tuple[Array, Array, Array, Array, Array]:
    """Pieces of the edges between microlenses, as the point sees them on the main lens, cut to the aperture.

    Returns their middles u (n, 2), lengths (n,), normals (n, 2) from a microlens to its neighbour on the microlens
    plane, and the centres of both, (n, 2) each. Lengths in mm.
    """
    lattice, radius = camera.lattice, 0.5 * camera.main_lens.aperture_mm
    reach = abs(a) * radius / lattice.pitch_mm + 1.0
    column, row = (float(c) for c in lattice.coordinates(*image))
    i = np.arange(floor(column - reach) - 1, ceil(column + reach) + 2)
    j = np.arange(floor((row - reach) / lattice.row_spacing), ceil((row + reach) / lattice.row_spacing) + 1)
    centre = np.stack(lattice.centres(*(g.ravel() for g in np.meshgrid(i, j))), -1)

    pieces = []
    for angle in NEIGHBOURS[lattice.kind]:
        turned = angle + lattice.rotation_rad
        normal, along = np.array([cos(turned), sin(turned)]), np.array([-sin(turned), cos(turned)])
        middle = (centre + 0.5 * lattice.pitch_mm * normal - image) / (a or TINY)
        half = HALF_EDGE[lattice.kind] * lattice.pitch_mm / max(abs(a), TINY)
        # the aperture's chord along the edge, from the foot of the perpendicular through its centre
        foot, apart = middle @ along, middle @ normal
        chord = np.sqrt(np.maximum(radius**2 - apart**2, 0.0))
        lo, hi = np.maximum(foot - half, -chord), np.minimum(foot + half, chord)
        met = np.flatnonzero(hi > lo)
        if not len(met):
            continue
        lo, hi, apart = lo[met], hi[met], apart[met]
        nodes = max(8, ceil(NODES_PER_PIXEL * (hi - lo).max() / camera.portion_mm))
        at = lo[:, None] + (hi - lo)[:, None] * ((np.arange(nodes) + 0.5) / nodes)
        u = at[..., None] * along + (apart[:, None] * np.ones(nodes))[..., None] * normal
        lens = np.repeat(centre[met], nodes, 0)
        length = np.repeat((hi - lo) / nodes, nodes)
        pieces.append(
            (u.reshape(-1, 2), length, np.tile(normal, (len(lens), 1)), lens, lens + lattice.pitch_mm * normal)
        )
    if not pieces:
        return np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2))
    u, length, normals, lens, neighbour = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return u, length, normals, lens, neighbour
