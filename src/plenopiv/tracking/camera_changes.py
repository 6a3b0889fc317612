"""By how much pinhole cameras stand and look otherwise than they were calibrated, from the particles of a frame.

Each camera may have been turned (about its own right, up and backward axes), moved along them, and its focal length may
have changed: seven numbers. What they do to images is a smooth shift, by place and by depth, as volume
self-calibration has it (Wieneke 2008, 2018), but of a camera that stays one: lines of sight stay lines, and what is
learnt where particles are holds for the whole volume.

Some changes no particle tells: those of all cameras that displace, turn or stretch everything that is seen. With each
point's displacement taken off, what is left of a change is its visible share; combinations with less than ``VISIBLE``
are not fitted, nor those that shift images by next to nothing (a lens farther away and longer).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.pinhole import PinholeCamera, rotation_matrix, rotation_vector
from plenopiv.errors import PlenoPIVError
from plenopiv.tracking.frame import check_pixels, particles_of_frame
from plenopiv.tracking.light import LightOfPoints
from plenopiv.tracking.pinhole_light import PinholeLights
from plenopiv.tracking.pinhole_search import LEAST, bright_spots, of_spots
from plenopiv.tracking.pixels import Pixels, with_noise
from plenopiv.tracking.refine import Fit
from plenopiv.tracking.with_calibration import HELPS, Seen, misfit, settle
from plenopiv.volume import Limits

NUMBERS = 7  # of a camera: turned about and moved along its right, up and backward, and its focal length, a share
VISIBLE = 0.02  # share, by squares, of a change that points elsewhere do not make
FELT = 1e-4  # share, by squares, of a shift that is more than rounding
EXPECTED_PX = 2.0  # of each combination: an a-priori standard deviation
SAMPLE = 400  # points by which changes are weighed
FEWEST = 100  # particles
SEARCHES, LITTLE_PX = 4, 0.02  # of particles at most, and until cameras change by less
ALIKE_PX, CERTAIN = 0.05, 5.0  # or so many standard deviations, by which the fits to two frames may differ
ROUGH_PX, BY_CHANCE = 4.0, 0.15  # by which lines of sight may miss at first; spots as near to any place by chance, ...
TIMES = 1.0, 2.0, 0.5, 4.0  # ... or so many times as many, where the brightest are not the same in all cameras
CLOSE_PX, ROUGH_STEPS = 0.5, 20  # beyond which what is left counts less; reweighted so often
STEP_PX = 0.05  # by which images are shifted for a derivative

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraChanges:
    """What particles can tell, as ``with_calibration.Calibration``: amounts are in pixels, root mean square over the
    cameras. ``of_points``: of the cameras as calibrated; ``visible`` (NUMBERS cameras, n): the combinations that are
    fitted; ``hidden``: how many are not."""

    of_points: PinholeLights
    visible: Array
    hidden: int

    @property
    def count(self) -> int:
        """How many combinations are fitted."""
        return self.visible.shape[1]

    @property
    def expected(self) -> float:
        """Of each combination, px: an a-priori standard deviation."""
        return EXPECTED_PX

    def cameras(self, amounts: Array) -> tuple[PinholeCamera, ...]:
        """The cameras, if they are wrong by ``amounts`` (n,)."""
        numbers = (self.visible @ amounts).reshape(-1, NUMBERS)
        return tuple(changed(camera, own) for camera, own in zip(self.of_points.cameras, numbers, strict=True))

    def lights(self, amounts: Array) -> PinholeLights:
        """The light of points in the cameras, if they are wrong by ``amounts``."""
        before = self.of_points
        return PinholeLights(self.cameras(amounts), before.image_px, before.centre_mm, before.brightness)

    def slopes(self, of_points: LightOfPoints, fit: Fit, weight: Array) -> tuple[NDArray[np.int64], Array]:
        """As ``Calibration.slopes``: light that is shifted in an image by ds is that of a particle whose image is."""
        assert isinstance(of_points, PinholeLights)
        lights, position, points = fit.lights, fit.position_mm, fit.lights.point
        camera = np.searchsorted(of_points.first, lights.pixel, side="right") - 1
        by_number = np.zeros((weight.size, NUMBERS))
        for number, each in enumerate(of_points.cameras):
            own = camera == number
            point = points[own]
            # the gradient by mm is that by pixel times the pixels by mm
            by_pixel = np.linalg.pinv(each.pixels_by_mm(position))[point]
            image = np.einsum("mi,mij->mj", lights.gradient[own], by_pixel) * fit.light[point][:, None]
            moved = pixels_by_number(each, position)[point]
            for k in range(NUMBERS):
                change = (image * moved[:, :, k]).sum(1)
                by_number[:, k] += np.bincount(lights.pixel[own], change, weight.size)
        lit = np.flatnonzero((weight > 0) & (by_number != 0).any(1))
        of_camera = np.searchsorted(of_points.first, lit, side="right") - 1
        combined = self.visible.reshape(-1, NUMBERS, self.count)
        return lit, np.einsum("pk,pkn->pn", by_number[lit], combined[of_camera])


@dataclass(frozen=True)
class CorrectedCameras:
    """What was found: ``cameras``, as given where particles ask for nothing (``corrected`` False). By how much images
    shift, root mean square over particles and cameras, its standard deviation, and by how much the other frame's own
    fit has them elsewhere (``apart_px``), px, after ``steps``; ``chi2`` per lit pixel of that other frame, before and
    after; how many combinations were ``fitted``, and how many no particle tells, ``hidden``."""

    cameras: tuple[PinholeCamera, ...]
    corrected: bool
    rms_px: float
    std_px: float
    apart_px: float
    steps: int
    chi2: tuple[float, float]
    fitted: int
    hidden: int


def self_calibrated(of_points: PinholeLights, first: Pixels, second: Pixels, limits_mm: Limits) -> CorrectedCameras:
    """Fit what the cameras of ``of_points`` are wrong by to the particles within ``limits_mm`` of a frame's pixels, and
    judge it by those of another: fitted to them alone it must be the same to ``ALIKE_PX``, and their chi^2 per lit
    pixel must fall by ``HELPS``, or nothing is changed.

    Raises:
        PlenoPIVError: fewer than ``FEWEST`` particles are seen.
    """
    found, other = (_fitted(of_points, pixels, limits_mm) for pixels in (first, second))
    chi2 = misfit(of_points, other.seen), misfit(found.of_points, other.seen)
    moved, apart = (
        apart_px(each.cameras, found.of_points.cameras, found.seen.position_mm) for each in (of_points, other.of_points)
    )
    helps = apart < max(ALIKE_PX, CERTAIN * found.std_px) and chi2[1] <= (1 - HELPS) * chi2[0]
    cameras = found.of_points.cameras if helps else of_points.cameras
    fitted = found.changes.count, found.changes.hidden
    return CorrectedCameras(cameras, helps, moved, found.std_px, apart, found.steps, chi2, *fitted)


class _Fitted(NamedTuple):
    """Cameras as a frame's particles have them, the particles, and the last changes."""

    of_points: PinholeLights
    seen: Seen
    changes: CameraChanges
    std_px: float
    steps: int


def _fitted(of_points: PinholeLights, pixels: Pixels, limits_mm: Limits) -> _Fitted:
    """Particles are searched anew as cameras that are less wrong show more of them."""
    now, seen = _begun(of_points, pixels, limits_mm)
    steps = 0
    for search in range(SEARCHES):
        if search:
            seen = _seen(now, pixels, limits_mm)
        changes = visible_changes(now, seen.position_mm)
        found, some = settle(changes, seen, now.prior_std_mm)
        now, steps = changes.lights(found.amounts), steps + some
        if found.rms < max(LITTLE_PX, found.std):
            break
    return _Fitted(now, seen, changes, found.std, steps)


def _begun(of_points: PinholeLights, pixels: Pixels, limits_mm: Limits) -> tuple[PinholeLights, Seen]:
    """Cameras that are roughly right, and the particles that they show, enough of them.

    Raises:
        PlenoPIVError: too few, however many spots are taken.
    """
    few: list[PlenoPIVError] = []
    for times in TIMES:
        now = roughly(of_points, pixels, limits_mm, times * BY_CHANCE)
        try:
            return now, _seen(now, pixels, limits_mm)
        except PlenoPIVError as error:
            few.append(error)
    raise few[0]


def roughly(of_points: PinholeLights, pixels: Pixels, limits_mm: Limits, by_chance: float = BY_CHANCE) -> PinholeLights:
    """The same with cameras changed so that lines of sight to the brightest spots cross, which by now may miss one
    another by ``ROUGH_PX``: spots so few that ``by_chance`` are near a place by chance. Least squares that count what
    is far less (Cauchy)."""
    spots = []
    excess = of_points.images(_above(of_points, pixels) / _dark(pixels))
    for image, spread, camera in zip(excess, of_points.image_px, of_points.cameras, strict=True):
        at, score = bright_spots(image, spread, LEAST)
        few = int(by_chance * camera.sensor.columns * camera.sensor.rows / (np.pi * ROUGH_PX**2))
        brightest = np.argsort(-score, kind="stable")[:few]
        spots.append((at[brightest], score[brightest]))
    place, _, which = of_spots(of_points.cameras, spots, limits_mm, ROUGH_PX)
    if len(place) == 0:
        return of_points
    changes = visible_changes(of_points, place)
    if len(place) < changes.count:
        return of_points
    seen = np.concatenate([at[which[:, k]] for k, (at, _) in enumerate(spots)], 1)
    off = seen - np.concatenate([camera.project(place) for camera in of_points.cameras], 1)
    slopes = left_by_points(of_points.cameras, place, _shifts(of_points.cameras, place)) @ changes.visible
    amounts = np.zeros(changes.count)
    for _ in range(ROUGH_STEPS):
        left = off - slopes @ amounts
        weight = 1.0 / (1.0 + (left**2).sum(1) / (len(spots) * CLOSE_PX**2))
        normal = np.einsum("n,nij,nik->jk", weight, slopes, slopes) + np.eye(changes.count) / EXPECTED_PX**2
        amounts = np.linalg.solve(normal, np.einsum("n,nij,ni->j", weight, slopes, off))
    return changes.lights(amounts)


def _above(of_points: PinholeLights, pixels: Pixels) -> Array:
    """Counts by which pixels are brighter than most of their camera's; NaN where they cannot be used."""
    above = [image.ravel() - np.median(image) for image in of_points.images(pixels.counts)]
    return np.where(pixels.usable, np.concatenate(above), np.nan)


def _dark(pixels: Pixels) -> Array:
    """Standard deviation of pixels without particles, counts."""
    return np.sqrt(pixels.variance(np.zeros(pixels.counts.size)))


def _seen(of_points: PinholeLights, pixels: Pixels, limits_mm: Limits) -> Seen:
    """The particles that cameras as they are now show."""
    check_pixels(of_points, pixels)
    above = _above(of_points, pixels)
    place, _ = of_points.places(above / _dark(pixels), limits_mm)
    each = float(np.nansum(above)) / len(of_points.cameras) / max(len(place), 1)
    light = np.full(len(place), max(each, 1.0))
    found = particles_of_frame(of_points, pixels, place, light, limits_mm)
    if len(found.light) < FEWEST:
        raise PlenoPIVError(
            f"self-calibration: {len(found.light)} particles are seen by all cameras, and {FEWEST} are needed: give "
            "frames with other seeding (fewer where they are dense) or more light, or cameras that are less wrong"
        )
    image = of_points(found.position_mm).image(found.light, pixels.counts.size)
    return Seen(with_noise(pixels, image), found.position_mm, found.light)


def apart_px(cameras: Sequence[PinholeCamera], others: Sequence[PinholeCamera], points_mm: Array) -> float:
    """By how much the images of points (n, 3) differ in two sets of cameras where points may be displaced as they like:
    px, root mean square over points and cameras."""
    a, b = (np.concatenate([camera.project(points_mm) for camera in each], 1) for each in (cameras, others))
    left = left_by_points(cameras, points_mm, (b - a)[:, :, None])
    return float(np.sqrt((left**2).sum((1, 2)).mean() / len(cameras)))


def left_by_points(cameras: Sequence[PinholeCamera], points_mm: Array, shifts: Array) -> Array:
    """What is left of ``shifts`` (n, 2 cameras, k) of the images of points (n, 3) where these are displaced as they
    like."""
    basis = np.linalg.qr(np.concatenate([camera.pixels_by_mm(points_mm) for camera in cameras], 1))[0]
    return shifts - basis @ (np.swapaxes(basis, 1, 2) @ shifts)


def _shifts(cameras: Sequence[PinholeCamera], points_mm: Array) -> Array:
    """Change (n, 2 cameras, NUMBERS cameras) of the images of points per unit of each number of each camera."""
    shifts = np.zeros((len(points_mm), 2 * len(cameras), NUMBERS * len(cameras)))
    for k, camera in enumerate(cameras):
        shifts[:, 2 * k : 2 * k + 2, NUMBERS * k : NUMBERS * (k + 1)] = pixels_by_number(camera, points_mm)
    return shifts


def visible_changes(of_points: PinholeLights, points_mm: Array) -> CameraChanges:
    """The changes of cameras that particles at ``points_mm`` (n, 3) can tell."""
    cameras, some = of_points.cameras, points_mm[:: max(1, len(points_mm) // SAMPLE)]
    shifts = _shifts(cameras, some)
    both = shifts, left_by_points(cameras, some, shifts)
    every, left = (np.einsum("pij,pik->jk", each, each) / (len(some) * len(cameras)) for each in both)
    unit = 1.0 / np.sqrt(np.diag(every))  # of each number, that which shifts images by a pixel
    felt, axes = np.linalg.eigh(unit[:, None] * every * unit)
    kept = felt > FELT
    whole = unit[:, None] * axes[:, kept] / np.sqrt(felt[kept])  # of these each shifts by a pixel
    share, combined = np.linalg.eigh(whole.T @ left @ whole)
    visible = whole @ combined[:, share > VISIBLE]
    return CameraChanges(of_points, visible, len(every) - visible.shape[1])


def changed(camera: PinholeCamera, numbers: Array) -> PinholeCamera:
    """The camera turned by ``numbers[:3]`` rad about its right, up and backward axes, moved by ``numbers[3:6]`` mm
    along them, its focal length longer by the share ``numbers[6]``."""
    before = rotation_matrix(camera.rotation_rad)
    x, y, z = camera.position_mm + before @ numbers[3:6]
    turned = rotation_vector(before @ rotation_matrix(numbers[:3]))
    longer = camera.focal_length_px * (1.0 + float(numbers[6]))
    return replace(camera, position_mm=(float(x), float(y), float(z)), rotation_rad=turned, focal_length_px=longer)


def pixels_by_number(camera: PinholeCamera, points_mm: Array) -> Array:
    """Change (n, 2, NUMBERS) of the images of points per unit of each number of ``changed``, by differences."""
    distance = float(np.linalg.norm(camera.in_camera(points_mm), axis=1).mean())
    off_axis = float(np.abs(camera.project(points_mm) - camera.principal_point).max())
    angle, share = STEP_PX / camera.focal_length_px, STEP_PX / off_axis
    small = np.array([angle, angle, share, angle * distance, angle * distance, share * distance, share])
    sides = ([changed(camera, sign * step).project(points_mm) for step in np.diag(small)] for sign in (1.0, -1.0))
    plus, minus = (np.stack(each, -1) for each in sides)
    return (plus - minus) / (2.0 * small)
