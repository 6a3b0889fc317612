"""What particles show of pinhole cameras that stand or look a little otherwise, and what they cannot show."""

import numpy as np
import pytest

from plenopiv.cameras.pinhole import looking_at
from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.tracking.camera_changes import (
    FEWEST,
    NUMBERS,
    apart_px,
    changed,
    pixels_by_number,
    roughly,
    self_calibrated,
    visible_changes,
)
from plenopiv.tracking.pinhole_light import PinholeLights
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, refine

SENSOR = Sensor(192, 160, 0.0055, 12, 0.0)
LIMITS = ((-1.2, 1.2), (-1.0, 1.0), (-0.8, 0.8))
DIAMETER_PX, DARK, LIGHT, DISTANCE_MM = 2.7, 3.0, 900.0, 300.0
CAMERAS = [
    looking_at((0, 0, 0), SENSOR, scale_mm_px=0.02, distance_mm=DISTANCE_MM, about_y_deg=y, about_x_deg=x)
    for y, x in ((-25.0, 0.0), (25.0, 0.0), (0.0, 25.0), (0.0, -25.0))
]


def points(count=200, seed=1):
    low, high = 0.95 * np.array(LIMITS).T
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def pixels(position, seed, cameras=CAMERAS):
    """Noisy pixels of particles of unequal light."""
    rng, each = np.random.default_rng(seed), []
    particles = Particles(position, LIGHT * rng.uniform(0.3, 1.7, len(position)))
    for camera in cameras:
        mean = pinhole_image(camera, particles, diameter_px=DIAMETER_PX) + 5.0
        each.append(Pixels.of_image(rng.poisson(mean) + rng.normal(0, DARK, mean.shape), 0.0, 1e9, DARK, 1.0))
    return Pixels.of_cameras(each)


def wrong(size_px, seed=0):
    """Cameras that are wrong in each number, so that images shift by about ``size_px``."""
    rng, at, out = np.random.default_rng(seed), points(), []
    for camera in CAMERAS:
        each_px = np.sqrt((pixels_by_number(camera, at) ** 2).sum(1).mean(0))
        out.append(changed(camera, size_px * rng.normal(size=NUMBERS) / each_px / np.sqrt(NUMBERS)))
    return out


def left_px(cameras):
    """By how much the true images of points differ from ``cameras``', each point displaced as it likes: least squares,
    point by point. Pixels, RMS over points and cameras."""
    squares = []
    for at in points():
        off = np.concatenate([one.project(at) - true.project(at) for one, true in zip(cameras, CAMERAS, strict=True)])
        moves = np.concatenate([camera.pixels_by_mm(at) for camera in CAMERAS])
        rest = off - moves @ np.linalg.lstsq(moves, off, rcond=None)[0]
        squares.append((rest**2).sum() / len(CAMERAS))
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (0, (0.0, 1.0)),  # looks up: a pixel's row, which runs downward, grows
        (1, (1.0, 0.0)),  # looks to the left: things are farther to the right
        (2, (0.0, 0.0)),
        (3, (-1.0, 0.0)),  # stands farther to the right
        (4, (0.0, 1.0)),
        (5, (0.0, 0.0)),
        (6, (0.0, 0.0)),
    ],
)
def test_the_middle_of_an_image_moves_as_the_camera_does(number, expected):
    for camera in CAMERAS:
        scale = camera.focal_length_px / (1.0 if number < 3 else DISTANCE_MM)
        found = pixels_by_number(camera, np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1]]))[0, :, number]
        np.testing.assert_allclose(found, scale * np.array(expected), atol=1e-4 * scale)


def test_away_from_the_middle_images_turn_and_grow():
    camera, at = CAMERAS[0], points(20)
    column, row = (camera.project(at) - camera.principal_point).T
    moved = pixels_by_number(camera, at)
    # the camera turned about its backward axis from its right to its up: images turn clockwise
    np.testing.assert_allclose(moved[:, :, 2], np.stack([-row, column], 1), atol=1e-3)
    np.testing.assert_allclose(moved[:, :, 6], np.stack([column, row], 1), atol=1e-3)


def test_changes_of_pixels_are_differences_of_light():
    position, light = points(12), np.linspace(400.0, 900.0, 12)
    of_points = PinholeLights(CAMERAS, DIAMETER_PX / 4)
    changes = visible_changes(of_points, points())
    seen = pixels(position, 2)
    fit = refine(of_points, seen, position, light, Prior(position, of_points.prior_std_mm), 0)
    lit, slopes = changes.slopes(of_points, fit, np.ones(seen.counts.size))
    for k in range(changes.count):
        step = 1e-3 * np.eye(changes.count)[k]
        plus, minus = (changes.lights(s * step)(position).image(light, seen.counts.size) for s in (1, -1))
        found = np.zeros(seen.counts.size)
        found[lit] = slopes[:, k]
        expected = (plus - minus) / 2e-3
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_combinations_shift_images_by_a_pixel_and_points_cannot_make_them():
    changes = visible_changes(PinholeLights(CAMERAS, 0.7), points())
    assert changes.count + changes.hidden == NUMBERS * len(CAMERAS)
    for k in range(changes.count):
        cameras = changes.cameras(0.1 * np.eye(changes.count)[k])
        off = [one.project(points()) - true.project(points()) for one, true in zip(cameras, CAMERAS, strict=True)]
        assert np.sqrt(np.mean(np.sum(np.square(off), -1))) == pytest.approx(0.1, rel=0.02)
        assert left_px(cameras) > 0.1 * 0.02**0.5


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("turned", [False, True])
def test_what_moves_all_cameras_together_is_not_fitted(axis, turned):
    """Displaced or turned about the volume's middle, all as one, they see the same particles elsewhere."""
    size = 1e-5
    together = []
    for camera in CAMERAS:
        own = camera.axes  # rows: right, up and backward
        direction = np.eye(3)[axis]
        if turned:
            moved = np.cross(direction, np.array(camera.position_mm))
            together.append(np.concatenate([own @ direction, own @ moved, [0.0]]))
        else:
            together.append(np.concatenate([np.zeros(3), own @ direction, [0.0]]))
    cameras = [changed(camera, size * numbers) for camera, numbers in zip(CAMERAS, together, strict=True)]
    off = [one.project(points()) - true.project(points()) for one, true in zip(cameras, CAMERAS, strict=True)]
    assert left_px(cameras) < 1e-3 * np.sqrt(np.mean(np.sum(np.square(off), -1)))
    changes = visible_changes(PinholeLights(CAMERAS, 0.7), points())
    # of no combination that is fitted is it a part: what it does to images is not among what these do
    shifts = np.stack([_shift(changes.cameras(1e-3 * each)) for each in np.eye(changes.count)], 1)
    basis = np.linalg.qr(_left(shifts))[0]
    assert np.linalg.norm(basis.T @ _left(_shift(cameras)[:, None])) < 1e-3 * np.linalg.norm(_shift(cameras))


def _shift(cameras):
    """Shifts of all images of points, one after the other."""
    at = points(60)
    off = [one.project(at) - true.project(at) for one, true in zip(cameras, CAMERAS, strict=True)]
    return np.concatenate(off, 1).ravel()


def _left(shifts):
    """Of each column, what points elsewhere do not make."""
    at = points(60)
    moves = np.concatenate([camera.pixels_by_mm(at) for camera in CAMERAS], 1)
    out = shifts.reshape(len(at), 2 * len(CAMERAS), -1).copy()
    for own, off in zip(moves, out, strict=True):
        off -= own @ np.linalg.lstsq(own, off, rcond=None)[0]
    return out.reshape(shifts.shape)


@pytest.mark.parametrize("size_px", [0.3, 2.0])
def test_cameras_that_are_wrong_are_found_with_the_particles(size_px):
    cameras = wrong(size_px)
    before = left_px(cameras)
    assert before > 0.5 * size_px
    of_points = PinholeLights(cameras, DIAMETER_PX / 4)
    found = self_calibrated(of_points, pixels(points(seed=3), 3), pixels(points(seed=4), 4), LIMITS)
    assert found.corrected
    assert left_px(found.cameras) < 3 * found.std_px < 0.03
    assert found.rms_px == pytest.approx(before, rel=0.05)
    assert found.chi2[1] == pytest.approx(1.0, abs=0.1)
    assert found.chi2[0] > 1.3 * found.chi2[1]
    assert (found.fitted, found.hidden) == (12, 16)


@pytest.mark.parametrize("seed", [2, 5])
def test_where_the_usual_number_of_spots_is_too_few_others_are_tried(seed):
    """Dense particles in small images: the brightest are not the same in all cameras."""
    sensor, turns, cameras, off = Sensor(200, 180, 0.0055, 12, 0.0), np.random.default_rng(seed), [], []
    limits, rng = ((-1.0, 1.4), (-1.1, 0.9), (-0.7, 0.9)), np.random.default_rng(3)
    place = [rng.uniform(*np.transpose(limits), (count, 3)) for count in (350, 450)][1]
    for y, x in ((-20.0, -15.0), (20.0, 20.0), (-20.0, 20.0), (20.0, -20.0)):
        stands = {"scale_mm_px": 0.0176, "distance_mm": 300.0, "about_y_deg": y, "about_x_deg": x}
        camera = looking_at((0.2, -0.1, 0.1), sensor, **stands)
        each_px = np.sqrt((pixels_by_number(camera, place) ** 2).sum(1).mean(0))
        turned = np.zeros(NUMBERS)
        turned[:2] = 2.0 * turns.normal(size=2) / each_px[:2] / np.sqrt(2)
        cameras.append(camera)
        off.append(changed(camera, turned))
    of_points = PinholeLights(off, DIAMETER_PX / 4)
    found = self_calibrated(of_points, pixels(place, 1, cameras), pixels(place + 0.05, 2, cameras), limits)
    assert apart_px(cameras, off, place) > 1.2
    assert found.corrected
    assert apart_px(cameras, found.cameras, place) < 0.01


def test_cameras_that_are_right_stay():
    found = self_calibrated(
        PinholeLights(CAMERAS, DIAMETER_PX / 4), pixels(points(seed=3), 3), pixels(points(seed=4), 4), LIMITS
    )
    assert not found.corrected
    assert list(found.cameras) == CAMERAS
    assert found.rms_px < 2 * found.std_px


def test_what_only_one_frame_shows_is_not_taken():
    """The cameras moved between the frames: neither is right for both."""
    frames = pixels(points(seed=3), 3, wrong(0.5, 1)), pixels(points(seed=4), 4, wrong(0.5, 2))
    of_points = PinholeLights(CAMERAS, DIAMETER_PX / 4)
    found = self_calibrated(of_points, *frames, LIMITS)
    assert found.apart_px > 0.1
    assert not found.corrected
    assert list(found.cameras) == CAMERAS


def test_lines_of_sight_that_miss_by_pixels_are_brought_together():
    cameras = wrong(2.0)
    nearer = roughly(PinholeLights(cameras, DIAMETER_PX / 4), pixels(points(seed=3), 3), LIMITS)
    assert left_px(cameras) > 1.2
    assert left_px(nearer.cameras) < 0.45  # and lines of sight of all particles meet within a pixel


def test_too_few_particles_are_told():
    few = points(20)
    of_points = PinholeLights(CAMERAS, DIAMETER_PX / 4)
    with pytest.raises(PlenoPIVError, match=f"particles are seen by all cameras, and {FEWEST} are needed"):
        self_calibrated(of_points, pixels(few, 3), pixels(few, 4), LIMITS)


def test_without_a_particle_cameras_are_left_as_they_are():
    of_points, dark = PinholeLights(CAMERAS, DIAMETER_PX / 4), pixels(points(20) + 50.0, 3)
    assert roughly(of_points, dark, LIMITS) is of_points
