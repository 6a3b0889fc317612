"""The scripts that made the jet: its first profile, its resolution, and what the page says of it."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "paper" / "jet"))

import draw  # noqa: E402
import snapshot  # noqa: E402
import solve  # noqa: E402

pytestmark = pytest.mark.full

BOX = (2 * np.pi, 4 * np.pi, 2 * np.pi)
SHAPE = (20, 40, 24)  # z, y, x
REPORT = json.loads((ROOT / "paper" / "jet" / "resolution.json").read_text())


def mesh():
    """x, y, z of a box with one wave along x and z and half of one along y for each 2 pi."""
    axes = [np.arange(n) * length / n for n, length in zip(SHAPE[::-1], BOX, strict=True)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    return x, y, z


def test_the_column_s_momentum_thickness_is_d_over_40():
    r = np.linspace(0.0, 2.0, 20001)
    u = solve.column(np.zeros(1), r, np.zeros(1))
    assert np.sum(u * (1 - u)) * (r[1] - r[0]) == pytest.approx(1 / 40, rel=1e-3)
    assert u[0] == pytest.approx(1.0, abs=1e-6)
    assert u[5000] == pytest.approx(0.5)


def test_noise_is_in_the_layer_alone_and_of_its_strength():
    shape, box = (48, 48, 72), solve.BOX
    axes = [(np.arange(n) - n // 2) * length / n for n, length in zip(shape[::-1], box, strict=True)]
    z, y, _ = np.meshgrid(*axes[::-1], indexing="ij", sparse=True)
    k = snapshot.wavenumbers(shape, box)
    r = np.broadcast_to(np.sqrt(y**2 + z**2), shape)
    for component in solve.noise(shape, k, y, z, np.random.default_rng(1)):
        assert component[np.abs(r - 0.5) < 0.03].std() == pytest.approx(solve.NOISE, rel=0.2)
        assert np.abs(component[np.abs(r - 0.5) > 0.4]).max() < 1e-4


def taylor_green():
    """u = cos x sin y, v = -sin x cos y, as a state of the solver: |k| = sqrt 2, energy 1/4, mean |S|^2 = 1/2."""
    x, y, z = mesh()
    zero = np.zeros_like(z)
    return {"vx": np.cos(x) * np.sin(y), "vy": -np.sin(x) * np.cos(y), "vz": zero}


def test_gradients_have_their_signs_and_places():
    x, y, z = mesh()
    velocity = [np.sin(z) + 0 * x, np.sin(x) + 0 * z, np.sin(0.5 * y) + 0 * x]
    g = snapshot.gradients(velocity, BOX)
    expected = np.zeros_like(g)
    expected[0, 2], expected[1, 0], expected[2, 1] = np.cos(z), np.cos(x), 0.5 * np.cos(0.5 * y)
    assert g == pytest.approx(expected, abs=1e-12)
    spacing_mm = [1e3 * length / n for n, length in zip(SHAPE[::-1], BOX, strict=True)]  # so that 1/s come out
    assert draw.gradients(np.stack(velocity, -1), spacing_mm) == pytest.approx(expected, abs=2e-4)


def test_the_spectrum_holds_the_energy_where_it_is():
    k, energy = snapshot.spectrum(list(taylor_green().values()), BOX)
    assert k[0] == snapshot.BAND / 2
    assert energy[0] * snapshot.BAND == pytest.approx(0.25)
    assert energy[1:] == pytest.approx(0.0)


def test_resolution_of_a_taylor_green_flow():
    reynolds = 100.0
    state = {**taylor_green(), "box": np.array(BOX), "reynolds": reynolds, "t": 3.0, "layer": 0.05, "processor_s": 1.0}
    told = snapshot.resolution(state)
    assert told["divergence_of_the_solver_over_largest_gradient"] < 1e-12
    assert told["largest_gradient_U_D"] == pytest.approx(1.0, rel=0.02)
    # S_xx = -sin x sin y = -S_yy, S_xy = 0: dissipation 4 / Re sin^2 x sin^2 y
    assert told["dissipation_U3_D"]["largest"] == pytest.approx(4.0 / reynolds, rel=0.02)
    kolmogorov = (reynolds**-3 / told["dissipation_U3_D"]["largest"]) ** 0.25
    assert told["spacing_over_kolmogorov_length"]["largest"] == pytest.approx(told["spacing_D"] / kolmogorov)


def test_the_page_says_what_was_measured():
    page = " ".join((ROOT / "docs" / "jet.md").read_text().split())
    resolved = REPORT["largest_wavenumber_times_kolmogorov_length"]
    spacing = REPORT["spacing_over_kolmogorov_length"]
    through = REPORT["divergence_through_the_sampler"]
    for words in (
        f"Kolmogorov length: {resolved['mean_in_jet']:.2f} with",
        f"{resolved['half_of_it_above']:.2f} at the rate",
        f"{resolved['largest']:.2f} at its maximum",
        f"{spacing['mean_in_jet']:.1f}, {spacing['half_of_it_above']:.1f}, {spacing['largest']:.1f}",
        f"t = {REPORT['t_D_U']:.0f} D/U",
        f"{REPORT['megabytes']:.1f} MB",
        f"{through['as_stored']['largest']:.4f} of the largest gradient",
        f"{REPORT['mean_u_on_the_axis_U']:.2f} U on the mean",
    ):
        assert words in page, words
    grid = REPORT["grid_x_y_z"]
    assert f"{grid[0]} x {grid[1]} x {grid[2]} points" in page
    assert (ROOT / "src/plenopiv/simulation/jet.nc").stat().st_size == round(REPORT["megabytes"] * 1e6)


def test_the_table_of_samplers_is_what_was_measured():
    page = (ROOT / "docs" / "decisions" / "0020-splines-of-mixed-degree.md").read_text()
    rows = json.loads((ROOT / "paper" / "jet" / "samplers.json").read_text())
    for name, row in rows.items():
        (line,) = [text for text in page.splitlines() if text.startswith(f"| {name}")]
        cells = [cell.strip() for cell in line.split("|")[2:-1]]
        for cell, key in zip(cells, ("largest", "rms", "us_for_a_point"), strict=True):
            assert float(cell) == pytest.approx(row[key], rel=0.5 if row[key] < 1e-6 else 0.1)
