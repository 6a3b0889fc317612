"""Optics sheets whose values are none: init and design name the key in one line."""

import json

import pytest
from drafted_recording import SHEET, tree

from plenopiv.cli import main

NONE = [
    ("sensor", "black_level", "sixty", "sensor.black_level = 'sixty' is no number"),
    ("sensor", "black_level", 1e30, "sensor.black_level = 1e+30 is not between"),
    ("sensor", "black_level", 5000, "sensor.black_level = 5000 must be from 0 to below 2^12 - 1"),
    ("sensor", "black_level", [60], "sensor.black_level = [60] is no number"),
    ("sensor", "columns", float("nan"), "sensor.columns = nan is not between"),
    ("sensor", "columns", "280", "sensor.columns = '280' is no number"),
    ("sensor", "columns", 280.5, "sensor.columns = 280.5 must be a whole number from 16 to 65536"),
    ("sensor", "bits", 12.5, "sensor.bits = 12.5 must be a whole number from 8 to 16"),
    ("sensor", "bits", 40, "sensor.bits = 40 must be"),
    ("sensor", "pixel_pitch_mm", 1e30, "sensor.pixel_pitch_mm = 1e+30 is not between"),
    ("main_lens", "focal_length_mm", 1e30, "main_lens.focal_length_mm = 1e+30 is not between"),
    ("main_lens", "focal_length_mm", float("inf"), "main_lens.focal_length_mm = inf"),
    ("main_lens", "aperture_mm", 25000, "f/0.002, and no lens is faster than f/0.5"),
    ("main_lens", "magnification", -1e-30, "main_lens.magnification = -1e-30 is not between"),
    ("main_lens", "magnification", 0, "main_lens.magnification = 0 must be negative, because a real image is inverted"),
    ("main_lens", "magnification", 1, "main_lens.magnification = 1 must be negative, because a real image is inverted"),
    ("microlens_array", "pitch_mm", 1e8, "microlens_array.pitch_mm: fewer than four microlenses"),
    ("microlens_array", "lattice", ["square"], "microlens_array.lattice = ['square'] is wrong"),
    ("recording", "dt_s", float("nan"), "recording.dt_s = nan"),
    ("recording", "dt_s", -1, "recording.dt_s"),
    ("seeding", "depth_mm", [float("nan"), 1.0], "must be two numbers"),
    ("seeding", "depth_mm", [-1e300, 1e300], "must be two numbers"),
    ("seeding", "depth_mm", {"a": 1, "b": 2}, "must be two numbers"),
]


@pytest.mark.parametrize(("table", "key", "value", "expected"), NONE)
def test_a_value_that_is_none(folder, tmp_path, one_line, table, key, value, expected):
    sheet = json.loads(json.dumps(SHEET))
    sheet[table][key] = value
    path, before = tmp_path / "odd.json", tree(folder)
    path.write_text(json.dumps(sheet))
    message = one_line("init", folder, path, "--overwrite")
    assert expected in message
    assert "odd.json" in message
    assert tree(folder) == before


@pytest.mark.parametrize(
    ("table", "key", "value", "expected"),
    [
        ("sensor", "black_levl", 60, "sensor.black_levl: unknown key; did you mean black_level?"),
        ("seeding", "depth_um", [-4000, 4000], "seeding.depth_um: unknown key; did you mean depth_mm?"),
        ("sensor", "bit_depth", 16, "sensor.bits = 12 and sensor.bit_depth = 16: give one"),
        ("main_lens", "f_number", 8.0, "main_lens.f_number = 8 is an aperture of 6.25 mm, but main_lens.aperture_mm"),
        (None, "seeding", "deep", "seeding = 'deep' is no table of keys"),
    ],
)
def test_a_key_that_would_be_left_out_or_said_twice(folder, tmp_path, one_line, table, key, value, expected):
    sheet = json.loads(json.dumps(SHEET))
    sheet["sensor"].pop("black_level", None)
    sheet["seeding"].pop("depth_mm", None)
    (sheet[table] if table else sheet)[key] = value
    (tmp_path / "odd.json").write_text(json.dumps(sheet))
    assert expected in one_line("init", folder, tmp_path / "odd.json", "--overwrite")


@pytest.mark.parametrize(
    ("table", "written"),
    [("main_lens", "mainlens"), ("microlens_array", "microlens_arrays"), ("seeding", "Seeding"), ("sensor", "senor")],
)
def test_a_table_whose_name_is_nearly_right(folder, tmp_path, one_line, table, written):
    sheet = json.loads(json.dumps(SHEET))
    sheet[written] = sheet.pop(table)
    (tmp_path / "odd.json").write_text(json.dumps(sheet))
    message = one_line("init", folder, tmp_path / "odd.json", "--overwrite")
    assert f"odd.json: {written}: unknown table; did you mean {table}?" in message


def test_keys_of_others_are_left_alone(folder, tmp_path):
    """And an f-number beside the aperture, as makers round it."""
    sheet = json.loads(json.dumps(SHEET))
    lens = sheet["main_lens"]
    lens |= {"maker": "a", "f_number": round(lens["focal_length_mm"] / lens["aperture_mm"], 1), "f_number_of": "b"}
    sheet |= {"tank": {"fluid": "water"}, "note": "c"}
    sheet["sensor"] |= {"bit_depth": sheet["sensor"]["bits"], "cooled": True}
    (tmp_path / "odd.json").write_text(json.dumps(sheet))
    assert main(["init", str(folder), str(tmp_path / "odd.json"), "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("key", "value"), [("f_number", 0), ("f_number", -2), ("object_distance_mm", 0), ("image_distance_mm", -100)]
)
def test_a_divisor_of_zero(folder, tmp_path, one_line, key, value):
    sheet = json.loads(json.dumps(SHEET))
    del sheet["main_lens"]["aperture_mm"], sheet["main_lens"]["magnification"]
    sheet["main_lens"] |= {"f_number": 2.0, "object_distance_mm": 100.0, "image_distance_mm": 100.0, key: value}
    path = tmp_path / "odd.json"
    path.write_text(json.dumps(sheet))
    assert f"main_lens.{key} = {value:g} must be positive" in one_line("init", folder, path, "--overwrite")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a": ' * 500 + b"1" + b"}" * 500, "nested more than 16 deep"),
        (b'{"sensor": {"columns": ' + b"1" * 5000 + b"}}", "a value that cannot be read"),
        (b"[1, 2]", "must hold tables, not list"),
        (b"\xff\xfe{\0}\0", "is not a text file in UTF-8"),
        (b"", "neither valid JSON nor TOML"),
        (b'{"sensor": {\n  "pitch_um": 5,5\n}}', '"pitch_um": 5,5; decimals take a point: 0.5, not 0,5'),
        (b'{"sensor": {"pitch_um": 5.5, "bits": 0,308}}', "decimals take a point"),
    ],
)
def test_a_file_that_is_no_sheet(folder, tmp_path, one_line, content, said):
    (tmp_path / "odd.json").write_bytes(content)
    message = one_line("init", folder, tmp_path / "odd.json", "--overwrite")
    assert said in message
    assert "odd.json" in message
    assert said in one_line("design", tmp_path / "odd.json", "--no-simulate")
