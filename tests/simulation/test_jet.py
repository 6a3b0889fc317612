"""The jet that is shipped: where it lies, which way it flows, its divergence; and a recording of it."""

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import advect, describe, flow

ROOT = Path(__file__).parents[2]
RNG = np.random.default_rng(0)
U_M_S = 2500.0 / 6.0 * 1e-3  # Re nu / D, nu = 1 mm^2/s


@pytest.fixture(scope="module")
def jet():
    return flow("jet")


def cylinder(radius, n=4000):
    """Points on a cylinder about the jet's axis."""
    a = RNG.uniform(0, 2 * np.pi, n)
    return np.stack([RNG.uniform(-18, 18, n), radius * np.cos(a), radius * np.sin(a)], -1)


def gradient(velocity, points_mm, h=1e-3):
    """du_i/dx_j in 1/s by central differences; (n, 3, 3)."""
    steps = h * np.eye(3)
    return np.stack([(velocity(points_mm + s) - velocity(points_mm - s)) * 1e3 / (2 * h) for s in steps], -1)


def test_it_flows_along_x_and_only_about_its_axis(jet):
    axis, edge, far = (jet(cylinder(r)).mean(0) for r in (0.0, 3.0, 9.0))
    assert 0.5 * U_M_S < axis[0] < 1.05 * U_M_S
    assert 0.2 * U_M_S < edge[0] < 0.8 * U_M_S
    assert abs(far[0]) < 0.05 * U_M_S
    assert max(abs(axis[1:]).max(), abs(edge[1:]).max(), abs(far[1:]).max()) < 0.05 * U_M_S


def test_its_momentum_is_that_of_the_column_it_began_as(jet):
    """Volume flux is conserved in a temporal jet: pi D^2 / 4 U, a little more for a tanh layer (0.05 D) than a step."""
    x, y, z = RNG.uniform(-18, 18, 60_000), RNG.uniform(-12, 12, 60_000), RNG.uniform(-12, 12, 60_000)
    flux = jet(np.stack([x, y, z], -1))[:, 0].mean() * 24.0**2
    r = np.linspace(0, 12, 4000)
    profile = 0.5 * (1 - np.tanh((r - 3.0) / 0.3)) * 2 * np.pi * r
    assert flux == pytest.approx(U_M_S * profile.sum() * (r[1] - r[0]), rel=0.03)


def test_it_is_free_of_divergence_through_the_sampler(jet):
    points = np.concatenate([cylinder(r, 1500) for r in (2.0, 3.0, 4.0, 5.0)])
    g = gradient(jet, points)
    assert np.abs(g).max() > 5.0 * U_M_S / 6e-3
    assert np.abs(np.trace(g, axis1=1, axis2=2)).max() < 4e-3 * np.abs(g).max()


def test_u_falls_outward_on_every_side(jet):
    x = RNG.uniform(-18, 18, 3000)
    for axis in (1, 2):
        for side in (-1.0, 1.0):
            inner, outer = np.zeros((2, 3000, 3))
            inner[:, 0] = outer[:, 0] = x
            inner[:, axis], outer[:, axis] = 1.0 * side, 5.0 * side
            assert (jet(inner) - jet(outer))[:, 0].mean() > 0.4 * U_M_S


def test_it_is_periodic(jet):
    points = cylinder(3.0, 200)
    for shift in np.diag([36.0, -24.0, 24.0]):
        assert jet(points + shift) == pytest.approx(jet(points), abs=1e-9)


def test_at_mm_moves_the_camera_to_the_shear_layer(jet):
    points = RNG.uniform(-1, 1, (100, 3))
    moved = flow("jet", at_mm=[4.0, 3.0, -1.0], speed=0.5)
    assert moved(points) == pytest.approx(0.5 * jet(points + np.array([4.0, 3.0, -1.0])), abs=1e-12)
    assert describe(moved) == ("jet", {"at_mm": (4.0, 3.0, -1.0), "speed": 0.5})
    with pytest.raises(PlenoPIVError, match="at_mm"):
        flow("jet", at_mm=[1.0])


def test_particles_come_back(jet):
    points = cylinder(2.5, 200)
    there = advect(jet, points, 5e-4)
    assert np.abs(there - points)[:, 0].max() > 0.15  # mm
    assert advect(jet, there, -5e-4) == pytest.approx(points, abs=1e-6)


def test_a_flow_is_named_without_loading_scipy_or_xarray():
    program = (
        "import sys; from plenopiv.simulation.flows import flow; flow('uniform'); "
        "print({'scipy', 'xarray', 'numba', 'matplotlib', 'h5py'} & set(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "set()\n"


@pytest.mark.full
def test_the_file_is_in_the_wheel(tmp_path):
    build = "from setuptools.build_meta import build_wheel; import sys; build_wheel(sys.argv[1])"
    copy = [sys.executable, "-c", "import shutil, sys; shutil.copytree(*sys.argv[1:], ignore=shutil.ignore_patterns("
            "'.*', 'build', 'paper', '*.egg-info'))", str(ROOT), str(tmp_path / "copy")]  # fmt: skip
    subprocess.run(copy, check=True)
    made = subprocess.run([sys.executable, "-c", build, str(tmp_path)], cwd=tmp_path / "copy", capture_output=True)
    assert made.returncode == 0, made.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert file.getinfo("plenopiv/simulation/jet.nc").file_size > 1e6
