"""Analytic flows against closed forms; all divergence-free; advection of fourth order."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import ANALYTIC, advect, describe, flow

POINTS = np.random.default_rng(0).uniform(-3, 3, (200, 3))


def gradient(velocity, points_mm, h=1e-4):
    """du_i/dx_j in 1/s by central differences; (n, 3, 3)."""
    columns = []
    for j in range(3):
        step = np.zeros(3)
        step[j] = h
        columns.append((velocity(points_mm + step) - velocity(points_mm - step)) * 1e3 / (2 * h))
    return np.stack(columns, -1)


@pytest.mark.parametrize("name", list(ANALYTIC))
def test_divergence_free(name):
    g = gradient(flow(name), POINTS)
    assert np.abs(np.trace(g, axis1=1, axis2=2)).max() <= 1e-5 * max(np.abs(g).max(), 1.0)


@pytest.mark.parametrize("name", list(ANALYTIC))
def test_drift_is_added(name):
    if name == "uniform":
        assert flow(name, velocity_m_s=(1.0, 2.0, 3.0))(POINTS) == pytest.approx(np.tile([1.0, 2.0, 3.0], (200, 1)))
    else:
        drifting, still = flow(name, drift_m_s=(1.0, 2.0, 3.0)), flow(name)
        assert drifting(POINTS) - still(POINTS) == pytest.approx(np.tile([1.0, 2.0, 3.0], (200, 1)))


def test_uniform_displacement_in_mm():
    # 0.1 m/s for 0.5 ms is 0.05 mm
    moved = advect(flow("uniform", velocity_m_s=(0.1, 0.0, 0.0)), [[1.0, 2.0, 3.0]], 5e-4)
    assert moved == pytest.approx(np.array([[1.05, 2.0, 3.0]]))


def test_shear_moves_one_component_along_another():
    v = flow("shear", rate_per_s=100.0, component="z", along="y")(np.array([[1.0, 2.0, 3.0]]))
    assert v == pytest.approx(np.array([[0.0, 0.0, 0.2]]))
    with pytest.raises(PlenoPIVError, match="two different axes"):
        flow("shear", component="x", along="x")


def test_rotation_turns_z_towards_x_by_rate_times_time():
    turned = advect(flow("rotation", rate_rad_s=80.0), [[0.0, 1.0, 2.0]], 0.01)
    angle = 0.8
    assert turned == pytest.approx(np.array([[2 * np.sin(angle), 1.0, 2 * np.cos(angle)]]), abs=1e-5)


def test_rotation_s_displacement_is_that_of_the_rotation_recording():
    v = flow("rotation", rate_rad_s=80.0, drift_m_s=(0.0, 0.1, 0.0))(POINTS) * 1e3 * 5e-4
    x, _, z = POINTS.T
    assert v == pytest.approx(np.stack([0.040 * z, np.full(200, 0.05), -0.040 * x], -1))


@pytest.mark.parametrize("axis", "xyz")
def test_lamb_oseen_keeps_the_radius_and_turns_by_its_rate(axis):
    gamma, core, r, t = 500.0, 0.7, 1.3, 0.01
    k = "xyz".index(axis)
    start = np.zeros(3)
    start[(k + 1) % 3] = r
    end = advect(flow("lamb-oseen", circulation_mm2_s=gamma, core_radius_mm=core, axis=axis), start[None], t, steps=50)[
        0
    ]
    angle = gamma / (2 * np.pi * r**2) * (1 - np.exp(-(r**2) / core**2)) * t
    assert np.linalg.norm(end) == pytest.approx(r, abs=1e-8)
    assert np.arctan2(end[(k + 2) % 3], end[(k + 1) % 3]) == pytest.approx(angle, abs=1e-7)


def test_lamb_oseen_is_still_and_smooth_at_its_centre():
    v = flow("lamb-oseen", circulation_mm2_s=500.0, core_radius_mm=0.7)
    assert v(np.zeros((1, 3))) == pytest.approx(0.0)
    # solid-body core: vorticity Gamma / (pi r_c^2)
    g = gradient(v, np.zeros((1, 3)))[0]
    assert g[1, 0] - g[0, 1] == pytest.approx(500.0 / (np.pi * 0.49), rel=1e-5)


def test_vortex_ring_on_its_axis():
    v = flow("vortex-ring", circulation_mm2_s=1500.0, radius_mm=2.0, core_radius_mm=0.8, axis="x")
    x = np.linspace(-4, 4, 9)
    u = v(np.stack([x, 0 * x, 0 * x], -1))
    assert u[:, 0] == pytest.approx(1500.0 * 4.0 / (2 * (4.0 + 0.64 + x**2) ** 1.5) * 1e-3)
    assert u[:, 1:] == pytest.approx(0.0)


@pytest.mark.parametrize("axis", "xyz")
def test_vortex_ring_is_the_biot_savart_integral_of_its_filament(axis):
    gamma, radius, core, k = 1500.0, 2.0, 0.8, "xyz".index(axis)
    phi = 2 * np.pi * np.arange(400) / 400
    ring, tangent = np.zeros((400, 3)), np.zeros((400, 3))
    ring[:, (k + 1) % 3], ring[:, (k + 2) % 3] = radius * np.cos(phi), radius * np.sin(phi)
    tangent[:, (k + 1) % 3], tangent[:, (k + 2) % 3] = -radius * np.sin(phi), radius * np.cos(phi)
    r = POINTS[:, None] - ring
    kernel = np.cross(tangent, r) / ((r**2).sum(-1) + core**2)[..., None] ** 1.5
    expected = gamma / (4 * np.pi) * kernel.sum(1) * (2 * np.pi / 400) * 1e-3
    got = flow("vortex-ring", circulation_mm2_s=gamma, radius_mm=radius, core_radius_mm=core, axis=axis)(POINTS)
    assert got == pytest.approx(expected, abs=1e-9)


def test_abc_is_a_beltrami_flow():
    v = flow("abc", wavelength_mm=4.8, amplitudes_m_s=(0.1, 0.07, 0.03))
    g = gradient(v, POINTS)
    curl = np.stack([g[:, 2, 1] - g[:, 1, 2], g[:, 0, 2] - g[:, 2, 0], g[:, 1, 0] - g[:, 0, 1]], -1)
    assert curl == pytest.approx(2 * np.pi / 4.8 * v(POINTS) * 1e3, abs=1e-4)


def test_advection_is_reversible_and_of_fourth_order():
    v = flow("abc", wavelength_mm=2.0)
    exact = advect(v, POINTS, 0.01, steps=64)
    coarse, fine = (np.abs(advect(v, POINTS, 0.01, steps=n) - exact).max() for n in (2, 4))
    assert coarse / fine == pytest.approx(16.0, rel=0.35)
    assert advect(v, exact, -0.01, steps=64) == pytest.approx(POINTS, abs=1e-6)


def test_unknown_names_get_the_nearest():
    with pytest.raises(PlenoPIVError, match="'vortex-ring'"):
        flow("vortexring")
    with pytest.raises(PlenoPIVError, match="'core_radius_mm'"):
        flow("lamb-oseen", core_radius=1.0)
    with pytest.raises(PlenoPIVError, match="axis 'w'"):
        flow("lamb-oseen", axis="w")


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("uniform", "velocity_m_s", [0.1, 0.2]),
        ("uniform", "velocity_m_s", 0.1),
        ("uniform", "velocity_m_s", "abc"),
        ("shear", "drift_m_s", (0.0, np.nan, 0.0)),
        ("shear", "rate_per_s", np.inf),
        ("rotation", "rate_rad_s", "fast"),
        ("rotation", "centre_mm", [[0.0, 0.0, 0.0]]),
        ("lamb-oseen", "core_radius_mm", 0),
        ("vortex-ring", "radius_mm", 0.0),
        ("vortex-ring", "core_radius_mm", -0.8),
        ("abc", "wavelength_mm", 0.0),
        ("abc", "amplitudes_m_s", (0.1, True, 0.1)),
    ],
)
def test_parameters_that_make_no_flow_are_named(name, key, value):
    with pytest.raises(PlenoPIVError, match=f"flow: '{name}': {key} = .*; give"):
        flow(name, **{key: value})


def test_describe_names_flow_and_parameters():
    assert describe(flow("uniform", velocity_m_s=[0.1, 0, 0])) == ("uniform", {"velocity_m_s": (0.1, 0, 0)})

    def jet(points_mm):
        return points_mm

    assert describe(jet) == ("jet", {})
