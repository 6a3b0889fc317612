"""The scripts of the paper's Figs. 7 and 9: reduced runs write figures and numbers that make sense, and their parts
are what they say."""

import json
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.full

ROOT = Path(__file__).parents[2]
PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "paper"))


def written(out, name, *figures):
    for figure in figures:
        picture = (out / "docs" / "images" / "paper" / f"{figure}.png").read_bytes()
        assert picture.startswith(PNG)
        assert len(picture) < 200_000, figure
    return json.loads((out / "paper" / "results" / f"{name}.json").read_text())


def test_a_point_in_focus_lights_one_microlens(tmp_path):
    import point_images

    point_images.main(tmp_path, reduced=True)
    found = written(tmp_path, "point_images", "point-images")
    assert found["+0.000"]["microlenses"] == 1
    assert found["+0.385"]["microlenses"] == found["-0.385"]["microlenses"] == 5
    assert found["+0.385"]["pixels"] > found["+0.000"]["pixels"]


def test_light_off_focus_falls_near_the_middle_microlens_or_far_from_it():
    """A point nearer to the camera than the focal plane is imaged behind the microlenses: the aperture's rim reaches a
    neighbour on its near side. One further away lights the neighbour's far side."""
    from point_images import CAMERA, point_image

    reach = {}
    for z in (0.385, -0.385):
        column = np.nonzero(point_image(z, 20_000))[1]
        reach[z] = np.abs(column - CAMERA.sensor.axis[0]).max() / CAMERA.image_pitch_px
    assert 0.5 < reach[0.385] < 0.8
    assert 1.3 < reach[-0.385] < 1.6


def test_single_particles(tmp_path):
    import single_particles

    single_particles.main(tmp_path, reduced=True)
    found = written(tmp_path, "single_particles", "single-particles", "single-particles-quality")
    rows = found["rows"]
    assert {r["series"] for r in rows} == {"axis", "whole", "thinned", "areas", "nine rays", "spread", "noisy"}
    assert {r["method"] for r in rows if r["series"] == "axis"} == {"mart", "bound", "product", "strict"}
    for r in rows:
        assert all(0 < q <= 1 for q in r["q"].values())
        if abs(r["at_mm"][2]) > 0.5 and (r["series"], r["method"]) != ("noisy", "mart"):
            assert abs(r["off_mm"]["whole"][2]) < 0.077, r  # a voxel
        if r["series"] == "axis":
            assert r["lenses"] == (1 if r["at_mm"][2] == 0 else 9)
    quality = {(r["method"], r["at_mm"][2]): r["q"]["gauss"] for r in rows if r["series"] == "axis"}
    depths = sorted({z for _, z in quality})
    assert all(quality[m, depths[1]] < 0.5 * quality[m, depths[0]] for m in ("mart", "bound", "product"))
    for line in found["summary"]:
        if "least_gain" in line and line["series"] == "axis":
            assert line["least_gain"]["gauss"][0] > -0.01


def test_places_are_spread_over_a_microlens():
    from single_particles import places

    half = 0.5 * 0.077
    found = places(8)
    assert np.abs(found).max() < half
    assert np.abs(found.mean(0)).max() < 0.2 * half
    quadrants = {(x > 0, y > 0) for x, y in found}
    assert len(quadrants) == 4


def test_time_and_density(tmp_path):
    import time_and_density

    time_and_density.main(tmp_path, reduced=True)
    rows = written(tmp_path, "time_and_density", "time-and-density")["rows"]
    assert len(rows) == 12
    kept = {(r["method"], r["ppm"]): r["kept"] for r in rows if r["thin"] == 0}
    assert kept["mart", 1.0] == kept["mart", 2.0] == 1.0
    assert 0 < kept["bound", 1.0] < kept["bound", 2.0] < 1.0
    assert all(r["seconds"] > 0 and 0 < r["q"] < 1 for r in rows)


def test_candidates_over_depth(tmp_path):
    import candidates_over_depth

    candidates_over_depth.main(tmp_path, reduced=True)
    rows = written(tmp_path, "candidates_over_depth", "candidates-over-depth")["rows"]
    on_axis = {(r["weights"], round(r["at_mm"][2] / 0.077)): r for r in rows if r["place"] == 0}
    for weights in ("9-rays", "exact"):
        assert on_axis[weights, 0]["voxels"] > 5 * on_axis[weights, -14]["voxels"] > 0  # all of a microlens
        assert on_axis[weights, 0]["planes"] >= 5
    assert on_axis["9-rays", -13]["voxels"] > 2 * on_axis["9-rays", -14]["voxels"]  # a plane apart


def test_ways_to_a_gain_in_q(tmp_path):
    """Every way of MART is measured; with all equations both methods agree, more iterations change little."""
    import gain_in_quality

    gain_in_quality.main(tmp_path, True)
    found = {row["way"]: row for row in written(tmp_path, "gain_in_quality")["ways"]}
    assert len(found) == len(gain_in_quality.WAYS)
    for way, row in found.items():
        assert 0.3 < row["mart"] <= 1, way
        assert (max(map(abs, row["gain"])) < 0.03) == ("dark" not in way), way
