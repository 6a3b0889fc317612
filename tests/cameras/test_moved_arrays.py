"""A microlens array that has moved: its lattice, and an image of before as it would be now."""

import numpy as np
import pytest

from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import Sensor

NUMBERS = np.arange(-6, 7), np.arange(-6, 7)[:, None]
BENT = LatticeMap(
    3,
    2.0,
    tuple((0.01 * np.sin(k), 0.01 * np.cos(3 * k)) for k in range(9)),  # some 10 um, of all its terms
)


def camera(bent=None):
    lattice = Lattice("hexagonal", 0.077, 0.03, (0.02, -0.01), bent)
    return PlenopticCamera(MainLens(50.0, 25.0, -1.0), lattice, 0.308, Sensor(61, 41, 0.0055, 12, 60))


def micro_images(of):
    """Columns and rows of the centres of micro-images."""
    s, t = of.lattice.centres(*NUMBERS)
    return np.stack(of.sensor.pixel_from_plane(s * (1 + of.image_scale), t * (1 + of.image_scale)))


@pytest.mark.parametrize("bent", [None, BENT])
@pytest.mark.parametrize(("shift", "turn_deg", "scale"), [((0.5, -2.0), 0.0, 0.0), ((0.7, 0.2), 20.0, 0.1)])
def test_each_lens_moves_as_the_plane_does(bent, shift, turn_deg, scale):
    lattice = camera(bent).lattice
    moved = lattice.moved(shift, np.radians(turn_deg), scale)
    s, t = lattice.centres(*NUMBERS)
    expected = complex(*shift) + (1 + scale) * np.exp(1j * np.radians(turn_deg)) * (s + 1j * t)
    found_s, found_t = moved.centres(*NUMBERS)
    np.testing.assert_allclose(found_s + 1j * found_t, expected, atol=1e-12)
    if bent is not None:
        assert moved.map.displacement(0.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("bent", [None, BENT])
def test_a_shift_to_the_right_and_one_down(bent):
    before = micro_images(camera(bent))
    for axis, shift in enumerate([(0.75, 0.0), (0.0, 0.75)]):
        moved = micro_images(ArrayDrift(shift).of(camera(bent))) - before
        np.testing.assert_allclose(moved[axis], 0.75, atol=1e-9)
        np.testing.assert_allclose(moved[1 - axis], 0.0, atol=1e-9)


def test_a_turn_is_counter_clockwise_in_the_image_and_about_its_middle():
    column, row = micro_images(camera()) - np.array([30.0, 20.0])[:, None, None]
    turned, down = micro_images(ArrayDrift(turn_deg=90.0).of(camera())) - np.array([30.0, 20.0])[:, None, None]
    np.testing.assert_allclose(turned, row, atol=1e-9)  # what was below is now to the right
    np.testing.assert_allclose(down, -column, atol=1e-9)


def test_a_scale_moves_away_from_the_middle():
    column, _ = micro_images(camera()) - np.array([30.0, 20.0])[:, None, None]
    further, _ = micro_images(ArrayDrift(scale=0.01).of(camera())) - np.array([30.0, 20.0])[:, None, None]
    np.testing.assert_allclose(further, 1.01 * column, atol=1e-9)


def test_nothing_moves_without_a_drift_and_the_most_is_in_a_corner():
    assert not ArrayDrift()
    assert ArrayDrift(scale=1e-9)
    drift, sensor = ArrayDrift((3.0, -4.0), 0.02, 1e-3), camera().sensor
    corner = 0.5 * np.hypot(61, 41)
    assert drift.most_px(sensor) == pytest.approx(5.0 + corner * np.hypot(np.radians(0.02), 1e-3))


def test_an_image_of_now_holds_what_was_elsewhere_before():
    """Each pixel of a linear image, of which interpolation is exact, by a loop."""
    rows, columns = 41, 61
    image = 100.0 + 3.0 * np.arange(columns) - 2.0 * np.arange(rows)[:, None]
    drift = ArrayDrift((1.25, -0.5), 3.0, 0.02)
    moved = drift.moved(image)
    for row in range(8, 33, 6):
        for column in range(8, 53, 6):
            now = complex(-(column - 30), row - 20)  # (s, t) px
            was = (now - complex(-1.25, -0.5)) / (1.02 * np.exp(1j * np.radians(3.0)))
            expected = 100.0 + 3.0 * (30 - was.real) - 2.0 * (20 + was.imag)
            assert moved[row, column] == pytest.approx(expected, abs=1e-3)
