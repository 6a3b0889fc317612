"""``plenopiv design``: its text and files, and one clear line for each camera that cannot be."""

import json
from functools import partial
from math import nan

import pytest

from plenopiv.accuracy.velocity import Errors
from plenopiv.cli import main
from plenopiv.design.twin import Twin, twin
from plenopiv.errors import PlenoPIVError

SHEET = {
    "main_lens": {"focal_length_mm": 50, "aperture_mm": 25, "magnification": -1},
    "microlens_array": {"lattice": "square", "pitch_mm": 0.077, "focal_length_mm": 0.308},
    "sensor": {"columns": 500, "rows": 448, "pixel_pitch_mm": 0.0055, "bits": 12, "black_level": 60},
}


def written(path, **changes):
    """The sheet with ``table__key`` changed; None removes a key."""
    tables = json.loads(json.dumps(SHEET))
    for name, value in changes.items():
        table, key = name.split("__")
        if value is None:
            del tables[table][key]
        else:
            tables.setdefault(table, {})[key] = value
    path.write_text(json.dumps(tables))
    return path


def test_design_writes_text_figure_and_json(tmp_path, capsys):
    sheet = written(tmp_path / "optics.json", seeding__depth_mm=[-1.5, 1.5])
    out = tmp_path / "design"
    assert main(["design", str(sheet), str(out), "--no-simulate"]) == 0
    text = capsys.readouterr().out
    for words in (
        "PMR",
        "dead zone",
        "field (mm)",
        "in depth",
        "microlenses",
        "million",
        "What would change",
        "M = -2",
    ):
        assert words in text
    found = json.loads((out / "design.json").read_text())
    assert found["optics"]["measurement"]["limits_mm"][2] == [-1.5, 1.5]
    assert found["costs"]["memory_gb"] > 0.2
    assert len(found["variants"]) == 7
    assert (out / "design.png").stat().st_size > 10_000
    assert (out / "design.txt").read_text() in text


@pytest.mark.full
def test_design_simulates_a_twin_of_each_density(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("plenopiv.design.sheet.twin", partial(twin, vectors=60))  # a fifth of what a user gets
    sheet = written(tmp_path / "optics.json", sensor__columns=900, sensor__rows=900)
    arguments = ["design", str(sheet), str(tmp_path / "d"), "--depth", "-1.6", "1.6", "--density", "1"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "Aim for 1 particles per microlens" in text
    assert "Expected error of displacements at 1 ppm" in text
    (made,) = json.loads((tmp_path / "d" / "design.json").read_text())["twins"]
    assert made["vectors"] > 40
    assert 0 < made["errors"]["rms"][0] < 0.3


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"main_lens__aperture_mm": 40}, "micro-images overlap; matched at an aperture of 25 mm"),
        ({"main_lens__aperture_mm": 15}, "leave pixels between them dark; matched at an aperture of 25 mm"),
        ({"seeding__depth_mm": [-2, 130]}, "must rise and end before the main lens, which is at z = 100 mm"),
        ({"seeding__depth_mm": [-30, 30]}, "is too deep"),
        ({"main_lens__focal_length_mm": -50}, "main_lens.focal_length_mm = -50 must be positive"),
        ({"microlens_array__focal_length_mm": 0}, "microlens_array.focal_length_mm = 0 must be positive"),
        ({"microlens_array__focal_length_mm": 308}, "is not below the main lens' image distance"),
        (
            {"main_lens__object_distance_mm": 200, "main_lens__image_distance_mm": 200},
            "does not image 200 mm to 200 mm",
        ),
        ({"sensor__columns": None}, "sensor.columns is missing"),
        ({"microlens_array__pitch_mm": 77}, "fewer than four microlenses"),
    ],
)
def test_cameras_that_cannot_be_end_with_one_line(tmp_path, one_line, changes, expected):
    sheet = written(tmp_path / "optics.json", **changes)
    out = tmp_path / "design"
    line = one_line("design", sheet, out, "--no-simulate")
    assert expected in line
    assert str(sheet) in line
    assert not out.exists()


def test_design_refuses_what_it_would_overwrite_and_strange_densities(tmp_path, one_line):
    sheet = written(tmp_path / "optics.json")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "design.json").write_text("{}")
    assert "--overwrite" in one_line("design", sheet, tmp_path / "d", "--no-simulate")
    assert "positive numbers" in one_line("design", sheet, "--density", "-1")
    assert "--density inf: give positive numbers" in one_line("design", sheet, "--density", "inf")
    assert "--depth -inf 0: give two finite" in one_line("design", sheet, "--no-simulate", "--depth", "-inf", "0")
    assert "no such file" in one_line("design", tmp_path / "pmr15")


@pytest.mark.parametrize("option", [["--compare"], ["--density", "1"]])
def test_what_asks_for_twins_is_refused_where_none_shall_be_simulated(tmp_path, one_line, option):
    sheet = written(tmp_path / "optics.json")
    assert f"{option[0]}: asks for simulated twins" in one_line("design", sheet, "--no-simulate", *option)


class Simulated:
    """Instead of twins: errors that grow with the density, and none below ``fewest``."""

    def __init__(self, fewest, nan=()):
        self.fewest, self.nan, self.asked = fewest, nan, []

    def __call__(self, camera, measured, *, seeding, seed, progress):
        ppm = seeding.particles_per_microlens
        self.asked.append((camera.main_lens.magnification, ppm))
        if ppm < self.fewest:
            raise PlenoPIVError("accuracy: no vector has a whole window inside")
        rms = (nan if ppm in self.nan else ppm,) * 3
        return Twin(camera, measured, ppm, 14.0, 0.3, 1, 60, Errors(1.0, 0.0, rms, rms, ()), ())


def test_variants_have_the_density_of_the_best_twin(tmp_path, capsys, monkeypatch):
    simulated = Simulated(fewest=0.3, nan=(0.4,))
    monkeypatch.setattr("plenopiv.design.sheet.twin", simulated)
    sheet = written(tmp_path / "optics.json", sensor__columns=900, sensor__rows=900)
    densities = [word for ppm in (0.1, 0.4, 2, 0.5) for word in ("--density", str(ppm))]
    assert main(["design", str(sheet), "--depth", "-1.6", "1.6", *densities, "--compare"]) == 0
    told = capsys.readouterr()
    assert "0.1 particles per microlens: is left out (accuracy: no vector" in told.err
    assert "Aim for 0.5 particles per microlens" in told.out
    assert "errors at 0.5 ppm):" in told.out
    assert {ppm for _, ppm in simulated.asked[4:]} == {0.5}
    assert len(simulated.asked) > 8


def test_densities_of_which_nothing_comes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("plenopiv.design.sheet.twin", Simulated(fewest=1.0))
    sheet = written(tmp_path / "optics.json", sensor__columns=900, sensor__rows=900)
    assert main(["design", str(sheet), "--depth", "-1.6", "1.6", "--density", "0.1"]) == 2
    _, *said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "optics.json: no velocity comes of any of these densities; give others with --density" in said[0]


def test_a_volume_off_focus_has_no_column_of_focus(tmp_path, capsys):
    sheet = written(tmp_path / "optics.json", sensor__columns=900, sensor__rows=900)
    assert main(["design", str(sheet), "--no-simulate", "--depth", "1", "3"]) == 0
    text = capsys.readouterr().out
    assert "z = 0" not in text
    (by_depth,) = [line for line in text.splitlines() if line.strip().startswith("+2.00")]
    (given,) = [line for line in text.splitlines() if line.strip().startswith("as given")]
    across, in_depth = (by_depth.split()[at] for at in (4, 6))
    assert [given.split()[at] for at in (-4, -2)] == [across, in_depth]
