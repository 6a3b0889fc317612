"""What the page's scripts are given: the field with its axes the right way, and pictures the right way up."""

import io

import numpy as np
import pytest
import xarray as xr
from pages import example, numbers
from PIL import Image

from plenopiv.lightfield import LightField, layout
from plenopiv.report import light_field_stacks, volume_stack
from plenopiv.report.field import field_data, thinning
from plenopiv.volume import DenseVolume, VoxelGrid

X, Y, Z = np.linspace(-3, 3, 7), np.linspace(-1, 1, 5), np.linspace(-2, 2, 4)


def rotation(rate=80.0):
    """About y: u = rate z, w = -rate x, in m/s at places in mm."""
    z, y, x = np.meshgrid(Z, Y, X, indexing="ij")
    parts = {"u": rate * z * 1e-3, "v": 0 * y + 0.1, "w": -rate * x * 1e-3, "valid": np.ones(x.shape, np.int8)}
    dims = ("time", "z", "y", "x")
    return xr.Dataset({n: (dims, v[None]) for n, v in parts.items()}, {"time": [0.0], "z": Z, "y": Y, "x": X})


def test_values_run_along_x_first():
    data = field_data(rotation())
    assert (data["axes"]["x"], data["axes"]["y"], data["axes"]["z"]) == (X.tolist(), Y.tolist(), Z.tolist())
    w = numbers(data["moments"][0]["values"]["w"])
    np.testing.assert_allclose(w[: X.size], -80e-3 * X, atol=5e-6)
    u = numbers(data["moments"][0]["values"]["u"])
    np.testing.assert_allclose(u[:: X.size * Y.size], 80e-3 * Z, atol=5e-6)
    assert data["quantities"]["w"]["limits"] == {
        "map": "diverging",
        "low": pytest.approx(-0.24),
        "high": pytest.approx(0.24),
    }


def test_criteria_are_in_si_units_and_have_levels_where_something_turns():
    data = field_data(rotation())
    np.testing.assert_allclose(numbers(data["moments"][0]["values"]["q"]), 80.0**2, rtol=1e-5)
    np.testing.assert_allclose(numbers(data["moments"][0]["values"]["vorticity"]), 160.0, rtol=1e-5)
    swirl = rotation()
    swirl["u"] = swirl["u"] * np.exp(-(swirl["x"] ** 2))
    swirl["w"] = swirl["w"] * np.exp(-(swirl["x"] ** 2))
    criteria = field_data(swirl)["criteria"]
    assert {name: found["unit"] for name, found in criteria.items()} == {"q": "1/s²", "vorticity": "1/s"}
    assert all(0 <= found["low"] < found["high"] for found in criteria.values())
    strain = rotation()
    strain["w"] = -strain["w"]
    assert "q" not in field_data(strain)["criteria"]  # nothing turns more than it deforms


def test_a_surface_is_drawn_at_first_unless_all_of_the_flow_turns():
    assert field_data(rotation())["start"] == ""
    swirl = rotation()
    near = np.exp(-(swirl["x"] ** 2 + swirl["z"] ** 2))
    swirl["u"], swirl["w"] = swirl["u"] * near, swirl["w"] * near
    assert field_data(swirl)["start"] == "q"


def test_thinning_takes_the_longest_axis_and_keeps_small_fields():
    assert thinning((20, 30, 40)) == (1, 1, 1)
    step = thinning((60, 100, 140))
    left = np.array([-(-n // s) for n, s in zip((60, 100, 140), step, strict=True)])
    assert 15_000 < left.prod() <= 60_000  # 2 MB of the page, and enough to see the flow
    assert step[2] >= step[1] >= step[0]


def test_derivatives_are_of_the_whole_field_not_of_what_is_shown(monkeypatch):
    monkeypatch.setattr("plenopiv.report.field.VECTORS", 40)
    field = rotation()
    field["w"] = 0.1 * np.sin(field["x"]) + 0 * field["z"] + 0 * field["y"]
    whole = np.gradient(0.1 * np.sin(X), X * 1e-3, edge_order=2)
    data = field_data(field.transpose("time", "z", "y", "x"))
    step = data["step"]["x"]
    assert step > 1
    shown = numbers(data["moments"][0]["values"]["vorticity"])[: len(data["axes"]["x"])]
    np.testing.assert_allclose(shown, np.abs(80.0 - whole[::step]), rtol=1e-5)


def pixels(jpeg):
    return np.asarray(Image.open(io.BytesIO(jpeg)).convert("L"), float)


@pytest.mark.parametrize(("x", "y", "z"), [(2.0, 0, 0), (0, 1.2, 0), (0, 0, 1.5), (-2.0, -1.2, -1.5)])
def test_a_bright_place_is_in_the_right_picture_at_the_right_place(x, y, z):
    grid = VoxelGrid.covering((-3, 3), (-2, 2), (-2, 2), (0.1, 0.1, 0.05))
    values = np.zeros(grid.shape, np.float32)
    k, j, i = (int(np.argmin(abs(a - c))) for a, c in zip(grid.axes()[::-1], (z, y, x), strict=True))
    values[k, j - 1 : j + 2, i - 1 : i + 2] = 100
    stack = volume_stack(DenseVolume(grid, values))
    pictures = [pixels(p) for p in stack.pictures]
    brightest = int(np.argmax([p.max() for p in pictures]))
    low, high = (float(c.replace("−", "-")) for c in stack.captions[brightest][4:-3].split(" to "))
    assert low - 0.03 <= z <= high + 0.03
    row, column = np.unravel_index(int(pictures[brightest].argmax()), pictures[brightest].shape)
    rows, columns = pictures[brightest].shape
    assert stack.x[0] + (column + 0.5) / columns * (stack.x[1] - stack.x[0]) == pytest.approx(x, abs=0.25)
    assert stack.y[1] - (row + 0.5) / rows * (stack.y[1] - stack.y[0]) == pytest.approx(y, abs=0.25)
    assert stack.limits[1] == 100


def test_views_go_from_left_to_right_and_from_below_to_above():
    where = layout(example().camera())
    views, refocus = light_field_stacks(LightField(where, np.where(where.seen, 50, 0).astype(np.float32)), (-1.0, 1.0))
    places = [
        tuple(float(part.split(" = ")[1].removesuffix(" mm").replace("−", "-")) for part in caption.split(","))
        for caption in views.captions
    ]
    half = len(places) // 2
    assert [x for x, _ in places[:half]] == sorted({x for x, _ in places[:half]})
    assert [y for _, y in places[half:]] == sorted({y for _, y in places[half:]})
    assert all(y == 0 for _, y in places[:half])
    assert all(x == 0 for x, _ in places[half:])
    assert max(x for x, _ in places) < 12.5  # half the aperture
    assert [refocus.captions[0], refocus.captions[-1]] == ["z = −1.00 mm", "z = +1.00 mm"]


def test_a_stack_of_noise_is_kept_small():
    grid = VoxelGrid.covering((0, 8), (0, 8), (0, 8), (0.01, 0.01, 0.25))
    stack = volume_stack(DenseVolume(grid, np.random.default_rng(0).random(grid.shape, np.float32)))
    assert 3e5 < sum(map(len, stack.pictures)) <= 1.5e6
