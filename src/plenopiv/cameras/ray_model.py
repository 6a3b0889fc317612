"""Rays from the laboratory to the microlenses: through fluid, window and air, and a thin lens with distortion.

A plane window keeps the part of a ray's direction along it: n sin(theta) = p is the same in fluid, glass and air. So
from depth w in the fluid to a height g above the window the lateral way is

    p (w / sqrt(n_w^2 - p^2) + t / sqrt(n_g^2 - p^2) + g / sqrt(1 - p^2)),

which is solved for p by Newton's method: Snell's law, spherical aberration included. Behind the lens the ray meets the
microlens plane at s = h + S_i m' with m' = m - h/f, distorted radially, and a microlens there turns its direction into
a place under itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.cameras.medium import Medium

OFFSET_POWERS = (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)
NEWTON = 5  # iterations; from the paraxial start each squares the error
STEEPEST = 0.95  # sine in air of a trial ray


@dataclass(frozen=True)
class RayModel:
    """A camera in its laboratory. Lengths in mm, angles in rad.

    ``gap_mm``: air from the window's outer face to the main lens along the axis. ``medium.fluid_mm``: from the
    laboratory's origin to the window's inner face. ``turn_rad`` (3,): the laboratory's axes in the camera's frame,
    turned about x, then y, then z; ``shift_mm`` (2,): x and y of its origin there. ``distortion``: share by which an
    image at ``corner_mm`` from the axis lies farther out. ``gap_tilt`` (2,): by what share the microlenses' distance to
    the sensor grows over ``corner_mm`` along s and t. ``reference_mm``: distance from the microlenses to the plane, in
    the image space, whose middle is seen by the middles of all micro-images. ``view_scale``: the places u of the views
    over those on that plane. ``view_offset_mm``: by which they are counted beside them, as where the middles of
    micro-images were found a little aside: (du, dv) of ``OFFSET_POWERS`` of (s, t) in units of ``corner_mm``; () for
    none. ``origin_mm`` (3,), ``laboratory_turn_rad``: where the laboratory's origin was put in the frame that the
    numbers above are of, and by how much its axes are turned about z there.
    """

    focal_length_mm: float
    image_distance_mm: float
    gap_mm: float
    medium: Medium
    reference_mm: float
    corner_mm: float
    turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_mm: tuple[float, float] = (0.0, 0.0)
    distortion: float = 0.0
    gap_tilt: tuple[float, float] = (0.0, 0.0)
    view_scale: float = 1.0
    view_offset_mm: tuple[tuple[float, float], ...] = ()
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    laboratory_turn_rad: float = 0.0

    @property
    def magnification(self) -> float:
        """M of the plane in focus, 1 - S_i/f."""
        return 1 - self.image_distance_mm / self.focal_length_mm

    def camera_frame(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 3) of the laboratory along the camera's axes; z from where ``medium.fluid_mm`` begins."""
        points = np.asarray(points_mm, float) @ rotation(0.0, 0.0, self.laboratory_turn_rad).T + self.origin_mm
        return points @ rotation(*self.turn_rad).T + np.array([*self.shift_mm, 0.0])

    def trace(self, points_mm: ArrayLike, lens_mm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rays from ``points_mm`` (n, 3) in the laboratory through places ``lens_mm`` (m, 2) of the main lens.

        Returns where they meet the microlens plane, s, and the place u at which a view counts them, both (n, m, 2).
        """
        points, h = self.camera_frame(points_mm), np.asarray(lens_mm, float)
        slope = self._slopes_at_lens(points, h) - h / self.focal_length_mm
        s = h + self.image_distance_mm * slope
        radius = (s**2).sum(-1, keepdims=True) / self.corner_mm**2
        s = s * (1 + self.distortion * radius)
        unit = s / self.corner_mm
        u = (s - self.reference_mm * slope) * (self.view_scale * (1 + unit @ np.array(self.gap_tilt)[:, None]))
        for (p, q), offset in zip(OFFSET_POWERS, self.view_offset_mm, strict=False):
            u += (unit[..., 0] ** p * unit[..., 1] ** q)[..., None] * np.array(offset)
        return s, u

    def _slopes_at_lens(self, points: NDArray[np.float64], h: NDArray[np.float64]) -> NDArray[np.float64]:
        """dx/dz and dy/dz toward the camera in the air before the lens, (n, m, 2); NaN where no light goes that way,
        which a fit may try."""
        medium = self.medium
        about_x, about_y = np.radians(medium.window_tilt_deg)
        turn = rotation(about_x, about_y, 0.0)  # the window's axes in the camera's frame
        inner = np.array([0.0, 0.0, medium.fluid_mm])
        below = (points - inner) @ turn
        lens_z = medium.window_along_axis_mm + self.gap_mm
        above = np.column_stack([h, np.full(len(h), lens_z)]) @ turn
        way = above[None, :, :2] - below[:, None, :2]
        along = np.hypot(way[..., 0], way[..., 1])
        depth, height = -below[:, 2, None], (above[:, 2] - medium.window_mm)[None]
        n_w, n_g, t = medium.refractive_index, medium.window_refractive_index, medium.window_mm
        p = along / (depth / n_w + t / n_g + height)
        with np.errstate(invalid="ignore"):
            for _ in range(NEWTON):
                p = np.minimum(p, STEEPEST)
                a, b, c = n_w**2 - p**2, n_g**2 - p**2, 1 - p**2
                miss = p * (depth / np.sqrt(a) + t / np.sqrt(b) + height / np.sqrt(c)) - along
                p = p - miss / (depth * n_w**2 / a**1.5 + t * n_g**2 / b**1.5 + height / c**1.5)
            lateral = way * (p / np.maximum(along, 1e-300))[..., None]
            direction = np.concatenate([lateral, np.sqrt(1 - p**2)[..., None]], -1) @ turn.T
        return direction[..., :2] / direction[..., 2:]


def rotation(about_x: float, about_y: float, about_z: float) -> NDArray[np.float64]:
    """The matrix (3, 3) that turns a vector about x, then y, then z, right-handed, by angles in rad."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([about_x, about_y, about_z]), np.sin([about_x, about_y, about_z])
    x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return z @ y @ x


def on_disc(radius_mm: float, count: int) -> NDArray[np.float64]:
    """``count`` places (count, 2) spread evenly over a disc, on Vogel's spiral (Vogel 1979, Math. Biosci. 44, 179)."""
    k = np.arange(count)
    r, angle = radius_mm * np.sqrt((k + 0.5) / count), k * np.pi * (3 - np.sqrt(5))
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])
