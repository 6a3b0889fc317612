"""The map between laboratory and lens space."""

import pickle

import numpy as np
import pytest

from plenopiv.cameras.space_map import Polynomial, SpaceMap, ViewShift, powers
from plenopiv.errors import PlenoPIVError

N, AIR = 1.333, 88.0  # water, and the way in air and its like from the stop to the focal plane


def lens_point(p):
    """A pinhole at the stop looks into water: depth shrinks by n to first order; the rest grows with the angle."""
    x, y, z = np.moveaxis(np.asarray(p), -1, 0)
    depth, off = AIR - z / N, np.hypot(x, y)
    sine = off / np.hypot(off, depth)
    depth = depth - 30 * (1 - np.sqrt(1 - (sine / N) ** 2))
    return np.stack([x * AIR / depth, y * AIR / depth, AIR - depth], -1)


def box(n, x=3.5, y=2.8, z=5.8):
    axes = np.linspace(-x, x, n), np.linspace(-y, y, n), np.linspace(-z, z, n)
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


@pytest.fixture(scope="module")
def found():
    points = box(10)
    return SpaceMap.fitted(points, lens_point(points))


def test_powers_are_all_up_to_the_degree():
    assert len(powers(3)) == 20
    assert {tuple(p) for p in powers(1).tolist()} == {(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)}


def test_there_and_back(found):
    points = box(7, 3.4, 2.7, 5.7)
    assert np.abs(found.to_lens(points) - lens_point(points)).max() < 2e-5
    assert np.abs(found.to_laboratory(found.to_lens(points)) - points).max() < 4e-5


def test_the_jacobian_is_that_of_finite_differences(found):
    points, step = box(3, 3, 2, 5), 1e-5
    for b in range(3):
        beyond = np.zeros(3)
        beyond[b] = step
        expected = (found.to_lens(points + beyond) - found.to_lens(points - beyond)) / (2 * step)
        np.testing.assert_allclose(found.to_lens.jacobian(points)[:, :, b], expected, atol=1e-8)


def test_a_polynomial_of_the_degree_is_found_exactly():
    points = box(5)
    x, y, z = points.T
    images = np.stack([x + 0.01 * x * z, y - 0.02 * x * y * z, 2 + z / 1.3 + 0.001 * x**2], -1)
    np.testing.assert_allclose(Polynomial.fitted(points, images, 3)(points), images, atol=1e-12)


def test_shapes_are_kept(found):
    assert found.to_lens(np.zeros(3)).shape == (3,)
    assert found.to_lens(np.zeros((2, 4, 3))).shape == (2, 4, 3)
    assert found.to_lens.jacobian(np.zeros((2, 4, 3))).shape == (2, 4, 3, 3)


def test_too_few_points_are_refused():
    flat = box(6) * [1, 1, 0]
    with pytest.raises(PlenoPIVError, match="give more planes"):
        Polynomial.fitted(flat, flat, 3)


def test_the_box_of_lens_space_holds_that_of_the_laboratory(found):
    limits = found.lens_limits(((-3.5, 3.5), (-2.8, 2.8), (-5.8, 5.8)))
    low, high = np.array(limits).T
    inside = lens_point(box(21))
    assert (inside >= low - 1e-3).all()
    assert (inside <= high + 1e-3).all()
    assert np.abs(inside.max(0) - high).max() < 1e-3


def test_it_pickles(found):
    assert pickle.loads(pickle.dumps(found)) == found


def test_shifts_of_two_degrees_and_units_add_up():
    rng = np.random.default_rng(3)
    terms = {degree: sum(sum(p) <= degree for p in np.ndindex(*(degree + 1,) * 4)) for degree in (1, 3)}
    one, other = (
        ViewShift(u_mm, s_mm, degree, tuple(map(tuple, rng.normal(size=(terms[degree], 2)))))
        for degree, u_mm, s_mm in ((1, 12.0, 3.0), (3, 10.0, 4.0))
    )
    u, s = rng.uniform(-9, 9, (20, 2)), rng.uniform(-3, 3, (20, 2))
    np.testing.assert_allclose(one.plus(other)(u, s), one(u, s) + other(u, s), rtol=1e-9)
    np.testing.assert_allclose(other.plus(one)(u, s), one(u, s) + other(u, s), rtol=1e-9)
