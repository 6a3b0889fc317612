"""A pinhole camera from images of a dot board at several depths.

1. The direct linear transformation (Abdel-Aziz & Karara 1971): the 3 x 4 matrix that maps points to pixels, from the
   smallest singular vector, with both normalised first (Hartley 1997), and the pinhole in it: its null vector is the
   position, its left 3 x 3 part an upper triangular matrix (focal length, principal point) times a rotation.
2. From there least squares of the reprojection error over position, rotation, focal length, principal point and the
   radial distortion k1, k2.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plenopiv.calibration.dot_board import find_dots
from plenopiv.cameras.pinhole import PinholeCamera, rotation_vector
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.sensor import Sensor

FEWEST_POINTS = 12
POOR_PX = 0.1  # RMS that is worth a warning; noisy boards have 0.02
REACH = 0.6  # of the corners' distance, of the outermost dot: at .5 the corners miss by .1 px, at .4 by more than one
WRONG_PX = 2.0  # RMS of what is no pinhole camera of these dots
REMEDY = "check the dots' pitch in mm, the z of each image in mm, and that the board moved along z alone"


@dataclass(frozen=True)
class PinholeFit:
    """A calibrated camera. ``residual_px`` (n, 2): measured less reprojected (column, row) of every dot; ``rms_px``:
    the root of their mean squared length."""

    camera: PinholeCamera
    residual_px: NDArray[np.float64]

    @property
    def rms_px(self) -> float:
        """RMS reprojection error in px."""
        return float(np.sqrt((self.residual_px**2).sum(1).mean()))


def calibrate_pinhole(
    images: Sequence[NDArray], z_mm: ArrayLike, sensor: Sensor, *, pitch_mm: float, name: str = "camera"
) -> PinholeFit:
    """A camera from upright ``images`` (rows, columns) of a board whose dots are ``pitch_mm`` apart (``dot_board``), in
    the planes ``z_mm``, one each. The board moves along z alone; its origin is x = y = 0.

    Raises PlenoPIVError, naming camera and plane, for images without a board, of another size than the sensor's, for
    fewer than two depths, and for a depth or a pitch that cannot be.
    """
    depths = np.asarray(z_mm, float).ravel()
    if not 0 < pitch_mm < np.inf:
        raise PlenoPIVError(f"{name}: pitch_mm = {pitch_mm:g} is no distance of dots; give a positive number of mm")
    if not np.isfinite(depths).all():
        said = ", ".join(f"{z:g}" for z in depths)
        raise PlenoPIVError(f"{name}: z_mm = {said} are not all depths of a board; give a number of mm for each image")
    if len(images) != depths.size:
        raise PlenoPIVError(f"{name}: {len(images)} board images for {depths.size} depths; give one z for each image")
    if np.unique(depths).size < 2:
        raise PlenoPIVError(f"{name}: the board was imaged at one depth; two or more tell where the camera stands")
    points, pixels = [], []
    for image, z in zip(images, depths, strict=True):
        plane = f"{name}, board at z = {z:g} mm"
        if np.shape(image) != (sensor.rows, sensor.columns):
            size = " x ".join(map(str, np.shape(image)[::-1]))
            raise PlenoPIVError(f"{plane}: {size} px, the sensor has {sensor.columns} x {sensor.rows}")
        dots = find_dots(image, plane)
        points.append(np.column_stack([pitch_mm * dots.number, np.full(len(dots.number), z)]))
        pixels.append(dots.pixel)
    return fit_pinhole(np.concatenate(points), np.concatenate(pixels), sensor, name)


def fit_pinhole(
    points_mm: NDArray[np.float64], pixels: NDArray[np.float64], sensor: Sensor, name: str = "camera"
) -> PinholeFit:
    """The camera that images ``points_mm`` (n, 3) nearest to ``pixels`` (n, 2) as (column, row), by least squares.

    Raises PlenoPIVError for fewer than 12 points, points in one plane, numbers that are not finite, depths of reversed
    sign, and where no such camera fits to 2 px. Warns (``PlenoPIVWarning``) where none fits to 0.1 px, and where
    dots leave most of the sensor out.
    """
    from scipy.optimize import least_squares

    if not (np.isfinite(points_mm).all() and np.isfinite(pixels).all()):
        raise PlenoPIVError(f"{name}: points_mm or pixels hold numbers that are not finite; leave these dots out")
    spread = np.linalg.svd(points_mm - points_mm.mean(0), compute_uv=False) if len(points_mm) else np.zeros(3)
    if len(points_mm) < FEWEST_POINTS or spread[-1] < 1e-6 * spread[0]:
        raise PlenoPIVError(
            f"{name}: {len(points_mm)} dots, or all in one plane, do not fix a camera; give {FEWEST_POINTS} or more at "
            "two or more depths"
        )
    start = linear_pinhole(points_mm, pixels, sensor, name)
    first = np.array([
        *start.position_mm, *start.rotation_rad, start.focal_length_px, *start.principal_point, *start.distortion
    ])  # fmt: skip

    def residual(parameters: NDArray) -> NDArray:
        # a trial camera that turns its back on a point sees it nowhere: far off, so that the step is taken back
        return np.nan_to_num(pixels - _camera(parameters, sensor).project(points_mm), nan=1e6).ravel()

    found = least_squares(residual, first, x_scale="jac", method="lm", xtol=1e-12, ftol=1e-12)
    fit = PinholeFit(_camera(found.x, sensor), found.fun.reshape(-1, 2))
    behind = int(np.isnan(fit.camera.project(points_mm)).any(1).sum())
    if behind:
        raise PlenoPIVError(
            f"{name}: {behind} dots are not in front of the fitted camera; {REMEDY}, and that z grows toward the camera"
        )
    if fit.rms_px > POOR_PX:
        said = f"{name}: dots miss the fitted camera by {fit.rms_px:.2g} px RMS; {REMEDY}"
        if fit.rms_px > WRONG_PX:
            raise PlenoPIVError(said)
        warnings.warn(said, PlenoPIVWarning, stacklevel=2)
    reach = _reach(fit.camera, pixels)
    if reach < REACH:
        warnings.warn(
            f"{name}: dots reach {100 * reach:.0f} % of the way to the sensor's corners, and distortion beyond them is "
            "not known: particles there may be missed by more than a pixel; use a board that fills the images",
            PlenoPIVWarning,
            stacklevel=2,
        )
    return fit


def _reach(camera: PinholeCamera, pixels: NDArray[np.float64]) -> float:
    """How far from the sensor's middle the outermost of ``pixels`` (n, 2) is, as a share of the corners' distance."""
    half = 0.5 * np.array([camera.sensor.columns, camera.sensor.rows])
    return float(np.hypot(*(pixels - half).T).max() / np.hypot(*half))


def _camera(parameters: NDArray, sensor: Sensor) -> PinholeCamera:
    """The camera of eleven numbers: position, rotation, focal length, principal point, distortion."""
    x, y, z, rx, ry, rz, focal, column0, row0, k1, k2 = (float(p) for p in parameters)
    return PinholeCamera((x, y, z), (rx, ry, rz), max(focal, 1e-3), sensor, (column0, row0), (k1, k2))


def linear_pinhole(
    points_mm: NDArray[np.float64], pixels: NDArray[np.float64], sensor: Sensor, name: str = "camera"
) -> PinholeCamera:
    """The camera without distortion by the direct linear transformation; ``points_mm`` (n, 3), ``pixels`` (n, 2).

    Raises PlenoPIVError where the points are seen as in a mirror: z does not grow toward the camera, or the images are
    mirrored.
    """
    to_points, points = _normalised(points_mm)
    # image plane with its second axis upward, as the camera's
    to_plane, plane = _normalised(pixels * (1.0, -1.0))
    rows = np.zeros((2 * len(points), 12))
    rows[0::2, 0:4] = rows[1::2, 4:8] = points
    rows[0::2, 8:12] = -plane[:, :1] * points
    rows[1::2, 8:12] = -plane[:, 1:2] * points
    matrix = np.linalg.inv(to_plane) @ np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 4) @ to_points
    matrix *= np.sign(np.mean(points_mm @ matrix[2, :3] + matrix[2, 3]))  # points are in front
    triangle, axes = _triangle_and_rotation(matrix[:, :3])
    triangle /= triangle[2, 2]
    position = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    axes = axes * np.array([[1.0], [1.0], [-1.0]])  # right, up, forward -> right, up, backward
    if np.linalg.det(axes) < 0:  # left-handed: no rotation makes them
        raise PlenoPIVError(
            f"{name}: the dots are seen as in a mirror; z grows toward the camera: turn the signs of z_mm, and check "
            "that the images are upright and not mirrored"
        )
    x, y, z = (float(p) for p in position)
    return PinholeCamera(
        (x, y, z),
        rotation_vector(axes.T),
        float(0.5 * (triangle[0, 0] + triangle[1, 1])),
        sensor,
        (float(triangle[0, 2]), float(-triangle[1, 2])),
    )


def _normalised(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The matrix that moves points (n, d) to mean 0 and RMS distance sqrt(d), and the moved points (n, d + 1)."""
    n, d = points.shape
    middle = points.mean(0)
    scale = np.sqrt(d / ((points - middle) ** 2).sum(1).mean())
    matrix = np.diag([*[scale] * d, 1.0])
    matrix[:d, d] = -scale * middle
    return matrix, np.column_stack([points, np.ones(n)]) @ matrix.T


def _triangle_and_rotation(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Upper triangular with a positive diagonal times orthogonal rows: right, up and forward of the camera."""
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ matrix).T)
    triangle, rotation = flip @ r.T @ flip, flip @ q.T
    sign = np.diag(np.sign(np.diag(triangle)))
    return triangle @ sign, sign @ rotation
