"""The light of many particles in the pixels of pinhole cameras, with its derivatives.

A particle's image is a Gaussian about where the camera images it, integrated over the pixels; its standard deviation is
a camera's, the same everywhere. Pixels of all cameras are numbered one camera after the other, the rows of each one
after the other. A particle's light is what it gives to all pixels of one camera; one that is brighter than the first by
a factor gets so much more (``brightness``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from plenopiv.cameras.pinhole import PinholeCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.light import Lights, check_number
from plenopiv.tracking.pinhole_search import LEAST, crossings
from plenopiv.tracking.pixels import Pixels
from plenopiv.volume import Limits, as_points

REACH = 4.0  # standard deviations of a particle's image; 6e-5 of the light lies beyond along each axis
TOGETHER = 4096  # particles whose light is computed at a time
PRIOR_PX = 3.0  # by which a particle may be off in each camera that pixels tell next to nothing of
CERTAIN = 6.0  # times what noise alone would have
FAR = 10  # px, beyond a particle's image
ALIKE = 1e5  # largest over least change of the pixels by a move: lines of sight differ by 2e-5 rad, and tell no depth
FAINTEST = 0.05  # brightness of a camera: of one that shows less nothing is learnt

Array = NDArray[np.float64]


def measured_image_px(image: NDArray) -> float:
    """Standard deviation in pixels of a particle's image, from an image (rows, columns) of many.

    Particles lie anywhere, so that the covariance of pixels d apart falls as exp(-d^2/(4 (s^2 + 1/12))), however many
    there are; 1/12 is a pixel's own. Compared are one and two pixels, along columns and rows, over the straight line
    through what is left FAR and twice as far apart: uneven seeding and light. Noise, which is each pixel's alone, is in
    none of them.

    Raises:
        PlenoPIVError: it is no image (rows, columns); covariances do not fall as those of particles.
    """
    if np.ndim(image) != 2:
        raise PlenoPIVError(f"tracking: an image has rows and columns, and this has the shape {np.shape(image)}")
    values = np.asarray(image, float) - np.mean(image)

    def apart(d: int) -> float:
        return float((values[:, d:] * values[:, :-d]).mean() + (values[d:] * values[:-d]).mean())

    far, rise = apart(FAR), (apart(FAR) - apart(2 * FAR)) / FAR
    one, two = (apart(d) - far - rise * (FAR - d) for d in (1, 2))
    by_chance = float(values.var()) * sqrt(2.0 / values.size)
    squared = 0.75 / np.log(one / two) - 1.0 / 12.0 if one > two > 0 and one > CERTAIN * by_chance else 0.0
    if squared <= 0:
        raise PlenoPIVError("tracking: the image does not show spots of a particle's kind; state image_px")
    return float(np.sqrt(squared))


class PinholeLights:
    """Makes the ``Lights`` of points for two or more pinhole cameras.

    ``image_px``: standard deviation of a particle's image in pixels, a quarter of its e^-2 diameter; of all cameras or
    of each. ``centre_mm``: in the middle of the volume, where the scale of the equations is taken. ``brightness``: of
    each camera, over the first one's; by default 1.

    Raises:
        PlenoPIVError: fewer than two cameras, or all of them in one direction from ``centre_mm``; numbers that are not
            as many as these; an image without extent.
    """

    def __init__(
        self,
        cameras: Sequence[PinholeCamera],
        image_px: ArrayLike,
        centre_mm: ArrayLike = (0.0, 0.0, 0.0),
        brightness: ArrayLike | None = None,
    ):
        self.cameras = tuple(cameras)
        count = len(self.cameras)
        if count < 2:
            raise PlenoPIVError(f"cameras: {count} given; lines of sight cross from two cameras on, give two or more")
        try:
            self.image_px = tuple(np.broadcast_to(np.asarray(image_px, float), count).tolist())
            self.brightness = tuple(
                np.broadcast_to(np.asarray(1.0 if brightness is None else brightness, float), count).tolist()
            )
        except ValueError:
            raise PlenoPIVError(
                f"tracking: image_px and brightness are one number, or one of each of the {count} cameras"
            ) from None
        for name, numbers in (("image_px", self.image_px), ("brightness", self.brightness)):
            if not all(0 < each < inf for each in numbers):
                said = ", ".join(f"{each:g}" for each in numbers)
                raise PlenoPIVError(f"tracking: {name} of the cameras is {said}; give positive numbers")
        self.pixels = [camera.sensor.columns * camera.sensor.rows for camera in self.cameras]
        self.first = np.concatenate([[0], np.cumsum(self.pixels)])  # number of each camera's first pixel
        self.centre_mm = np.asarray(centre_mm, float)
        moves = np.concatenate([camera.pixels_by_mm(self.centre_mm) for camera in self.cameras])
        if not np.isfinite(moves).all():
            raise PlenoPIVError("tracking: centre_mm is not in front of all cameras")
        if not np.linalg.cond(moves) < ALIKE:
            raise PlenoPIVError(
                "cameras: lines of sight of these cameras do not cross in centre_mm, for all look from one direction; "
                "give cameras that stand apart"
            )
        self.unit_mm = 1.0 / np.sqrt((moves**2).sum(0) / count)
        self._spread_mm = np.sqrt(np.diag(np.linalg.inv(moves.T @ moves)))  # of a particle, a pixel off in each camera

    @property
    def prior_std_mm(self) -> Array:
        """Standard deviations (3,) of a particle that is ``PRIOR_PX`` off in each camera."""
        return PRIOR_PX * self._spread_mm

    @property
    def frame_pixels(self) -> int:
        """How many pixels the images of all cameras have."""
        return int(self.first[-1])

    def __call__(self, position_mm: ArrayLike) -> Lights:
        """The light of points at ``position_mm`` (n, 3), x, y, z in mm; a point's shares sum to all cameras'
        ``brightness`` where all of its light falls on their sensors.

        Raises:
            PlenoPIVError: a point is not in front of a camera, or not a number.
        """
        position = as_points("tracking", position_mm)
        parts = [self._some(position[low : low + TOGETHER]) for low in range(0, len(position), TOGETHER)]
        counts, pixel, share, gradient = (np.concatenate(each) for each in zip(self._none(), *parts, strict=True))
        return Lights(np.concatenate([[0], np.cumsum(counts)]), pixel, share, gradient, self.unit_mm)

    def places(self, excess: Array, limits_mm: Limits) -> tuple[Array, Array]:
        """Places (n, 3) in mm within ``limits_mm`` where lines of sight to bright spots of all cameras cross, and
        their scores (n,), best first. ``excess`` (pixels,): as of ``LightOfPoints``."""
        return crossings(self.cameras, self.images(excess), self.image_px, limits_mm, LEAST)

    def images(self, values: Array) -> list[Array]:
        """Numbers of all pixels (pixels,) as an image (rows, columns) of each camera.

        Raises PlenoPIVError where they are not as many as the cameras'.
        """
        check_number(len(values), self.frame_pixels)
        return [
            values[lo:hi].reshape(camera.sensor.rows, camera.sensor.columns)
            for lo, hi, camera in zip(self.first, self.first[1:], self.cameras, strict=False)
        ]

    def balanced(self, pixels: Pixels, position_mm: ArrayLike, light: Array) -> PinholeLights:
        """The same with the cameras' ``brightness`` as ``pixels`` show it, if particles at ``position_mm`` (n, 3) had
        so much ``light`` (n,): what their image is to be multiplied with to fit best, over the first camera's."""
        lights = PinholeLights(self.cameras, self.image_px, self.centre_mm)(position_mm)
        expected = lights.image(light, len(pixels.counts))
        ratio = []
        for number, (lo, hi) in enumerate(zip(self.first, self.first[1:], strict=False), 1):
            own, counts = np.where(pixels.usable, expected, 0.0)[lo:hi], pixels.counts[lo:hi]
            dark = pixels.usable[lo:hi] & (own == 0)
            behind = float(np.median(counts[dark])) if dark.any() else 0.0
            ratio.append(float(own @ (counts - behind)) / max(float(own @ own), 1e-30))
            if not ratio[-1] > FAINTEST * ratio[0]:
                raise PlenoPIVError(f"camera {number}: its image does not show the particles of camera 1")
        return PinholeLights(self.cameras, self.image_px, self.centre_mm, [each / ratio[0] for each in ratio])

    def _none(self) -> tuple[NDArray, ...]:
        return np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.float32), np.empty((0, 3), np.float32)

    def _some(self, position: Array) -> tuple[NDArray, ...]:
        """Numbers of entries (n,) of points, their pixels, shares and gradients."""
        each = [self._of_camera(number, position) for number in range(len(self.cameras))]
        inside = np.concatenate([one[0] for one in each], 1)
        pixel, share, gradient = (np.concatenate([one[k] for one in each], 1)[inside] for k in (1, 2, 3))
        return inside.sum(1), pixel.astype(np.int32), share.astype(np.float32), gradient.astype(np.float32)

    def _of_camera(self, number: int, position: Array) -> tuple[NDArray, ...]:
        """Of all pixels (n, m) about the points' images: which are on the sensor, their numbers, shares and gradients
        (n, m, 3)."""
        camera, spread = self.cameras[number], self.image_px[number]
        place, moves = camera.project(position), camera.pixels_by_mm(position)
        if not np.isfinite(place).all():
            raise PlenoPIVError(f"tracking: a particle is not in front of camera {number + 1}")
        half = ceil(REACH * spread + 0.5)
        at = np.rint(place).astype(np.int64)[:, :, None] + np.arange(-half, half + 1)  # (n, 2, across)
        low, high = (at - place[:, :, None] - 0.5) / spread, (at - place[:, :, None] + 0.5) / spread
        one = 0.5 * (erf(high / sqrt(2.0)) - erf(low / sqrt(2.0)))
        slope = (np.exp(-0.5 * low**2) - np.exp(-0.5 * high**2)) / (sqrt(2.0 * pi) * spread)  # by column and row
        (across, down), (of_across, of_down) = np.moveaxis(one, 1, 0), np.moveaxis(slope, 1, 0)
        columns, rows = at[:, 0], at[:, 1]
        sensor, bright, n = camera.sensor, self.brightness[number], len(position)
        inside = ((rows >= 0) & (rows < sensor.rows))[:, :, None] & ((columns >= 0) & (columns < sensor.columns))[
            :, None
        ]
        pixel = self.first[number] + rows[:, :, None] * sensor.columns + columns[:, None]
        share = bright * down[:, :, None] * across[:, None]
        by_column, by_row = (
            bright * down[:, :, None] * of_across[:, None],
            bright * of_down[:, :, None] * across[:, None],
        )
        gradient = by_column[..., None] * moves[:, None, None, 0] + by_row[..., None] * moves[:, None, None, 1]
        return inside.reshape(n, -1), pixel.reshape(n, -1), share.reshape(n, -1), gradient.reshape(n, -1, 3)
