"""White images and targets of real cameras: traced backward, against particles traced forward and hand-made figures."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_images import lit_pixels, real_particle_image, real_white_image, target_image
from plenopiv.simulation.targets import CutDot, DotTarget
from plenopiv.simulation.white import white_image

STRIP = PlenopticCamera(
    MainLens(50.0, 22.0, -1.0), Lattice("square", 0.077, 0.0, (0.0, 0.0)), 0.308, Sensor(505, 43, 0.0055, 12)
)
FIELD = replace(STRIP, sensor=Sensor(180, 140, 0.0055, 12), lattice=Lattice("hexagonal", 0.077, 0.01, (0.02, -0.01)))
RADIUS = 0.06  # of a dot
REAL = RealCamera.of(
    FIELD, stop_mm=12.0, rim_radius_mm=12.0, distortion=0.01, gap_tilt=0.02, aspect=0.002,
    medium=Medium(1.333, 40.0, 10.0, 1.52, (1.0, -2.0)), pose=Pose(1.0, (0.5, 0.2, 0.3), (1.0, 2.0)),
)  # fmt: skip


def centroid(image, columns=None):
    """Column and row of the light's centre, from the middle of the image; of some columns."""
    rows, cols = np.indices(image.shape)
    rows, cols = rows - (image.shape[0] - 1) / 2, cols - (image.shape[1] - 1) / 2
    if columns is not None:
        image = np.where((np.abs(cols - columns) < 7) & (np.abs(rows) < 7), image, 0.0)
    return np.array([(cols * image).sum(), (rows * image).sum()]) / image.sum()


def test_the_white_image_of_a_thin_lens():
    exact, white = white_image(FIELD, 1.0), real_white_image(RealCamera.of(FIELD), 1.0)
    assert white.sum() == pytest.approx(exact.sum(), rel=1e-3)
    assert np.abs(white - exact).std() < 0.02


def test_micro_images_are_apart_by_the_exit_pupil():
    camera = RealCamera.of(STRIP, stop_mm=12.0)
    white = real_white_image(camera, samples=400)
    pitch = 0.077 * (1 + 0.308 / (100.0 + 12.0 / (1 - 0.24))) / 0.0055
    for k in (-16, 16):
        assert centroid(white, k * pitch) == pytest.approx([k * pitch, 0.0], abs=0.015)
    assert abs(16 * 0.077 * (1 + 0.308 / 100.0) / 0.0055 - 16 * pitch) > 0.05  # it would be seen


def test_microlenses_of_a_distorted_array_are_further_off_the_axis():
    """By 1 % in the corner, as the square of the distance; particles come through the lenses of the white image."""
    camera = RealCamera.of(STRIP, array_distortion=0.01)
    white = real_white_image(camera, samples=400)
    corner, pitch = np.hypot(505, 43) / 2, 0.077 * (1 + 0.308 / 100.0) / 0.0055
    for k in (-16, 8):
        at = k * pitch * (1 + 0.01 * (k * 14.0 / corner) ** 2)
        assert centroid(white, at) == pytest.approx([at, 0.0], abs=0.03)
    s = 16 * 0.077 * (1 + 0.01 * (16 * 14.0 / corner) ** 2)  # a point in focus, imaged onto a microlens' centre
    image = real_particle_image(camera, Particles(np.array([[-s, 0.0, 0.0]]), np.array([2000.0])), rays=4000, seed=1)
    assert abs(centroid(image)[0]) == pytest.approx(s * (1 + 0.308 / 100.0) / 0.0055, abs=0.3)


def test_the_rim_cuts_the_inner_side_of_micro_images():
    """Light to the right of an upright image comes from +x and passes a lens behind its stop at -u: there the rim takes
    it. Those rays fall on the +s side under the microlens, toward the axis (columns grow with -s)."""
    small = replace(STRIP.main_lens, aperture_mm=14.0)  # micro-images apart
    wide = replace(STRIP, main_lens=small, sensor=replace(STRIP.sensor, columns=1601))
    whole, cut = RealCamera.of(wide, stop_mm=30.0), RealCamera.of(wide, stop_mm=30.0, rim_radius_mm=10.6)
    pitch = 0.077 * (1 + 0.308 / whole.exit_pupil_mm) / 0.0055
    place = 50 * pitch
    a, b = real_white_image(whole, 1.0), real_white_image(cut, 1.0)
    for side in (-1, 1):
        moved = centroid(b, side * place) - centroid(a, side * place)
        assert 0.2 < side * moved[0] < 3.0
        assert abs(moved[1]) < 0.02
    # the side away from the axis is still where it was
    column = np.arange(1601) - 800
    outer, inner = (column > place + 2) & (column < place + 7), (column < place - 2) & (column > place - 7)
    assert b[:, outer].sum() == pytest.approx(a[:, outer].sum(), rel=0.01)
    assert b[:, inner].sum() < 0.9 * a[:, inner].sum()


@pytest.mark.parametrize("z", [-2.0, 0.4, 3.0])
def test_a_small_dot_is_a_particle(z):
    """Backward and forward rays meet: the same place, the same light, the same pixels."""
    target = DotTarget(5.0, 2 * RADIUS, background=0.0)
    dot = target_image(REAL, target, z, 1.0, samples=400)
    k = np.arange(400)
    angle, radius = k * 2.399963, RADIUS * np.sqrt((k + 0.5) / 400)
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(400, z)], -1)
    # in focus a dot as large as a microlens' cell fills one micro-image; nearer it sends more light into the stop
    cell = FIELD.lattice.cell_area_mm2 * 1.002
    nearer = 100.0 / (100.0 - REAL.pose.to_camera((0.0, 0.0, z))[2] / 1.333)
    light = np.pi * RADIUS**2 / cell * lit_pixels(REAL) * nearer**2
    particle = real_particle_image(REAL, Particles(disc, light / 400), rays=1000)
    assert dot.sum() == pytest.approx(particle.sum(), rel=0.03)
    assert centroid(dot) == pytest.approx(centroid(particle), abs=0.15)  # light is not spread quite alike
    dot, particle = dot / dot.sum(), particle / particle.sum()
    assert np.abs(dot - particle).sum() < 0.1


def test_the_marked_dots():
    """In focus, upright: the origin's dot in the middle, the dot of middle size to its right, light by their areas."""
    camera = RealCamera.of(FIELD)
    target = DotTarget(0.3, 0.1, 0.2, 0.15, background=0.0)
    image = target_image(camera, target, 0.0, 1.0)
    pixel = 0.0055 * (1 + camera.microlens_focal_length_mm / 100.0) ** -1

    def light(x, y):
        rows, columns = np.indices(image.shape)
        near = np.maximum(np.abs((columns - 89.5) * pixel - x), np.abs((rows - 69.5) * pixel + y)) < 0.15
        return image[near].sum()

    usual = light(0.0, -0.3)
    assert light(0.0, 0.0) / usual == pytest.approx(4.0, rel=0.03)
    assert light(0.3, 0.0) / usual == pytest.approx(2.25, rel=0.03)
    assert light(-0.3, 0.0) / usual == pytest.approx(1.0, rel=0.03)
    other = replace(target, missing=((-1, 0),), cut=(CutDot(0, -1, 90.0), CutDot(0, 1, 0.0, 1.0)))
    image = target_image(camera, other, 0.0, 1.0)
    assert light(-0.3, 0.0) < 0.05 * usual
    assert light(0.0, -0.3) == pytest.approx(0.5 * usual, rel=0.1)
    assert light(0.0, 0.3) == pytest.approx(usual, rel=0.03)
    image = target_image(camera, replace(target, half_mm=(0.45, 0.14)), 0.0, 1.0)
    assert light(0.0, -0.3) < 0.05 * usual
    assert light(-0.3, 0.0) == pytest.approx(usual, rel=0.03)


@pytest.mark.parametrize("step", [1.5, -1.5])
def test_the_second_level_lies_farther_by_the_step(step):
    camera = RealCamera.of(FIELD)
    two = target_image(camera, DotTarget(0.25, 0.1, step_mm=step, background=0.0), 0.3, 1.0, samples=120)
    near, far = (
        target_image(camera, DotTarget(0.25, 0.1, background=0.0), z, 1.0, samples=120) for z in (0.3, 0.3 - step)
    )

    def column(image, x):
        columns = (np.arange(180) - 89.5) * 0.0055
        part = image[50:90, np.abs(columns - x) < 0.1]
        return part / part.sum()

    def distance(a, b, x):
        return np.abs(column(a, x) - column(b, x)).sum()

    assert distance(two, near, 0.0) < 0.4 * distance(two, far, 0.0)
    assert distance(two, far, 0.25) < 0.4 * distance(two, near, 0.25)


def test_targets_that_cannot_be():
    with pytest.raises(PlenoPIVError, match="touch"):
        DotTarget(0.6, 0.2, 0.7)
    with pytest.raises(PlenoPIVError, match="not in front of the window"):
        target_image(REAL, DotTarget(0.6, 0.2), 45.0)
