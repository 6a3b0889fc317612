"""Particles of pinhole cameras: their light and its derivatives, lines of sight that cross, a whole frame."""

import numpy as np
import pytest

from plenopiv.cameras.pinhole import PinholeCamera, looking_at
from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.pinhole_light import PinholeLights, measured_image_px
from plenopiv.tracking.pinhole_search import bright_spots, crossings, triangulated
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, refine

SENSOR = Sensor(192, 160, 0.0055, 12, 0.0)
SCALE_MM, DIAMETER_PX = 0.02, 2.7
LIMITS = ((-1.2, 1.2), (-1.0, 1.0), (-0.8, 0.8))
ANGLES = ((-25.0, 0.0), (25.0, 0.0), (0.0, 25.0), (0.0, -25.0))
CAMERAS = [
    looking_at((0, 0, 0), SENSOR, scale_mm_px=SCALE_MM, distance_mm=300.0, about_y_deg=y, about_x_deg=x)
    for y, x in ANGLES
]
BENT = [
    PinholeCamera(c.position_mm, c.rotation_rad, c.focal_length_px, SENSOR, (93.0, 82.0), (0.4, -2.0)) for c in CAMERAS
]
LIGHT, DARK = 900.0, 3.0


def points(count, seed=1, inside=0.95):
    low, high = inside * np.array(LIMITS).T
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def images(position, light, cameras=CAMERAS, diameter=DIAMETER_PX):
    particles = Particles(position, light)
    return [pinhole_image(camera, particles, diameter_px=diameter) for camera in cameras]


def pixels_of(means, seed=None, stray=5.0):
    rng, each = np.random.default_rng(seed), []
    for mean in means:
        noisy = mean + stray if seed is None else rng.poisson(mean + stray) + rng.normal(0, DARK, mean.shape)
        each.append(Pixels.of_image(noisy, 0.0, 1e9, DARK, 1.0))
    return Pixels.of_cameras(each)


@pytest.mark.parametrize("cameras", [CAMERAS, BENT])
def test_light_falls_where_an_image_of_particles_has_it(cameras):
    position, light = points(30), np.linspace(500, 900, 30)
    lights = PinholeLights(cameras, DIAMETER_PX / 4)(position)
    expected = np.concatenate([one.ravel() for one in images(position, light, cameras)])
    assert np.abs(lights.image(light, expected.size) - expected).max() < 1e-4 * light.max()
    assert lights.whole() == pytest.approx(len(cameras), abs=2e-3)


@pytest.mark.parametrize("axis", range(3))
def test_gradients_are_differences_of_light(axis):
    of_points, place, step = PinholeLights(BENT, 0.7), np.array([[0.31, -0.22, 0.4]]), 1e-5
    size = len(BENT) * SENSOR.rows * SENSOR.columns
    either = [place + sign * step * np.eye(3)[axis] for sign in (-1, 1)]
    low, high = (of_points(at).image(np.ones(1), size) for at in either)
    here = of_points(place)
    found = np.bincount(here.pixel, here.gradient[:, axis], size)
    assert found == pytest.approx((high - low) / (2 * step), abs=2e-3 * np.abs(found).max())


def test_signs_of_a_camera_in_front():
    camera = looking_at((0, 0, 0), SENSOR, scale_mm_px=SCALE_MM, distance_mm=300.0)
    moves = camera.pixels_by_mm(np.array([0.5, 0.4, 0.0]))
    assert (moves[0, 0], moves[1, 1]) == pytest.approx((1 / SCALE_MM, -1 / SCALE_MM))
    assert moves[0, 2] > 0 > moves[1, 2]  # nearer to the camera is larger
    assert np.isnan(camera.pixels_by_mm(np.array([0.0, 0.0, 400.0]))).all()


@pytest.mark.parametrize("camera", BENT)
def test_change_of_pixels_is_that_of_projection(camera):
    at, step = points(20), 1e-4
    for axis in range(3):
        moved = camera.project(at + step * np.eye(3)[axis]) - camera.project(at - step * np.eye(3)[axis])
        assert camera.pixels_by_mm(at)[..., axis] == pytest.approx(moved / (2 * step), rel=1e-6, abs=1e-5)


def test_a_particle_alone_is_found_to_a_thousandth_of_a_pixel():
    true = points(1, seed=4)
    of_points, pixels = PinholeLights(CAMERAS, DIAMETER_PX / 4), pixels_of(images(true, LIGHT), stray=0.0)
    start = true + SCALE_MM * np.array([[0.5, -0.4, 0.8]])
    fit = refine(of_points, pixels, start, np.array([0.7 * LIGHT]), Prior(start, 1e3 * of_points.prior_std_mm), 12)
    assert np.abs(fit.position_mm - true).max() < 1e-3 * SCALE_MM
    assert fit.light == pytest.approx(LIGHT, rel=1e-3)


def test_scale_of_the_equations_is_the_images():
    """A volume of a metre is fitted as one of a millimetre."""
    large = [
        looking_at((0, 0, 0), SENSOR, scale_mm_px=2.0, distance_mm=30000.0, about_y_deg=y, about_x_deg=x)
        for y, x in ANGLES
    ]
    true = 100 * points(1, seed=4)
    of_points, pixels = PinholeLights(large, DIAMETER_PX / 4), pixels_of(images(true, LIGHT, large), stray=0.0)
    start = true + 2.0 * np.array([[0.5, -0.4, 0.8]])
    fit = refine(of_points, pixels, start, np.array([0.7 * LIGHT]), Prior(start, 1e3 * of_points.prior_std_mm), 12)
    assert np.abs(fit.position_mm - true).max() < 2e-3


@pytest.mark.parametrize("spread", [0.55, 0.7, 1.1])
def test_size_of_a_particles_image_is_measured(spread):
    rng = np.random.default_rng(2)
    mean = images(points(2000, inside=1.3), LIGHT, CAMERAS[:1], 4 * spread)[0]
    assert measured_image_px(rng.poisson(mean + 10.0)) == pytest.approx(spread, rel=0.05)


def test_an_image_without_particles_has_no_size():
    with pytest.raises(PlenoPIVError, match="image_px"):
        measured_image_px(np.random.default_rng(3).normal(100, 3, (200, 200)))
    with pytest.raises(PlenoPIVError, match="rows and columns"):
        measured_image_px(np.ones(200))


def test_spots_lie_where_particles_are_imaged():
    true = np.array([[0.3, 0.2, 0.1], [-0.5, 0.4, -0.3]])
    image = images(true, LIGHT, CAMERAS[:1])[0]
    at, score = bright_spots(image / DARK, DIAMETER_PX / 4, 4.0)
    expected = CAMERAS[0].project(true)
    assert len(at) == 2
    assert np.abs(at[np.argsort(at[:, 0])] - expected[np.argsort(expected[:, 0])]).max() < 0.15
    assert (score > 15).all()


def test_noise_has_standard_deviation_one_in_spots():
    at, score = bright_spots(np.random.default_rng(5).normal(0, 1, (300, 300)), 0.7, 3.0)
    assert len(at) < 90000 * 0.0013  # of one-sided normal noise, .13 % lies above three
    assert score.max() < 6


def test_lines_of_sight_cross_at_particles():
    true = points(12, seed=7)
    excess = [image / DARK for image in images(true, LIGHT)]
    place, score = crossings(CAMERAS, excess, [DIAMETER_PX / 4] * 4, LIMITS)
    off = np.linalg.norm(place[:, None] - true, axis=2)
    assert (off.min(0) < SCALE_MM).all()
    assert (off.min(1) < 3 * SCALE_MM).all()
    assert (np.diff(score) <= 0).all()


def test_places_are_where_images_say():
    true = points(10, seed=8)
    seen = [camera.project(true) for camera in CAMERAS]
    place, off = triangulated(CAMERAS, seen, true + 0.05)
    assert np.abs(place - true).max() < 1e-6
    assert off.max() < 1e-4


def test_no_light_is_no_place():
    place, score = crossings(CAMERAS, [np.zeros((160, 192))] * 4, [0.7] * 4, LIMITS)
    assert place.shape == (0, 3)
    assert score.shape == (0,)


def test_brightness_of_cameras_is_measured():
    true, bright = points(60, seed=9), np.array([1.0, 0.6, 1.4, 0.9])
    means = [factor * image for factor, image in zip(bright, images(true, LIGHT), strict=True)]
    of_points = PinholeLights(CAMERAS, DIAMETER_PX / 4).balanced(pixels_of(means, seed=1), true, np.full(60, LIGHT))
    assert of_points.brightness == pytest.approx(bright, rel=0.03)


def test_a_camera_that_shows_something_else_is_named():
    true, means = points(60, seed=9), images(points(60, seed=9), LIGHT)
    means[2] = np.zeros_like(means[2])
    with pytest.raises(PlenoPIVError, match="camera 3"):
        PinholeLights(CAMERAS, 0.7).balanced(pixels_of(means, seed=1), true, np.full(60, LIGHT))


def test_a_frame_is_found_whole():
    """Without a reconstruction: the first guess is where lines of sight cross."""
    true = points(400, seed=11)  # .013 particles per pixel
    of_points, pixels = PinholeLights(CAMERAS, DIAMETER_PX / 4), pixels_of(images(true, LIGHT), seed=2)
    first, _ = of_points.places((pixels.counts - 5.0) / np.sqrt(DARK**2 + 5.0), LIMITS)
    found = particles_of_frame(of_points, pixels, first, np.full(len(first), LIGHT), LIMITS)
    off = np.linalg.norm(found.position_mm[:, None] - true, axis=2)
    partner = off.argmin(0)
    near = off.min(0) < SCALE_MM
    assert near.mean() >= 0.97
    assert (off.min(1) < SCALE_MM).mean() >= 0.98  # ghosts
    error = (found.position_mm[partner] - true)[near]
    std = np.sqrt(np.einsum("nii->ni", found.covariance))[partner][near][:, :3]
    assert (np.median(np.abs(error), 0) < 0.06 * SCALE_MM * np.array([1, 1, 2.5])).all()
    assert ((np.abs(error) < std).mean(0) > 0.6).all()
    assert 0.8 < found.chi2 < 1.3


def test_noise_of_each_camera_is_its_own():
    flat = [np.zeros((80, 100)), np.zeros((60, 90))]
    rng = np.random.default_rng(6)
    each = [Pixels.of_image(one + rng.normal(level, std, one.shape), 0.0, 1e9, 9.0, 0.1)
            for one, level, std in zip(flat, (5.0, 20.0), (2.0, 6.0), strict=True)]  # fmt: skip
    both = Pixels.of_cameras(each)
    measured = both.with_measured_noise(np.ones(len(both.counts), bool), np.zeros(len(both.counts)))
    background = np.split(np.broadcast_to(measured.background, len(both.counts)), [8000])
    assert [float(part.mean()) for part in background] == pytest.approx([5.0, 20.0], abs=0.3)
    std = np.split(np.sqrt(measured.variance(np.zeros(len(both.counts)))), [8000])
    assert [float(part.mean()) for part in std] == pytest.approx([2.0, 6.0], rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [((CAMERAS[:1], 0.7), "two or more"),
     ((CAMERAS[:1] * 2, 0.7), "lines of sight of these cameras do not cross"),
     ((CAMERAS, 0.0), "positive"), ((CAMERAS, [0.7, 0.7]), "one of each"),
     ((CAMERAS, 0.7, (0, 0, 900.0)), "in front"),
     ((CAMERAS, [0.7, np.nan, 0.7, 0.7]), "image_px of the cameras is 0.7, nan, 0.7, 0.7; give positive"),
     ((CAMERAS, 0.7, (0, 0, 0), 0.0), "brightness of the cameras is 0, 0, 0, 0; give positive"),
     ((CAMERAS, 0.7, (0, 0, 0), [1.0, 0.0, 1.0, 1.0]), "brightness of the cameras is 1, 0, 1, 1"),
     ((CAMERAS, 0.7, (0, 0, 0), [1.0, 1.0]), "one of each")],
)  # fmt: skip
def test_what_cannot_be_is_said(arguments, said):
    with pytest.raises(PlenoPIVError, match=said):
        PinholeLights(*arguments)


@pytest.mark.parametrize("given", [[1.0, 2.0, 0.5, 1.0], (1.0, 2.0, 0.5, 1.0), np.array([1.0, 2.0, 0.5, 1.0])])
def test_brightness_is_one_number_or_one_of_each_camera(given):
    assert PinholeLights(CAMERAS, 0.7, brightness=given).brightness == (1.0, 2.0, 0.5, 1.0)
    assert PinholeLights(CAMERAS, 0.7, brightness=2.0).brightness == (2.0,) * 4
    assert PinholeLights(CAMERAS, 0.7).brightness == (1.0,) * 4


def test_pixels_of_other_cameras_are_refused():
    lights = PinholeLights(CAMERAS, 0.7)
    with pytest.raises(PlenoPIVError, match="9 pixels are given"):
        lights.places(np.zeros(9), LIMITS)


def test_points_behind_a_camera_are_refused():
    with pytest.raises(PlenoPIVError, match="camera 1"):
        PinholeLights(CAMERAS, 0.7)([(0.0, 0.0, 900.0)])
