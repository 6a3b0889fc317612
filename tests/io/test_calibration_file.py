"""calibration.toml: what is written is read back bit for bit, and what is damaged is refused."""

import tomllib
from dataclasses import replace

import pytest
import tomli_w
from calibrations import calibrated

from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVError
from plenopiv.io.calibration_file import load_calibration, save_calibration

INPUTS = {"method": "1", "white.tif": "0123456789abcdef", "target_0.tif": "missing"}
AGAIN = "make it anew with: plenopiv calibrate --overwrite"


@pytest.fixture
def file(tmp_path):
    save_calibration(calibrated(), INPUTS, tmp_path / "calibration.toml")
    return tmp_path / "calibration.toml"


@pytest.mark.parametrize("irregular", [True, False])
def test_what_is_written_is_read_bit_for_bit(tmp_path, irregular):
    made = calibrated(irregular, irregular)
    save_calibration(made, INPUTS, tmp_path / "one.toml")
    found, inputs = load_calibration(tmp_path / "one.toml")
    assert repr(found) == repr(made)
    assert inputs == INPUTS
    save_calibration(found, inputs, tmp_path / "two.toml")
    assert (tmp_path / "one.toml").read_bytes() == (tmp_path / "two.toml").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"one.toml", "two.toml"}


def test_a_self_calibration_is_kept_with_it(tmp_path):
    beside = ViewShift(12.5, 3.3, 1, tuple((0.1 * k, 1 / (3 + k)) for k in range(5)))
    save_calibration(replace(calibrated(), beside=beside), INPUTS, tmp_path / "one.toml")
    assert load_calibration(tmp_path / "one.toml")[0].beside == beside
    tables = tomllib.loads((tmp_path / "one.toml").read_text())
    del tables["self_calibration"]["u_mm"]
    (tmp_path / "two.toml").write_text(tomli_w.dumps(tables))
    with pytest.raises(PlenoPIVError, match="'u_mm' is missing"):
        load_calibration(tmp_path / "two.toml")


def keys(table, above=()):
    """Every key of nested tables, as the way to it."""
    for key, value in table.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from keys(value, (*above, key))


def test_no_key_may_be_missing(file):
    """But for those whose names are data: of inputs, of parameters, the map of an irregular array and the lens' rim."""
    whole = tomllib.loads(file.read_text())
    named = [way for way in keys(whole) if way[0] in ("inputs", "parameters") and len(way) == 2]
    ways = [way for way in keys(whole) if way not in named and way[-1] not in ("map", "rim")]
    assert len(ways) > 60
    for way in ways:
        tables = tomllib.loads(file.read_text())
        table = tables
        for key in way[:-1]:
            table = table[key]
        del table[way[-1]]
        file.with_name("cut.toml").write_text(tomli_w.dumps(tables))
        with pytest.raises(PlenoPIVError, match=f"cut.toml: is damaged: '{way[-1]}' is missing: {AGAIN}"):
            load_calibration(file.with_name("cut.toml"))


def test_a_file_of_before_outliers_were_counted(file):
    tables = tomllib.loads(file.read_text())
    for plane in tables["planes"]:
        del plane["outliers"]
    file.write_text(tomli_w.dumps(tables))
    assert [plane.outliers for plane in load_calibration(file)[0].planes] == [0] * 4


@pytest.mark.parametrize(
    ("was", "now", "words"),
    [
        ("gap_mm = 52.9", 'gap_mm = "wide"', r"is damaged \(TypeError"),
        ("gap_mm = 52.9", "gap_mm = nan", r"is damaged \(ValueError: nan is no number"),
        ("gap_mm = 52.9", "gap_mm = true", r"is damaged \(ValueError: True is no number"),
        ("gap_mm = 52.9", "gap_mm = 52.9\ngap_cm = 5", r"is damaged \(ValueError: gap_cm is no key of it"),
        ("gap_mm = 52.9", "gap_mm = ", "is not valid TOML"),
        ("[rays.medium]", "[[rays.medium]]", "is damaged"),
        ("method = ", "method == ", "is not valid TOML"),
    ],
)
def test_senseless_values_are_refused(file, was, now, words):
    text = file.read_text()
    assert was in text
    file.write_text(text.replace(was, now))
    with pytest.raises(PlenoPIVError, match=f"calibration.toml: {words}.*{AGAIN}$"):
        load_calibration(file)


def test_half_a_file_no_text_and_no_file(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(PlenoPIVError, match=f"calibration.toml: .*{AGAIN}$"):
        load_calibration(file)
    file.write_bytes(b"\xff\xfe\x00")
    way_out = "name a text file, or save it as UTF-8"
    with pytest.raises(PlenoPIVError, match=f"calibration.toml: is not a text file in UTF-8; {way_out}: {AGAIN}$"):
        load_calibration(file)
    with pytest.raises(PlenoPIVError, match=f"none.toml: cannot be read .*: {AGAIN}$"):
        load_calibration(file.with_name("none.toml"))


def test_what_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "calibration.toml").mkdir()
    with pytest.raises(PlenoPIVError, match=r"calibration.toml: cannot be written"):
        save_calibration(calibrated(), INPUTS, tmp_path / "calibration.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.toml"]
