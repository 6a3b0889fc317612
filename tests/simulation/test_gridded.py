"""Splines between grid points: exact where they should be, of sixth order elsewhere, nearly free of divergence."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import advect, flow
from plenopiv.simulation.gridded import GriddedVelocity

RNG = np.random.default_rng(0)


def gridded(velocity, points=(12, 10, 9), first=(-3.0, -2.0, -1.0), spacing=(0.5, 0.4, 0.3), **options):
    """A callable (x, y, z) -> (u, v, w) put on a grid; numbers along x, y, z."""
    x, y, z = (a + h * np.arange(n) for a, h, n in zip(first, spacing, points, strict=True))
    z, y, x = np.meshgrid(z, y, x, indexing="ij")
    values = velocity(np.stack([x, y, z], -1).reshape(-1, 3)).reshape(*x.shape, 3)
    return GriddedVelocity(values, first, spacing, **options)


def inside(field, n=300):
    return np.stack([RNG.uniform(lo, hi, n) for lo, hi in field.limits_mm], -1)


def gradient(velocity, points_mm, h=1e-4):
    """du_i/dx_j in 1/s by central differences; (n, 3, 3)."""
    steps = h * np.eye(3)
    return np.stack([(velocity(points_mm + s) - velocity(points_mm - s)) * 1e3 / (2 * h) for s in steps], -1)


def test_polynomials_of_degree_five_are_exact_up_to_the_faces():
    powers = RNG.integers(0, 6, (3, 4, 3))
    factors = RNG.standard_normal((3, 4))

    def polynomial(p):
        terms = np.prod((p[:, None, None, :] / 3.0) ** powers, -1)
        return (terms * factors).sum(-1)

    field = gridded(polynomial)
    points = np.concatenate([inside(field), np.transpose(field.limits_mm)])
    assert field(points) == pytest.approx(polynomial(points), abs=1e-10)


@pytest.mark.parametrize("points", [4, 5])
def test_few_planes_take_a_cubic(points):
    field = gridded(lambda p: p**3, (8, 8, points))
    inner = inside(field)
    assert field(inner) == pytest.approx(inner**3, abs=1e-10)


@pytest.mark.parametrize("axis", range(3))
def test_each_component_grows_along_its_axis_alone(axis):
    """Component k + 1 grows along axis k: swapped axes or components would show."""

    def velocity(p):
        out = np.zeros_like(p)
        out[:, (axis + 1) % 3] = 2.0 * p[:, axis]
        return out

    field = gridded(velocity)
    a, b = np.zeros((1, 3)), np.zeros((1, 3))
    b[0, axis] = 0.37
    expected = np.zeros(3)
    expected[(axis + 1) % 3] = 0.74
    assert (field(b) - field(a))[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("outside", "order"), [("error", 6), ("periodic", 4)])
def test_the_error_falls_with_its_power_of_the_spacing(outside, order):
    exact, errors = flow("abc", wavelength_mm=4.0), []
    points = RNG.uniform(0.0, 3.5, (500, 3))
    for n in (16, 32):
        field = gridded(exact, (n,) * 3, (0.0,) * 3, (4.0 / n,) * 3, outside=outside)
        errors.append(np.abs(field(points) - exact(points)).max())
    assert errors[0] / errors[1] > 2 ** (order - 0.5)


def solenoidal(points=(12, 10, 8), spacing=(0.5, 0.4, 0.7)):
    """Random velocities, each mode on its own free of divergence: the hardest case, up to the grid's limit."""
    values = RNG.standard_normal((3, *points[::-1]))
    k = [2.0 * np.pi * np.fft.fftfreq(n, h) for n, h in zip(points, spacing, strict=True)]
    k = np.stack(np.meshgrid(*k[::-1], indexing="ij")[::-1])
    modes = np.fft.fftn(values, axes=(1, 2, 3))
    modes -= k * (k * modes).sum(0) / np.maximum((k**2).sum(0), 1e-9)
    for axis, n in zip((3, 2, 1), points, strict=True):  # a mode of two points a wave has no sign
        np.moveaxis(modes, axis, 0)[n // 2] = 0.0
    return np.moveaxis(np.fft.ifftn(modes, axes=(1, 2, 3)).real, 0, -1), spacing


def test_a_periodic_field_free_of_divergence_stays_so_between_its_points():
    values, spacing = solenoidal()
    field = GriddedVelocity(values, (0.0,) * 3, spacing, "periodic")
    g = gradient(field, RNG.uniform(-5, 5, (300, 3)))
    assert np.abs(g).max() > 1e3
    assert np.abs(np.trace(g, axis1=1, axis2=2)).max() < 1e-7 * np.abs(g).max()


def test_other_fields_gain_little_divergence():
    """Six points a wavelength, each component depends on all three coordinates; worse within three points of a face."""
    k = 2.0 * np.pi / 3.0

    def exact(p):
        x, y, z = k * p.T
        cycle = [(x, y, z), (y, z, x), (z, x, y)]
        return np.stack([np.sin(a) * (np.cos(b) - np.cos(c)) * 0.1 for a, b, c in cycle], -1)

    field = gridded(exact, (13,) * 3, (0.0,) * 3, (0.5,) * 3)
    for points, most in [(RNG.uniform(1.5, 4.5, (300, 3)), 1e-2), (RNG.uniform(0.0, 6.0, (300, 3)), 0.2)]:
        g = gradient(field, points)
        assert np.abs(np.trace(g, axis1=1, axis2=2)).max() < most * np.abs(g).max()


def test_periodic_is_the_same_one_period_away_and_across_the_seam():
    exact = flow("abc", wavelength_mm=4.0)
    field = gridded(exact, (16,) * 3, (-2.0,) * 3, (0.25,) * 3, outside="periodic")
    points = RNG.uniform(-10, 10, (300, 3))
    assert field(points) == pytest.approx(exact(points), abs=1e-4)
    assert field(points + np.array([4.0, -8.0, 12.0])) == pytest.approx(field(points), abs=1e-12)


def test_particles_follow_a_gridded_rotation_and_come_back():
    field = gridded(flow("rotation", rate_rad_s=80.0), (12,) * 3, (-3.0,) * 3, (0.5,) * 3)
    turned = advect(field, [[0.0, 1.0, 2.0]], 0.01)
    assert turned == pytest.approx(np.array([[2 * np.sin(0.8), 1.0, 2 * np.cos(0.8)]]), abs=1e-5)
    assert advect(field, turned, -0.01) == pytest.approx(np.array([[0.0, 1.0, 2.0]]), abs=1e-5)


def test_points_outside_are_refused_or_still():
    def one(p):
        return np.ones_like(p)

    with pytest.raises(PlenoPIVError, match=r"y = 0\.000 to 1\.700 mm .* holds y = -2\.000 to 1\.600 mm; .*at_mm"):
        gridded(one)(np.array([[0.0, 0.0, 0.0], [0.0, 1.7, 0.0]]))
    still = gridded(one, outside="zero")
    assert still(np.array([[2.5, 0.0, 0.0], [2.51, 0.0, 0.0]])) == pytest.approx(np.array([[1.0] * 3, [0.0] * 3]))


def test_too_few_points_and_holes_are_told():
    with pytest.raises(PlenoPIVError, match="3 points along y; splines need 4"):
        gridded(lambda p: p, (6, 3, 6))
    with pytest.raises(PlenoPIVError, match="10 of 1080 grid points are NaN"):
        gridded(lambda p: np.where(np.arange(len(p))[:, None] < 10, np.nan, p))
