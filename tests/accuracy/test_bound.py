"""The Cramer-Rao bound: its light against the oracles, its limits against closed forms, and a fit that reaches it."""

from math import inf, pi, sqrt

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.light import point_image_square

from plenopiv.accuracy import (
    field_bounds,
    fisher_information,
    pixel_variance,
    point_light,
    position_bound,
    standard_deviation,
    window_bound,
)
from plenopiv.cameras.presets import preset
from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.particles import pixels_lit_in_focus
from plenopiv.simulation.sensor_noise import SensorNoise

NOISE = SensorNoise(gain=0.5, read_noise_electrons=3.0)
SHOT_ALONE = SensorNoise(gain=1e6, read_noise_electrons=0.0)
SQUARE = small_camera("square", microlenses=(15, 15), offset_mm=(0.031, 0.021))
STEPS_MM = (1e-5, 1e-5, 1e-4)


def bright(camera, electrons_per_pixel=400.0):
    return electrons_per_pixel * pixels_lit_in_focus(camera)


def spread_out(camera, light, values):
    image = np.zeros(camera.sensor.rows * camera.sensor.columns)
    image[light.pixel] = values
    return image


def oracle_gradient(camera, point):
    """Central differences of exact areas, (pixels, 3) per mm."""
    columns = []
    for axis, h in enumerate(STEPS_MM):
        step = h * np.eye(3)[axis]
        ahead, behind = (point_image_square(camera, point + sign * step) for sign in (1, -1))
        columns.append((ahead - behind).ravel() / (2 * h))
    return np.stack(columns, -1)


@pytest.mark.parametrize("point", [(0.012, 0.03, 1.7), (0.05, -0.02, -3.1), (0.1, 0.02, 0.5), (0.03, 0.03, 0.05)])
def test_light_and_gradient_are_those_of_exact_areas(point):
    """Signs and sizes, in front of focus and behind it, and in the dead zone where only the rim moves."""
    light = point_light(SQUARE, point)
    exact = point_image_square(SQUARE, point).ravel()
    assert spread_out(SQUARE, light, light.share) == pytest.approx(exact, abs=0.08 * exact.max())
    expected = oracle_gradient(SQUARE, np.array(point))
    for axis in range(3):
        found = spread_out(SQUARE, light, light.gradient[:, axis])
        assert np.linalg.norm(found - expected[:, axis]) < 0.05 * np.linalg.norm(expected[:, axis])
        weight = 1 / (exact + 1e-4)  # the information, which is what the gradient is for
        assert (weight * found**2).sum() == pytest.approx((weight * expected[:, axis] ** 2).sum(), rel=0.02)


def test_gradient_follows_shares_on_a_turned_hexagonal_lattice():
    """Shares come from rays, gradients from boundaries: a step's change of the one is the other, on every axis."""
    camera = small_camera("hexagonal", microlenses=(15, 15), offset_mm=(0.031, 0.021), rotation_rad=0.3)
    point = np.array([0.02, -0.03, 1.3])
    light = point_light(camera, point)
    assert light.share.sum() == pytest.approx(1.0, abs=1e-3)
    assert light.gradient.sum(0) == pytest.approx(0.0, abs=1e-12)  # what one pixel loses another gains
    for axis, h in enumerate((0.004, 0.004, 0.04)):
        ends = [point_light(camera, point + sign * h * np.eye(3)[axis], rays=200_000) for sign in (1, -1)]
        change = np.subtract(*(spread_out(camera, end, end.share) for end in ends)) / (2 * h)
        gradient = spread_out(camera, light, light.gradient[:, axis])
        # smooth over the step from both ends and the middle (Simpson)
        ahead, behind = (spread_out(camera, end, end.gradient[:, axis]) for end in ends)
        mean = (ahead + 4 * gradient + behind) / 6
        assert (mean @ change) / (mean @ mean) == pytest.approx(1.0, abs=0.03)
        assert np.linalg.norm(mean - change) < 0.15 * np.linalg.norm(mean)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("z", [-0.15, pytest.param(0.1, marks=pytest.mark.full)])
def test_share_of_positions_without_depth(kind, z):
    """A blur of |A| P_m fits into one cell at (1 - |A| P_m/p)^2 of all places, about (1 - |z|/z0)^2."""
    camera = small_camera(kind)
    rng = np.random.default_rng(2)
    n = 400
    places = rng.uniform(-0.5, 0.5, (n, 2)) @ np.array([[10, 0], [0, 10 * sqrt(3)]]) * camera.lattice.pitch_mm
    alone = np.mean([point_light(camera, (x, y, z), rays=10).one_lens for x, y in places])
    blur = abs(float(camera.spread(z))) * camera.main_lens.aperture_mm / camera.lattice.pitch_mm
    expected = (1 - blur) ** 2
    assert expected == pytest.approx((1 - abs(z) / 0.308) ** 2, abs=0.01)
    assert alone == pytest.approx(expected, abs=3.5 * sqrt(expected * (1 - expected) / n))


@pytest.mark.parametrize(
    ("z", "expected"), [pytest.param(0.15, 1.0, marks=pytest.mark.full), (0.28, 1.0), (0.42, None), (0.7, 0.0)]
)
def test_a_square_lattice_has_no_depth_before_the_blur_meets_two_parallel_edges(z, expected):
    """One edge across the blur gives x and z together, two crossing ones x and z, y and z: never z.

    Blurs of |A| P_m between one pitch and two miss a second parallel edge along x at 2 - |A| P_m/p of all places, and
    along x and y at its square.
    """
    rng = np.random.default_rng(7)
    electrons, n = bright(SQUARE), 80
    blur = abs(float(SQUARE.spread(z))) * SQUARE.main_lens.aperture_mm / SQUARE.lattice.pitch_mm
    share = (2 - blur) ** 2 if expected is None else expected
    std = [position_bound(SQUARE, (*rng.uniform(-0.1, 0.1, 2), z), electrons, NOISE).std_mm[2] for _ in range(n)]
    unknown = np.mean(np.array(std) > 0.02)
    assert unknown == pytest.approx(share, abs=3.5 * sqrt(max(share * (1 - share), 0.0) / n) + 1e-9)


def test_depth_under_one_lens_is_only_the_size_of_its_image():
    """Where light is split depth is known to microns; where it is not, to about a tenth of a millimetre at best.

    A disc of radius r px with I electrons in a pixel is lit up to its rim; a radius of one value shifts the light of
    2 pi r rim pixels by I each, half lit: var(r) near I/2 / (I^2 2 pi r), and r changes by A'/(1 - A) = 1 % a mm.
    """
    camera = small_camera("hexagonal")
    electrons, radius = bright(camera), camera.aperture_radius_px
    centre = position_bound(camera, (0.0, 0.0, 0.05), electrons, SHOT_ALONE)
    split = position_bound(camera, (0.03, 0.01, 0.5), electrons, SHOT_ALONE)
    assert centre.one_lens
    assert not split.one_lens
    rough_mm = sqrt(0.5 / (400.0 * 2 * pi * radius)) / (0.01 * radius)
    assert 0.4 < centre.std_mm[2] / rough_mm < 2.5
    assert centre.std_mm[2] > 20 * split.std_mm[2]


def test_the_figure_of_an_isolated_particle():
    """400 electrons a lit pixel at z = 4 mm: near 1.4 um, 0.02 voxel of 77 um."""
    camera = preset("29mp")
    rng = np.random.default_rng(3)
    std = [
        position_bound(camera, (*rng.uniform(-0.2, 0.2, 2), 4.0), bright(camera), NOISE).std_mm[2] for _ in range(15)
    ]
    assert np.median(std) == pytest.approx(1.4e-3, rel=0.25)


@pytest.mark.parametrize(
    ("noise", "electrons", "factor"),
    [(SHOT_ALONE, 1e5, 2.0), (SensorNoise(gain=1e6, read_noise_electrons=1e3), 1e2, 4.0)],
    ids=["shot noise: 1/sqrt(E)", "read noise: 1/E"],
)
def test_limits_of_noise(noise, electrons, factor):
    point = (0.02, 0.01, 1.2)
    less, more = (position_bound(SQUARE, point, e, noise).std_mm for e in (electrons, 4 * electrons))
    assert less / more == pytest.approx(factor, rel=1e-3)


def test_rounding_to_counts_and_background_count_as_noise():
    assert pixel_variance(5.0, SensorNoise(gain=0.1, read_noise_electrons=2.0)) == pytest.approx(5 + 4 + 100 / 12)
    dark, lit = (position_bound(SQUARE, (0.02, 0.01, 1.2), 1e4, NOISE, background_electrons=b) for b in (0.0, 50.0))
    assert (lit.std_mm > 1.2 * dark.std_mm).all()


def test_information_is_symmetric_and_never_negative():
    points = [(0.02, 0.01, 1.2), (0.06, -0.03, -0.8), (-0.01, 0.0, 2.0)]
    lights = [point_light(SQUARE, p) for p in points]
    j = fisher_information(lights, [1e4, 2e4, 5e3], NOISE)
    assert j.shape == (12, 12)
    assert np.array_equal(j, j.T)
    scale = 1 / np.sqrt(np.diag(j))
    assert np.linalg.eigvalsh(j * scale * scale[:, None]).min() > -1e-12


def test_neighbours_cost_what_the_inverse_of_the_joint_information_says():
    points = np.array([(0.02, 0.01, 1.2), (0.06, -0.03, -0.8), (-0.01, 0.0, 2.0)])
    electrons = np.array([1e4, 2e4, 5e3])
    j = fisher_information([point_light(SQUARE, p) for p in points], electrons, NOISE)
    found = position_bound(SQUARE, points[0], 1e4, NOISE, neighbours_mm=points[1:], neighbour_electrons=electrons[1:])
    assert found.std_mm == pytest.approx(np.sqrt(np.diag(np.linalg.inv(j))[:3]), rel=1e-6)
    alone = position_bound(SQUARE, points[0], 1e4, NOISE)
    assert (found.std_mm > alone.std_mm).all()
    away = position_bound(SQUARE, points[0], 1e4, NOISE, neighbours_mm=[(0.4, 0.4, 0.5)])
    assert away.std_mm == pytest.approx(alone.std_mm, rel=1e-12)


def test_two_particles_at_one_place_cannot_be_told_apart():
    point = (0.02, 0.01, 1.2)
    assert position_bound(SQUARE, point, 1e4, NOISE, neighbours_mm=[point]).std_mm.tolist() == [inf] * 3


@pytest.mark.full
def test_a_fit_reaches_the_bound():
    """Maximum likelihood (Fisher scoring from 3 standard deviations away) on exact areas, not on this module's light.

    100 noisy images of one particle: standard deviations are known to 7 %.
    """
    camera = small_camera("square", microlenses=(9, 9), offset_mm=(0.031, 0.021))
    rng = np.random.default_rng(4)
    truth, electrons = np.array([0.013, -0.008, 1.2]), bright(camera)
    bound = position_bound(camera, truth, electrons, SensorNoise(gain=1e6, read_noise_electrons=3.0))
    clean = electrons * point_image_square(camera, truth).ravel()
    errors = []
    for _ in range(100):
        image = rng.poisson(clean) + 3.0 * rng.standard_normal(clean.size)
        point, light = truth + 3 * bound.std_mm * rng.choice([-1, 1], 3), 0.95 * electrons
        for turn in range(5):
            share = point_image_square(camera, point).ravel()
            if turn < 2:  # the last steps are small
                gradient = oracle_gradient(camera, point)
            g = np.column_stack([light * gradient, share])
            weighted = g / (light * share + 9.0)[:, None]
            step = np.linalg.solve(weighted.T @ g, weighted.T @ (image - light * share))
            point, light = point + step[:3], light + step[3]
        errors.append(point - truth)
    errors = np.array(errors)
    assert (np.abs(errors.mean(0)) < 4 * bound.std_mm / sqrt(len(errors))).all()
    assert errors.std(0) / bound.std_mm == pytest.approx(1.0, abs=0.2)


def test_windows_add_information():
    """Equal particles: sqrt(2/N) of one; one without information adds nothing; an unknown pairing is resolved."""
    one = np.diag([1e4, 1e4, 400.0])
    assert window_bound([one] * 5, 8) == pytest.approx(np.array([0.01, 0.01, 0.05]) * sqrt(2 / 8))
    assert window_bound([one, 0 * one], 8) == pytest.approx(np.array([0.01, 0.01, 0.05]) * sqrt(2 / 4))
    assert window_bound([0 * one], 8).tolist() == [inf] * 3
    # one particle knows y and x + z alone, the other y and x - z alone: neither x nor z, but both do together
    lines = [1e4 * (np.outer(v, v) + np.diag([0, 1, 0])) for v in (np.array([1, 0, 1]), np.array([1, 0, -1]))]
    assert standard_deviation(lines[0])[[0, 2]].tolist() == [inf] * 2
    assert window_bound(lines, 2) == pytest.approx(np.array([sqrt(1 / 2), sqrt(1 / 2), sqrt(1 / 2)]) * 0.01 * sqrt(2))
    with pytest.raises(PlenoPIVError, match="no particle"):
        window_bound(np.empty((0, 3, 3)), 8)


def test_a_field_is_harder_the_denser_it_is():
    camera = small_camera("hexagonal")
    sparse, dense, again = (
        field_bounds(camera, ppm, (-0.8, 0.8), bright(camera), NOISE, np.random.default_rng(5), particles=8)
        for ppm in (0.02, 1.0, 1.0)
    )
    cost = []
    for field in (sparse, dense):
        assert (np.abs(field.position_mm[:, 2]) <= 0.8).all()
        isolated, overlapping = standard_deviation(field.isolated), standard_deviation(field.overlapping)
        assert (overlapping >= isolated * (1 - 1e-6)).all()
        cost.append(np.median(overlapping[:, 2] / isolated[:, 2]))
    assert cost[0] < 1.1
    assert cost[1] > 1.2
    assert dense.neighbours.mean() > 15 * sparse.neighbours.mean()
    assert np.array_equal(dense.overlapping, again.overlapping)


def test_a_particle_in_a_field_has_the_bound_of_its_position():
    """The field's sensor is another, but the lattice stays where it is on the pixels."""
    camera = small_camera("hexagonal", microlenses=(15, 15))
    field = field_bounds(camera, 0.02, (-0.8, 0.8), 5e4, NOISE, np.random.default_rng(6), particles=3)
    wide = small_camera("hexagonal", microlenses=(75, 75))
    for place, isolated in zip(field.position_mm, field.isolated, strict=True):
        assert position_bound(wide, place, 5e4, NOISE).information == pytest.approx(isolated, rel=1e-9)


def test_bad_input_is_named():
    with pytest.raises(PlenoPIVError, match="electrons = 0"):
        position_bound(SQUARE, (0, 0, 1), 0.0, NOISE)
    with pytest.raises(PlenoPIVError, match="no pixel"):
        position_bound(SQUARE, (50, 0, 1), 1e4, NOISE)
    with pytest.raises(PlenoPIVError, match="in front of the main lens"):
        position_bound(SQUARE, (0, 0, 100), 1e4, NOISE)
    with pytest.raises(PlenoPIVError, match="depths as"):
        field_bounds(SQUARE, 1.0, (1.0, 1.0), 1e4, NOISE, np.random.default_rng(0))
