"""The comparison of LF-PIV and Tomo-PIV on a volume of a few vectors, and its parts against closed forms."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import comparison
import comparison_costs
import comparison_figures
import comparison_scores as scores
import lightfield_case
import tomo_case
from comparison_settings import DT_S, FULL, SIZES, TINY
from isosurface import isosurface

from plenopiv.simulation.flows import flow
from plenopiv.simulation.particles import Particles

pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    out = tmp_path_factory.mktemp("comparison")
    return out, comparison.main("tiny", out, isolated=False)


def test_everything_is_written(tiny):
    out, cases = tiny
    written = json.loads((out / "paper/results/comparison.json").read_text())
    assert written["size"] == "tiny"
    assert set(written["cases"]) == set(cases) == set(comparison.TITLES)
    told = (out / "paper/results/comparison.md").read_text()
    for title in comparison.TITLES.values():
        assert title in told
    for picture in ("slices", "errors", "vortices"):
        size = (out / f"docs/images/paper/comparison-{picture}.png").stat().st_size
        assert 8_000 < size < 200_000


def test_figures_of_fields_that_are_there(tiny, tmp_path):
    out, _ = tiny
    results = json.loads((out / "paper/results/comparison.json").read_text())
    for name in ("light_field", "tomo"):
        (tmp_path / f"tiny-{name}.nc").symlink_to(out / f"build/comparison/tiny-{name}.nc")
    missing = comparison_figures.draw(results, TINY, tmp_path, tmp_path / "two", "c")
    assert missing == ["light_field_inner", "two", "matched"]
    assert {file.name for file in (tmp_path / "two").iterdir()} == {"c-slices.png", "c-errors.png", "c-vortices.png"}
    (tmp_path / "tiny-light_field.nc").unlink()
    assert comparison_figures.draw(results, TINY, tmp_path, tmp_path / "none", "c") == list(comparison_figures.DRAWN)
    assert [file.name for file in (tmp_path / "none").iterdir()] == ["c-errors.png"]


def test_what_is_kept_of_a_field(tiny, tmp_path):
    fields = tiny[0] / "build/comparison"
    comparison_figures.keep(fields, TINY, "light_field", tmp_path)
    whole, kept = (comparison_figures.shown(folder, TINY, "light_field") for folder in (fields, tmp_path))
    for name in ("u", "w", "v_true"):
        assert float(np.abs(whole[name] - kept[name]).max()) <= 0.51e-4
    np.testing.assert_array_equal(whole.judged, kept.judged)
    assert (tmp_path / "tiny-light_field.nc").stat().st_size < (fields / "tiny-light_field.nc").stat().st_size
    with pytest.raises(FileNotFoundError, match="measure it first"):
        comparison_figures.shown(tmp_path, TINY, "tomo")


@pytest.mark.parametrize("name", comparison.TITLES)
def test_every_method_sees_the_jet(tiny, name):
    out, cases = tiny
    along_x, along_y, along_z = cases[name]["correlation_with_window_mean"]
    assert along_x > 0.9
    assert min(along_y, along_z) > 0.4
    with xr.open_dataset(out / f"build/comparison/tiny-{name}.nc", engine="h5netcdf") as field:
        below, above = field.u.isel(y=0).mean(), field.u.isel(y=-1).mean()
        assert field.u_true.isel(y=0).mean() > 0.2 > 0.15 > field.u_true.isel(y=-1).mean()
        assert float(below) > 0.2 > 0.15 > float(above)


@pytest.mark.parametrize("name", comparison.TITLES)
def test_numbers_hang_together(tiny, name):
    told = tiny[1][name]
    everywhere = told["errors"]["window_mean"]["all"]
    assert everywhere["vectors"] == told["vectors"] <= told["of_vectors"]
    assert 0.0 < told["candidates"] < 1.0
    assert told["particles_per_window"] > 8
    for axis, side in enumerate(told["voxel_mm"]):
        assert everywhere["rms_percent"][axis] == pytest.approx(everywhere["rms_mm_s"][axis] / 416.7 * 100, rel=1e-3)
        if everywhere["gross"] == 0:
            in_mm_s = everywhere["rms_voxel"][axis] * side / DT_S
            assert everywhere["rms_mm_s"][axis] == pytest.approx(in_mm_s)
    assert max(everywhere["rms_percent"]) < 15
    assert everywhere["inside_1_std"] <= everywhere["inside_2_std"]


def test_what_was_measured_at_the_reduced_size():
    """LF-PIV keeps its promises up to 6 mm where its windows resolve the flow; where they do not, exact volumes do not
    either."""
    measured = json.loads((Path(__file__).parents[2] / "paper/results/comparison.json").read_text())
    assert measured["size"] in ("reduced", "full")
    light, exact = (measured["cases"][name]["errors"]["window_mean"] for name in ("light_field", "exact"))
    assert light["within"]["gross"] <= 0.05
    assert light["within"]["rms_voxel"][2] <= 0.20
    assert max(light["within, smooth"]["rms_voxel"][:2]) <= 0.12
    assert min(exact["within, not"]["rms_voxel"][:2]) > 0.12
    for axis in range(2):
        assert light["within"]["rms_voxel"][axis] < 1.25 * exact["within"]["rms_voxel"][axis]


def test_matched_windows_are_as_large_in_mm():
    light, tomo = FULL.light_field, FULL.matched
    for one, other in zip(light.windows, tomo.windows, strict=True):
        there = np.array(one) * light.grid.voxel_mm
        np.testing.assert_allclose(np.array(other) * tomo.scale_mm_px, there, atol=tomo.scale_mm_px)


def test_the_full_size_is_the_paper_s():
    assert FULL.light_field.grid.shape == (260, 1400, 2100)
    n = len(tomo_case.seeded(FULL.tomo, flow("uniform"), np.random.default_rng(0))[0].electrons)
    assert n == round(0.05 * 36 * 24 / 0.074**2)
    for camera in tomo_case.cameras_of(FULL.matched):
        assert camera.sensor.columns == 2048


def test_announced_costs_of_the_full_size_are_those_of_the_light_field_s_measured_run():
    peak, seconds = comparison_costs.light_field_cost(FULL.light_field)
    assert 2e9 < peak < 4e9  # docs/accuracy.md, Full size: 2.8 GB
    assert 300 < seconds < 3000
    told = comparison_costs.announced(FULL, comparison.MEASUREMENTS)
    assert tuple(told) == comparison.MEASUREMENTS
    assert told["light_field"].startswith(f"2100 x 1400 x 260 voxels, about {peak / 1e9:.1f} GB and ")


def test_both_methods_see_the_same_particles_when_matched():
    jet = flow("jet", at_mm=TINY.jet_at_mm)
    of_light = lightfield_case.seeded(TINY.light_field, jet, 0)
    of_tomo = tomo_case.as_bright(lightfield_case.seeded(TINY.light_field, jet, 0))
    for one, other in zip(of_light, of_tomo, strict=True):
        np.testing.assert_array_equal(one.position_mm, other.position_mm)
    assert of_tomo[0].electrons.mean() == pytest.approx(tomo_case.ELECTRONS)
    moved = of_light[1].position_mm - of_light[0].position_mm
    middle = 0.5 * (of_light[1].position_mm + of_light[0].position_mm)
    np.testing.assert_allclose(moved, jet(middle) * 1e3 * DT_S, atol=4e-3)


def parabola(points_mm):
    """u = 0.01 y^2 m/s per mm^2."""
    out = np.zeros_like(points_mm)
    out[:, 0] = 0.01 * points_mm[:, 1] ** 2
    return out


def test_window_mean_of_a_parabola():
    at, half = np.array([[0.3, 1.0, -2.0], [0.0, 0.0, 0.0]]), np.array([0.5, 0.6, 0.7])
    mean, unresolved = scores.window_mean(parabola, at, half)
    h2 = 0.6**2 / 3 * (1 - scores.SAMPLES**-2)  # the midpoint rule's own mean of y^2
    np.testing.assert_allclose(mean[:, 0], 1e3 * DT_S * 0.01 * (at[:, 1] ** 2 + h2), rtol=1e-9)
    np.testing.assert_array_equal(mean[:, 1:], 0.0)
    fourth = np.mean(np.linspace(-0.48, 0.48, 5) ** 4)  # of the five places along y; what is left is y^2 less its mean
    np.testing.assert_allclose(unresolved, 1e3 * DT_S * 0.01 * np.sqrt(fourth - h2**2), rtol=1e-6)
    point = scores.point_displacement(parabola, at)
    np.testing.assert_allclose(point[:, 0], 1e3 * DT_S * 0.01 * at[:, 1] ** 2, rtol=1e-9)


AXES = np.linspace(-1.0, 1.0, 5), np.linspace(-2.0, 1.0, 6), np.linspace(0.0, 3.0, 7)


def turned_about(axis):
    """Solid rotation of 10 rad/s, right-handed, (3, nz, ny, nx) in m/s."""
    z, y, x = np.meshgrid(*AXES[::-1], indexing="ij")
    return np.cross(10.0 * np.eye(3)[axis], np.stack([x, y, z], -1) * 1e-3).transpose(3, 0, 1, 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_vorticity_and_q_of_solid_rotation(axis):
    velocity = turned_about(axis)
    expected = np.zeros(3)
    expected[axis] = 20.0
    found = scores.vorticity(velocity, *AXES)
    np.testing.assert_allclose(found, np.broadcast_to(expected[:, None, None, None], found.shape), atol=1e-9)
    dims = ("z", "y", "x")
    field = xr.Dataset(
        {c: (dims, v) for c, v in zip("uvw", velocity, strict=True)}, dict(zip("xyz", AXES, strict=True))
    )
    np.testing.assert_allclose(comparison_figures.turning(field), 100.0)
    strained = field.assign(u=field.x * 1e-3 + 0 * field.u, v=-field.y * 1e-3 + 0 * field.u, w=0 * field.u)
    np.testing.assert_allclose(comparison_figures.turning(strained), -1.0)


def test_vectors_inside_have_all_their_neighbours():
    chosen = np.ones((4, 5, 6), bool)
    chosen[1, 2, 3] = False
    expected = np.zeros_like(chosen)
    expected[1:-1, 1:-1, 1:-1] = True
    for k, j, i in ((1, 2, 3), (2, 2, 3), (1, 1, 3), (1, 3, 3), (1, 2, 2), (1, 2, 4)):
        expected[k, j, i] = False
    np.testing.assert_array_equal(scores.inner(chosen), expected)


def test_errors_of_known_vectors():
    voxel = np.array([0.02, 0.02, 0.08])
    off = np.array([[0.01, 0.0, 0.08], [-0.01, 0.0, 0.0], [0.0, 0.1, 0.0]])  # the last 5 voxels off
    told = scores.errors(off, np.full((3, 3), 0.02), np.array([False, True, True]), voxel)
    assert told["gross"] == pytest.approx(1 / 3)
    assert told["replaced"] == pytest.approx(2 / 3)
    np.testing.assert_allclose(told["rms_voxel"], [0.5, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(told["bias_voxel"], [0.0, 0.0, 0.5])
    np.testing.assert_allclose(told["rms_mm_s"], np.sqrt((off**2).mean(0)) / DT_S)
    np.testing.assert_allclose(told["inside_1_std"], [1.0, 2 / 3, 2 / 3])
    np.testing.assert_allclose(told["stated_mm_s"], 40.0)


def bent(points_mm):
    """The parabola, and v and w that change evenly along x and y."""
    return parabola(points_mm) + 0.001 * points_mm[:, [0, 0, 1]] * [0, 1, 1]


def measured_exactly(flow, half_mm, off_m_s=0.0):
    """Vectors whose u is the flow's at the vector and ``off_m_s`` more, and two thousand particles."""
    z, y, x = np.meshgrid(*AXES[::-1], indexing="ij")
    velocity = flow(np.stack([x, y, z], -1).reshape(-1, 3)).T.reshape(3, *z.shape) + off_m_s
    named = {"u": velocity[0], "v": velocity[1], "w": velocity[2]}
    named |= {f"{c}_std": np.full(z.shape, 0.01) for c in "uvw"} | {"valid": np.ones(z.shape)}
    dims, rng = ("z", "y", "x"), np.random.default_rng(0)
    field = xr.Dataset({c: (dims, v) for c, v in named.items()}, dict(zip("xyz", AXES, strict=True)))
    middle = rng.uniform(-4.0, 4.0, (2000, 3))
    moved = 0.5e3 * DT_S * flow(middle)
    pair = tuple(Particles(middle + sign * moved, np.ones(2000)) for sign in (-1, 1))
    seen, clock = np.ones(z.shape, bool), lightfield_case.Clock()
    return lightfield_case.Measured(field, pair, (0.02, 0.02, 0.08), half_mm, seen, 0.1, clock)


def test_a_judge_finds_what_is_true_once_for_the_same_windows():
    asked = []

    def flow(points_mm):
        asked.append(len(points_mm))
        return bent(points_mm)

    judge, half = scores.Judge(flow, ((-9.0, 9.0), (-1.5, 9.0))), np.array([0.5, 0.6, 0.7])
    told, true = judge.score(measured_exactly(bent, half))
    n, h2 = len(asked), 0.6**2 / 3 * (1 - scores.SAMPLES**-2)
    chosen = AXES[1] - 0.6 >= -1.5
    assert told["vectors"] == chosen.sum() * AXES[0].size * AXES[2].size
    np.testing.assert_allclose(true[0][:, chosen, 0], np.tile(0.01 * (AXES[1][chosen] ** 2 + h2), (7, 1)), rtol=1e-6)
    assert np.isnan(true[:, :, ~chosen]).all()
    of = {name: e["all"] for name, e in told["errors"].items()}
    np.testing.assert_allclose(of["window_mean"]["rms_mm_s"], [10 * h2, 0, 0], atol=1e-4)
    np.testing.assert_allclose(of["point"]["rms_mm_s"], 0.0, atol=1e-4)
    again, _ = judge.score(measured_exactly(bent, half, 0.001))
    assert len(asked) == n
    np.testing.assert_allclose(again["errors"]["point"]["all"]["bias_mm_s"], 1.0, rtol=1e-4)
    judge.score(measured_exactly(bent, half * 0.9))
    assert len(asked) > n


def test_only_windows_within_the_limits_are_judged(tiny):
    result = tiny[0] / "build/comparison/tiny-tomo.nc"
    with xr.open_dataset(result, engine="h5netcdf") as field:
        assert field.judged.values.all()
        half = 0.5 * 24 * TINY.tomo.scale_mm_px
        seen = tomo_case.windows_seen(tomo_case.cameras_of(TINY.tomo), field, np.full(3, half))
        assert seen.all()
        assert not tomo_case.windows_seen(tomo_case.cameras_of(TINY.tomo), field, np.full(3, 6.0)).any()
        camera = lightfield_case.camera_of(TINY.light_field)
        at = tuple(field[c].values for c in "xyz")
        inside = lightfield_case.windows_seen(camera, (*at[:2], np.linspace(1, 3, field.z.size)), np.zeros(3))
        assert inside[:, 1:-1, 1:-1].all()
        assert not lightfield_case.windows_seen(camera, at, np.full(3, 2.5)).any()


def test_an_isosurface_is_closed_and_points_outward():
    axis = np.linspace(-1.3, 1.3, 31)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    triangles = isosurface(1 - x**2 - y**2 - z**2, 0.0, (axis, axis, axis))
    a, b, c = triangles.transpose(1, 0, 2)
    normal = 0.5 * np.cross(b - a, c - a)
    assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(4 * np.pi, rel=0.01)
    assert (normal * triangles.mean(1)).sum() / 3 == pytest.approx(4 / 3 * np.pi, rel=0.01)  # divergence theorem
    np.testing.assert_allclose(normal.sum(0), 0.0, atol=1e-9)
    assert isosurface(x, 5.0, (axis, axis, axis)).shape == (0, 3, 3)
    at_x = isosurface(x + 0.5 * axis[1], 0.1, (axis, axis + 1.0, axis))[..., 0]
    np.testing.assert_allclose(at_x, 0.1 - 0.5 * axis[1])


def test_sizes_go_by_their_names():
    assert list(SIZES) == ["full", "reduced", "tiny"]


def test_a_comparison_that_was_ended_goes_on(tiny, tmp_path, monkeypatch):
    """After the first field of two it goes on with the volumes that are kept, to the same numbers."""
    _, cases = tiny
    measured = comparison.case

    def ended(title, *rest):
        if title.endswith("_inner"):
            raise KeyboardInterrupt
        return measured(title, *rest)

    monkeypatch.setattr(comparison, "case", ended)
    with pytest.raises(KeyboardInterrupt):
        comparison.main("tiny", tmp_path, isolated=False, only=("light_field",))
    assert len(list((tmp_path / "build/comparison").glob("*.volumes"))) == 1
    monkeypatch.setattr(comparison, "case", measured)
    monkeypatch.setattr(comparison, "reconstructed", None)  # not called again
    again = comparison.main("tiny", tmp_path, isolated=False, only=("light_field",))
    assert not list((tmp_path / "build/comparison").glob("*.volumes"))
    for title in ("light_field", "light_field_inner"):
        assert again[title]["errors"] == cases[title]["errors"]
