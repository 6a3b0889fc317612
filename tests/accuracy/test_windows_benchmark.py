"""The benchmark of windows: what it measures in water is what it measures in air, seen through the window."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from plenopiv.cameras.lens_space import behind_window, images_of
from plenopiv.simulation.flows import Rotation
from plenopiv.simulation.real_images import traced

SCRIPTS = Path(__file__).parents[2] / "benchmarks" / "accuracy"
sys.path.insert(0, str(SCRIPTS))
import arrays  # noqa: E402
from conditions import DT_S  # noqa: E402
from windows import BASE, CASES, FlowSeen, Seen, case_camera, flow_in_air, on_truth, slopes  # noqa: E402


@pytest.mark.parametrize("name", CASES)
def test_what_is_seen_is_where_the_case_in_air_has_it(name):
    """Chief rays of a volume's corners and middle meet the microlenses as those of the case in air, to the few
    hundredths of a millimetre by which windows distort."""
    camera = case_camera(name)
    seen = Seen.through(camera)
    box = (-1.5, 1.5), (-1.0, 1.0), (-4.0, 4.0)
    corners = np.array(np.meshgrid(*box)).reshape(3, -1).T
    limits = seen.limits(box)
    laboratory = np.array(np.meshgrid(*limits)).reshape(3, -1).T
    assert seen.points(laboratory) == pytest.approx(corners)
    there, in_air = traced(camera, laboratory, (0.0, 0.0)), traced(case_camera("air"), corners, (0.0, 0.0))
    assert there.st_mm == pytest.approx(in_air.st_mm, abs=0.08)
    assert traced(camera, seen.centre_mm, (0.0, 0.0)).st_mm[0] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("name", [name for name, medium in CASES.items() if medium is not None])
def test_the_middle_is_in_focus(name):
    """To first order of the depth by which spherical aberration moves the focus: 0.02 mm of lens space; z = 0 is off by
    more than 0.15 mm behind 100 mm."""
    camera = case_camera(name)
    points = np.array([Seen.through(camera).centre_mm, (0.0, 0.0, 0.0)])
    middle, zero = images_of(points, behind_window(BASE.camera(), camera.medium), BASE.camera()).place_mm[:, 2]
    assert middle == pytest.approx(0.0, abs=0.02)
    assert "100" not in name or abs(zero) > 0.15


def test_the_flow_seen_is_that_in_air_and_free_of_divergence():
    seen = Seen(1.333, (0.4, -0.2, 0.3))
    flow = FlowSeen(flow_in_air(), seen)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    h = 1e-5
    step = h * np.eye(3)
    divergence = sum((flow(points + step[k]) - flow(points - step[k]))[:, k] / (2 * h) for k in range(3))
    assert np.abs(divergence).max() < 1e-6
    assert flow(points)[:, :2] == pytest.approx(flow_in_air()(seen.points(points))[:, :2])


def test_scores_are_those_of_the_field_as_seen():
    """A rotation, right but 2 % too slow along z, in a laboratory behind a window."""
    seen, flow = Seen(1.333, (0.4, -0.2, 0.3)), Rotation(40.0)
    middle = np.random.default_rng(0).uniform((-2, -1.5, -4), (2, 1.5, 4), (40_000, 3))
    shift = 1e3 * DT_S * flow(middle)
    x, y, z = np.arange(-1.2, 1.3, 0.4), np.arange(-0.8, 0.9, 0.4), np.arange(-2.4, 2.5, 0.8)
    laboratory = {"x": x + 0.4, "y": y - 0.2, "z": z * 1.333 + 0.3}
    at = np.stack(np.meshgrid(*laboratory.values(), indexing="ij"), -1).transpose(2, 1, 0, 3)
    slow = FlowSeen(flow, seen)(at.reshape(-1, 3)).reshape(at.shape) * (1.0, 1.0, 0.98)
    data = {name: (("z", "y", "x"), slow[..., k]) for k, name in enumerate("uvw")}
    field = seen.field(xr.Dataset(data, coords=laboratory))
    true, measured = on_truth(field, middle - shift / 2, middle + shift / 2, BASE.camera())
    assert len(true) == len(x) * len(y) * 4  # planes at +-1.6 and +-2.4 mm: others are too near to focus
    assert measured == pytest.approx(true * (1.0, 1.0, 0.98), abs=1e-9)
    moving = [0, 2]
    assert slopes(true[:, moving], measured[:, moving])["slope"] == pytest.approx([1.0, 0.98])


@pytest.mark.parametrize(
    ("stretched", "code"),
    [({"rms": [0.02, 0.02, 0.05]}, 0), ({"rms": [0.02, 0.02, 0.07]}, 1), ({"error": "white image: no lattice"}, 1)],
)
def test_the_benchmark_of_arrays_fails_where_one_is_worse_or_refused(monkeypatch, tmp_path, stretched, code):
    found = iter([{"rms": [0.02, 0.02, 0.05]}, dict(stretched)])
    monkeypatch.setattr(arrays, "RECORDED", tmp_path / "arrays.json")
    monkeypatch.setattr(arrays, "simulate", lambda *_: None)
    monkeypatch.setattr(arrays, "measure", lambda *_: next(found))
    monkeypatch.setattr(sys, "argv", ["arrays.py", "regular", "stretched", "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        arrays.main()
    assert ended.value.code == code
    assert list(json.loads((tmp_path / "arrays.json").read_text())) == ["regular", "stretched"]
