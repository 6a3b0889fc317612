"""Derivatives of a velocity field: signs, units, closed forms."""

from itertools import product

import numpy as np
import pytest
import xarray as xr

from plenopiv.errors import PlenoPIVError
from plenopiv.velocity import q_criterion, velocity_gradient, vorticity

X, Y, Z = np.linspace(-2, 2, 9), np.linspace(-1, 1.5, 6), np.linspace(-3, 3, 7)  # mm


def on_grid(flow, x=X, y=Y, z=Z):
    """A flow of (x, y, z) in metres as a field on (z, y, x)."""
    zz, yy, xx = np.meshgrid(z * 1e-3, y * 1e-3, x * 1e-3, indexing="ij")
    uvw = np.broadcast_arrays(*flow(xx, yy, zz), xx)[:3]
    return xr.Dataset({n: (("z", "y", "x"), c) for n, c in zip("uvw", uvw, strict=True)}, {"x": x, "y": y, "z": z})


@pytest.mark.parametrize(("i", "j"), list(product(range(3), range(3))))
def test_each_component_along_each_axis(i, j):
    def flow(*place):
        return tuple(70.0 * place[j] if k == i else 0.0 for k in range(3))

    expected = np.zeros((3, 3))
    expected[i, j] = 70.0  # 1/s
    gradient = velocity_gradient(on_grid(flow))
    np.testing.assert_allclose(gradient, expected[..., None, None, None] * np.ones(gradient.shape[2:]), atol=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_a_solid_rotation_has_twice_its_rate_as_vorticity_and_its_square_as_q(axis):
    rate = np.zeros(3)
    rate[axis] = 80.0

    def flow(x, y, z):  # rate x place, the right-hand rule
        a, b, c = rate
        return b * z - c * y, c * x - a * z, a * y - b * x

    gradient = velocity_gradient(on_grid(flow))
    np.testing.assert_allclose(vorticity(gradient).reshape(3, -1).T, np.tile(2 * rate, (gradient[0, 0].size, 1)))
    np.testing.assert_allclose(q_criterion(gradient), 80.0**2)


def test_shear_turns_and_deforms_alike_and_pure_strain_only_deforms():
    assert np.abs(q_criterion(velocity_gradient(on_grid(lambda x, y, z: (50 * z, 0, 0))))).max() < 1e-6
    strain = velocity_gradient(on_grid(lambda x, y, z: (30 * x, -30 * y, 0)))
    np.testing.assert_allclose(q_criterion(strain), -(30.0**2))
    np.testing.assert_allclose(vorticity(strain), 0, atol=1e-9)


def test_an_abc_flow_is_its_own_vorticity_to_second_order():
    """curl v = k v (Beltrami); errors fall fourfold with half the spacing."""
    k = 2 * np.pi / 4e-3

    def flow(x, y, z):
        return (
            1.0 * np.sin(k * z) + 0.5 * np.cos(k * y),
            0.7 * np.sin(k * x) + 1.0 * np.cos(k * z),
            0.5 * np.sin(k * y) + 0.7 * np.cos(k * x),
        )

    errors = []
    for n in (17, 33):
        axis = np.linspace(-1.5, 1.5, n)
        field = on_grid(flow, axis, axis, axis)
        turning = vorticity(velocity_gradient(field))
        exact = k * np.stack([field[name].values for name in "uvw"])
        errors.append(np.abs(turning - exact)[:, 2:-2, 2:-2, 2:-2].max() / np.abs(exact).max())
    assert errors[1] < 0.02
    assert 3.2 < errors[0] / errors[1] < 5.0


def test_missing_vectors_spread_no_further_than_their_neighbours():
    field = on_grid(lambda x, y, z: (0, 0, 60 * x))
    field["w"][3, 2, 4] = np.nan
    gradient = velocity_gradient(field)
    missing = np.argwhere(np.isnan(gradient[2, 0]))
    assert missing.tolist() == [[3, 2, 3], [3, 2, 4], [3, 2, 5]]  # of its own too: a body has none
    assert np.isfinite(gradient[:2]).all()


def test_a_single_plane_has_no_derivative():
    with pytest.raises(PlenoPIVError, match="one vector along z"):
        velocity_gradient(on_grid(lambda x, y, z: (x, y, z), z=np.array([0.0])))
    with pytest.raises(PlenoPIVError, match=r"isel\(time=0\)"):
        velocity_gradient(on_grid(lambda x, y, z: (x, y, z)).expand_dims("time"))
