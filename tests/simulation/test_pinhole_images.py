"""Particles and dot boards through pinhole cameras: light, places, widths."""

from math import pi

import numpy as np
import pytest
from oracles.tomography import SCALE_MM_PX, four_cameras

from plenopiv.cameras.pinhole import looking_at
from plenopiv.errors import PlenoPIVError
from plenopiv.sensor import Sensor
from plenopiv.simulation.board import board_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.pinhole_images import pinhole_image


def moments(image):
    """Sum, mean (column, row) and variance (column, row) of an image's light."""
    total = image.sum()
    rows, columns = (np.arange(n) for n in image.shape)
    mean = image.sum(0) @ columns / total, image.sum(1) @ rows / total
    variance = image.sum(0) @ (columns - mean[0]) ** 2 / total, image.sum(1) @ (rows - mean[1]) ** 2 / total
    return total, mean, variance


@pytest.mark.parametrize("diameter_px", [2.5, 3.0, 5.0])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.5), (-0.61, 0.27, -0.33)])
def test_light_centroid_and_width(place, diameter_px):
    """All of the light arrives; its centroid is the projection; its variance that of the spot and of a pixel."""
    for camera in four_cameras(64):
        total, mean, variance = moments(pinhole_image(camera, Particles([place], 750.0), diameter_px=diameter_px))
        assert total == pytest.approx(750.0, rel=1e-4)
        assert mean == pytest.approx(tuple(camera.project(place)), abs=3e-4)
        assert variance == pytest.approx([(diameter_px / 4) ** 2 + 1 / 12] * 2, rel=2e-3)


def test_a_pixel_is_an_integral_of_the_gaussian():
    """Against the midpoint rule on 200 x 200 points of a pixel."""
    camera = four_cameras(32)[1]
    place = camera.project((0.1, 0.05, 0.2))
    column, row = np.rint(place).astype(int) + np.array([1, -1])
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    sigma = 2.7 / 4
    c, r = np.meshgrid(column + fine - place[0], row + fine - place[1])
    expected = np.mean(np.exp(-(c**2 + r**2) / (2 * sigma**2)) / (2 * pi * sigma**2))
    image = pinhole_image(camera, Particles([(0.1, 0.05, 0.2)], 1.0))
    assert image[row, column] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("step", "moved"), [((0.3, 0, 0), (1, 0)), ((0, 0.3, 0), (0, -1)), ((0, 0, 0.3), (-1, 0))], ids=["x", "y", "z"]
)
def test_particles_appear_moved_the_right_way(step, moved):
    """For a camera that stands to the right (x > 0): x to the right, y up, z (nearer) to the left."""
    camera = looking_at((0, 0, 0), Sensor(64, 64, 0.0055), scale_mm_px=SCALE_MM_PX, distance_mm=1e4, about_y_deg=30)
    (_, before, _), (_, after, _) = (moments(pinhole_image(camera, Particles([p], 1.0))) for p in ((0, 0, 0), step))
    change = np.subtract(after, before)
    expected = 0.3 / SCALE_MM_PX * np.array(moved) * {0: np.cos(pi / 6), 1: 1.0, 2: 0.5}[int(np.argmax(step))]
    assert change == pytest.approx(expected, abs=0.01)


def test_light_adds_up_and_is_lost_over_the_edge():
    camera = looking_at((0, 0, 0), Sensor(32, 32, 0.0055), scale_mm_px=SCALE_MM_PX, distance_mm=300)
    edge = camera.on_plane((31.5, 16.0), 0.0)
    far = camera.on_plane((80.0, 16.0), 0.0)
    one = pinhole_image(camera, Particles([edge], 100.0))
    assert one.sum() == pytest.approx(50.0, rel=1e-3)
    both = pinhole_image(camera, Particles([edge, edge, far], [100.0, 50.0, 1000.0]))
    np.testing.assert_allclose(both, 1.5 * one, atol=1e-9)
    assert pinhole_image(camera, Particles(np.zeros((0, 3)), 1.0)).sum() == 0


def test_a_particle_s_own_size_widens_its_image():
    camera = four_cameras(64)[0]
    own_px = 0.2 / SCALE_MM_PX
    _, _, variance = moments(pinhole_image(camera, Particles([(0, 0, 0)], 1.0, 0.2)))
    assert variance == pytest.approx([(2.7**2 + own_px**2) / 16 + 1 / 12] * 2, rel=2e-3)


@pytest.mark.parametrize(
    ("particles", "options", "message"),
    [
        (Particles([(0, 0, 1000.0)], 1.0), {}, "not in front of the camera"),
        (Particles([(0, 0, 0.0)], 1.0), {"diameter_px": 0.0}, "diameter_px"),
    ],
)
def test_images_that_cannot_be(particles, options, message):
    with pytest.raises(PlenoPIVError, match=message):
        pinhole_image(four_cameras(64)[0], particles, **options)


def test_a_board_against_many_rays_through_each_pixel():
    """Light of each pixel from 12 x 12 rays; the rim's straight line is off by little."""
    camera = looking_at((0, 0, 0), Sensor(40, 40, 0.0055), scale_mm_px=0.2, distance_mm=100, about_y_deg=35)
    image = board_image(camera, 2.0, electrons_per_pixel=1.0, background=0.0)
    fine = (np.arange(12) + 0.5) / 12 - 0.5
    offset = np.stack(np.meshgrid(fine, fine), -1)
    pixels = np.stack(np.meshgrid(np.arange(40), np.arange(40)), -1)[:, :, None, None] + offset
    x, y, _ = np.moveaxis(camera.on_plane(pixels, 2.0), -1, 0)
    i, j = np.rint(x / 5), np.rint(y / 5)
    radius = np.where((i == 0) & (j == 0), 1.5, 1.0)
    expected = (np.hypot(x - 5 * i, y - 5 * j) < radius).mean((2, 3))
    assert np.abs(image - expected).max() < 0.07
    assert image.sum() == pytest.approx(expected.sum(), rel=5e-3)


def test_the_board_s_larger_dot_is_the_origin():
    camera = looking_at((0, 0, 0), Sensor(300, 300, 0.0055), scale_mm_px=0.1, distance_mm=300, about_x_deg=20)
    image = board_image(camera, -3.0, electrons_per_pixel=100.0, background=0.1)
    column, row = np.rint(camera.project((1.3, 0, -3.0))).astype(int)
    assert image[row, column] == 100.0
    column, row = np.rint(camera.project((5 + 1.3, 0, -3.0))).astype(int)
    assert image[row, column] == 10.0
    assert image[0, 0] in (10.0, 100.0)


def test_dots_that_touch():
    with pytest.raises(PlenoPIVError, match="touch"):
        board_image(four_cameras(64)[0], 0.0, diameter_mm=4.0, origin_diameter_mm=6.0)
