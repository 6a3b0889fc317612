"""Lattices against brute force over all lenses around, and signs of rows, offset and rotation."""

import pickle
from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from plenopiv.lattice import Lattice, LatticeMap

QUADRATIC = (0.0, 0.0), (0.002, -0.004), (0.003, 0.001), (-0.002, 0.0), (0.001, 0.002)
CUBIC = LatticeMap(3, 1.3, (*QUADRATIC, (0.01, 0), (0, 0.01), (0.01, 0), (0, 0.01)))
LATTICES = [
    Lattice("square", 0.077),
    Lattice("square", 0.044, 0.3, (0.01, -0.02)),
    Lattice("hexagonal", 0.077),
    Lattice("hexagonal", 0.077, -0.02, (-0.031, 0.013)),
    Lattice("hexagonal", 0.05, 1.1, (0.02, 0.0)),
    Lattice("hexagonal", 0.077, -0.02, (-0.031, 0.013), CUBIC),
    Lattice("square", 0.044, 0.3, (0.01, -0.02), CUBIC),
]


@pytest.mark.parametrize("lattice", LATTICES, ids=str)
def test_nearest_against_all_lenses(lattice):
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (600, 2))
    j, i = (g.ravel() for g in np.mgrid[-20:21, -25:26])
    s, t = lattice.centres(i, j)
    nearest = np.argmin((points[:, :1] - s) ** 2 + (points[:, 1:] - t) ** 2, axis=1)
    got_i, got_j = lattice.nearest(points[:, 0], points[:, 1])
    # a map moves the borders of cells a little from half way between the lenses
    apart = np.hypot(points[:, 0] - s[nearest], points[:, 1] - t[nearest]) / lattice.pitch_mm
    sure = apart < (1.0 if lattice.map is None else 0.47)
    assert sure.mean() > 0.6
    np.testing.assert_array_equal(got_i[sure], i[nearest][sure])
    np.testing.assert_array_equal(got_j[sure], j[nearest][sure])


@pytest.mark.parametrize("lattice", LATTICES, ids=str)
def test_centres_and_coordinates_are_inverse(lattice):
    j, i = (g.ravel() for g in np.mgrid[-7:8, -7:8])
    along, across = lattice.coordinates(*lattice.centres(i, j))
    shift = 0.5 * (j % 2) if lattice.kind == "hexagonal" else 0.0
    np.testing.assert_allclose(along, i + shift, atol=1e-12)
    np.testing.assert_allclose(across, j * lattice.row_spacing, atol=1e-12)
    back_i, back_j = lattice.nearest(*lattice.centres(i, j))
    np.testing.assert_array_equal(back_i, i)
    np.testing.assert_array_equal(back_j, j)


@pytest.mark.parametrize("lattice", LATTICES[:5], ids=str)
def test_one_lens_per_cell_area(lattice):
    j, i = (g.ravel() for g in np.mgrid[-40:41, -40:41])
    s, t = lattice.centres(i, j)
    radius = 25 * lattice.pitch_mm
    inside = np.count_nonzero(np.hypot(s, t) < radius)
    assert inside * lattice.cell_area_mm2 == pytest.approx(pi * radius**2, rel=0.01)


def test_map_moves_the_centres_of_the_regular_lattice():
    """Signs and order of the terms: ds, dt of s, t, s^2, s t, t^2; nothing moves on the axis."""
    terms = {(1, 0): 0.01, (0, 1): -0.02, (2, 0): 0.003, (1, 1): 0.004, (0, 2): -0.005}
    by = LatticeMap(2, 2.0, tuple((a, -3.0 * a) for a in terms.values()))
    regular = Lattice("square", 1.0, 0.0, (0.3, 0.1))
    i, j = np.array([0, 5, -2]), np.array([0, 1, 3])
    s, t = regular.centres(i, j)
    want = sum(a * (s / 2.0) ** p * (t / 2.0) ** q for (p, q), a in terms.items())
    got_s, got_t = replace(regular, map=by).centres(i, j)
    np.testing.assert_allclose(got_s - s, want, atol=1e-14)
    np.testing.assert_allclose(got_t - t, -3.0 * want, atol=1e-14)
    assert [float(d) for d in by.displacement(0.0, 0.0)] == [0.0, 0.0]


def test_renumbered_lenses_stay_where_they_are():
    """``aligned`` numbers along other rows; the map is of the plane."""
    lattice = Lattice("hexagonal", 0.077, 1.1, (0.01, 0.02), CUBIC)
    j, i = (g.ravel() for g in np.mgrid[-6:7, -6:7])
    s, t = lattice.centres(i, j)
    other = lattice.aligned()
    assert other.rotation_rad != lattice.rotation_rad
    back = other.centres(*other.nearest(s, t))
    np.testing.assert_allclose(back, (s, t), atol=1e-12)
    assert pickle.loads(pickle.dumps(other)) == other
    assert len({other, lattice, pickle.loads(pickle.dumps(lattice))}) == 2


def test_geometry_of_a_hexagonal_lattice():
    """All six neighbours are one pitch away; odd rows are shifted towards +s; the rotation is counter-clockwise."""
    lattice = Lattice("hexagonal", 2.0)
    neighbours = [(1, 0), (-1, 0), (0, 1), (-1, 1), (0, -1), (-1, -1)]
    for i, j in neighbours:
        assert np.hypot(*lattice.centres(i, j)) == pytest.approx(2.0)
    assert lattice.centres(0, 1) == pytest.approx((1.0, sqrt(3.0)))
    assert lattice.centres(0, -1) == pytest.approx((1.0, -sqrt(3.0)))
    turned = Lattice("hexagonal", 2.0, pi / 2, (10.0, 20.0))
    assert turned.centres(1, 0) == pytest.approx((10.0, 22.0))
    assert Lattice("square", 2.0, pi / 2, (10.0, 20.0)).centres(0, 1) == pytest.approx((8.0, 20.0))


def test_an_uneven_array_that_has_moved_has_its_centres_moved():
    bent = LatticeMap(2, 3.0, ((0.004, 0.001), (-0.002, 0.003), (0.005, 0.0), (0.0, -0.004), (0.002, 0.001)))
    lattice = Lattice("hexagonal", 0.077, 0.01, (0.02, -0.01), bent)
    j, i = np.mgrid[-20:21, -20:21]
    now = lattice.moved((0.03, -0.05), 0.004, 0.002)
    s, t = lattice.centres(i, j)
    moved = 1.002 * np.exp(0.004j) * (s + 1j * t) + (0.03 - 0.05j)
    s, t = now.centres(i, j)
    np.testing.assert_allclose(s + 1j * t, moved, atol=1e-5)
