"""A pinhole camera: where it stands, how it is turned, what its lens does to straight lines.

In the camera's own frame (X, Y, Z), origin in the pinhole, X points to the right and Y up as the camera sees, Z back,
away from what it looks at. A point at the depth d = -Z in front of it is imaged (Tsai 1987; radial distortion after
Brown 1971) at

    (a, b) = (X, Y) / d,     r^2 = a^2 + b^2,     L = 1 + k1 r^2 + k2 r^4
    column = column0 + F L a,     row = row0 - F L b

with F the focal length in pixels: a millimetre at the depth d is F/d pixels wide. Images are upright (``sensor``). A
camera at rotation 0 on the +z axis has X, Y, Z along the object's x, y, z.

Light passes straight from the object to the camera: windows and the change of medium are not in this model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor
from plenopiv.volume import Limits

Vector = tuple[float, float, float]
UNDISTORT_STEPS = 8  # of Newton's method; four are enough for most lenses


def rotation_matrix(rotation_rad: ArrayLike) -> NDArray[np.float64]:
    """The (3, 3) rotation about the axis along ``rotation_rad`` (3,) by its length in rad, right-handed (Rodrigues)."""
    x, y, z = np.asarray(rotation_rad, float)
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-8:
        return np.eye(3) + cross
    return np.eye(3) + sin(angle) / angle * cross + (1.0 - cos(angle)) / angle**2 * cross @ cross


def rotation_vector(matrix: NDArray[np.float64]) -> Vector:
    """The inverse of ``rotation_matrix``, for angles below pi."""
    twice = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(twice), np.trace(matrix) - 1.0))
    x, y, z = (float(c) for c in twice * (0.5 if angle < 1e-8 else 0.5 * angle / sin(angle)))
    return x, y, z


@dataclass(frozen=True)
class PinholeCamera:
    """One camera of several around a volume.

    ``position_mm``: the pinhole in the object frame. ``rotation_rad``: the vector that turns the object's x, y, z into
    the camera's X, Y, Z (``rotation_matrix``). ``focal_length_px``: F, with square pixels. ``principal_point_px``:
    (column, row) that the pinhole looks at straight ahead; None, the middle of the sensor. ``distortion``: k1, k2.
    """

    position_mm: Vector
    rotation_rad: Vector
    focal_length_px: float
    sensor: Sensor
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.focal_length_px > 0:
            raise PlenoPIVError(f"camera: focal_length_px = {self.focal_length_px}, give a positive number of pixels")

    @property
    def principal_point(self) -> tuple[float, float]:
        """(column, row) that the pinhole looks at straight ahead."""
        return self.sensor.axis if self.principal_point_px is None else self.principal_point_px

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3), whose rows are the camera's right, up and backward in the object frame."""
        return rotation_matrix(self.rotation_rad).T

    def in_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Object points (..., 3) in mm in the camera's own frame (X, Y, Z)."""
        return (np.asarray(points_mm, float) - self.position_mm) @ self.axes.T

    def project(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Pixels (..., 2) as (column, row) of object points (..., 3) in mm; NaN for points not in front of it."""
        x, y, z = np.moveaxis(self.in_camera(points_mm), -1, 0)
        depth = np.where(z < 0, -z, np.nan)
        a, b = x / depth, y / depth
        k1, k2 = self.distortion
        squared = a * a + b * b
        stretch = self.focal_length_px * (1.0 + squared * (k1 + squared * k2))
        column0, row0 = self.principal_point
        return np.stack([column0 + stretch * a, row0 - stretch * b], -1)

    def pixels_by_mm(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Change (..., 2, 3) of the pixel, column and row, per mm of x, y, z at object points (..., 3)."""
        x, y, z = np.moveaxis(self.in_camera(points_mm), -1, 0)
        depth = np.where(z < 0, -z, np.nan)[..., None]
        right, up, back = self.axes
        a, b = x[..., None] / depth, y[..., None] / depth
        of_a, of_b = (right + a * back) / depth, (up + b * back) / depth
        k1, k2 = self.distortion
        squared = a * a + b * b
        stretch = 1.0 + squared * (k1 + squared * k2)
        of_stretch = 2.0 * (k1 + 2.0 * k2 * squared) * (a * of_a + b * of_b)
        column = self.focal_length_px * (stretch * of_a + a * of_stretch)
        row = -self.focal_length_px * (stretch * of_b + b * of_stretch)
        return np.stack([column, row], -2)

    def rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Unit vectors (..., 3) in the object frame from the pinhole along which pixels (..., 2), (column, row), look.

        The distortion is undone by Newton's method on r L(r^2).
        """
        column, row = np.moveaxis(np.asarray(pixels, float), -1, 0)
        column0, row0 = self.principal_point
        a, b = (column - column0) / self.focal_length_px, (row0 - row) / self.focal_length_px
        k1, k2 = self.distortion
        bent = np.hypot(a, b)
        r = bent.copy()
        for _ in range(UNDISTORT_STEPS if k1 or k2 else 0):
            s = r * r
            r -= (r * (1.0 + s * (k1 + s * k2)) - bent) / (1.0 + s * (3.0 * k1 + 5.0 * s * k2))
        straight = np.divide(r, bent, out=np.ones_like(r), where=bent > 0)
        along = np.stack([a * straight, b * straight, -np.ones_like(r)], -1) @ self.axes
        return along / np.linalg.norm(along, axis=-1, keepdims=True)

    def on_plane(self, pixels: ArrayLike, z_mm: float) -> NDArray[np.float64]:
        """Where pixels (..., 2) look through the plane z = ``z_mm``: object points (..., 3) in mm."""
        along, start = self.rays(pixels), np.asarray(self.position_mm, float)
        return start + along * ((z_mm - start[2]) / along[..., 2])[..., None]

    def pixels_per_mm(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """F/d at object points (..., 3), distortion left out; shape (...)."""
        return self.focal_length_px / -self.in_camera(points_mm)[..., 2]

    def sees(self, points_mm: ArrayLike) -> NDArray[np.bool_]:
        """Which object points (..., 3) fall on the sensor; shape (...)."""
        column, row = np.moveaxis(self.project(points_mm), -1, 0)
        return (abs(column - self.sensor.axis[0]) <= 0.5 * self.sensor.columns) & (
            abs(row - self.sensor.axis[1]) <= 0.5 * self.sensor.rows
        )


def looking_at(
    centre_mm: Sequence[float],
    sensor: Sensor,
    *,
    scale_mm_px: float,
    distance_mm: float,
    about_y_deg: float = 0.0,
    about_x_deg: float = 0.0,
) -> PinholeCamera:
    """A camera without distortion that looks at ``centre_mm`` (x, y, z), where a pixel is ``scale_mm_px`` wide.

    It is put on the +z side, ``distance_mm`` from the centre, then turned about the axis through the centre along x
    and after that about the one along y, right-handed: with a positive ``about_y_deg`` it stands to the right (x > 0),
    with a positive ``about_x_deg`` below (y < 0). Its rows stay level (parallel to the x-z plane).

    Raises PlenoPIVError for a scale or a distance that is not positive, for angles of 90 degrees or more, and for a
    centre that is not a place.
    """
    if np.shape(centre_mm) != (3,) or not np.isfinite(centre_mm).all():
        raise PlenoPIVError(f"camera: it looks at {centre_mm}, give x, y, z in mm")
    if not (0 < scale_mm_px < inf and 0 < distance_mm < inf):
        raise PlenoPIVError(f"camera: scale {scale_mm_px} mm/px at {distance_mm} mm, give positive numbers")
    if not (abs(about_y_deg) < 90.0 and abs(about_x_deg) < 90.0):
        raise PlenoPIVError(
            f"camera: turned by {about_y_deg} and {about_x_deg} degrees, it would see the volume from behind; "
            "give angles between -90 and 90"
        )
    turn = rotation_matrix((0.0, radians(about_y_deg), 0.0)) @ rotation_matrix((radians(about_x_deg), 0.0, 0.0))
    x, y, z = np.asarray(centre_mm, float) + distance_mm * turn[:, 2]
    return PinholeCamera((float(x), float(y), float(z)), rotation_vector(turn), distance_mm / scale_mm_px, sensor)


def share_seen(camera: PinholeCamera, limits_mm: Limits, samples: int = 21) -> float:
    """Share of a volume between ``limits_mm`` = ((x lo, hi), (y lo, hi), (z lo, hi)) that falls on the camera's sensor,
    0 to 1, from samples^3 points with its corners among them."""
    x, y, z = (np.linspace(lo, hi, samples) for lo, hi in limits_mm)
    return float(camera.sees(np.stack(np.meshgrid(x, y, z), -1)).mean())
