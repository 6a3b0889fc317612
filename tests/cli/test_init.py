"""plenopiv init: drafts that load, and what it says of wrong sheets and folders."""

import json

import numpy as np
import pytest
import tifffile
from drafted_recording import COLUMNS, ROWS, SHEET, tree

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cli import main
from plenopiv.design.advice import suggested_depth_mm
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor


def test_init_drafts_a_file_that_loads(folder):
    experiment = Experiment.load(folder / "experiment.toml")
    assert experiment.recording_table.white == "White_0.tif"
    assert experiment.recording_table.frames == ("frame9.tif", "frame10.tif")
    assert experiment.volume.z_mm == (-1.5, 1.5)
    assert experiment.volume.voxel_mm == pytest.approx((36 / 2100, 36 / 2100, 0.077))
    assert experiment.warnings() == []  # what is suggested is seen by every view
    assert experiment.recording().white().shape == (ROWS, COLUMNS)


def test_init_says_what_to_do_next(folder, tmp_path, capsys):
    capsys.readouterr()
    assert main(["init", str(folder), str(tmp_path / "optics.json"), "--overwrite"]) == 0
    lines = capsys.readouterr().out.splitlines()
    file = folder / "experiment.toml"
    assert lines[:4] == [
        f"{file}: drafted, with the images taken for",
        "  white       White_0.tif",
        "  frames      2, a sequence: frame9.tif, frame10.tif",
        "Read it through, then in this order:",
    ]
    assert [line.split("#")[0].strip() for line in lines[4:]] == [
        f"plenopiv {command} {file}" for command in ("info", "check", "run")
    ]
    assert str(folder / "results") in lines[-1]


@pytest.mark.parametrize(
    ("m", "distances"), [(-0.5, {}), (None, {"object_distance_mm": 150.0, "image_distance_mm": 75.0})]
)
def test_init_scales_voxels_with_magnification_and_needs_no_depth(folder, tmp_path, m, distances):
    sheet = json.loads(json.dumps(SHEET))
    del sheet["main_lens"]["magnification"], sheet["main_lens"]["aperture_mm"], sheet["seeding"]
    sheet["main_lens"] |= {"f_number": 2.0} | ({"magnification": m} if m else distances)
    sheet["sensor"]["columns"] = COLUMNS
    (tmp_path / "sheet.json").write_text(json.dumps(sheet))
    assert main(["init", str(folder), str(tmp_path / "sheet.json"), "--overwrite"]) == 0
    experiment = Experiment.load(folder / "experiment.toml")
    assert experiment.camera().main_lens.magnification == pytest.approx(-0.5)
    assert experiment.volume.voxel_mm == pytest.approx((72 / 2100, 72 / 2100, 0.308))
    # W = 224 * 0.0055 / 2 / 1.004 = 0.613 mm, k = 0.613 / 4 / 12.5 * 2 = 0.0245, z = 0.0239 * 150 mm
    assert experiment.volume.z_mm == (-3.5, 3.5)


def test_suggested_depth_of_a_large_sensor_is_three_quarters_of_where_a_footprint_is_one_microlens():
    camera = PlenopticCamera(MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(6600, 4400, 0.0055))
    assert suggested_depth_mm(camera) == (-3.2, 3.2)  # 0.75 * 14 * 0.308 = 3.23


def test_init_reads_a_sheet_in_toml(folder, tmp_path):
    (tmp_path / "optics.toml").write_text(
        "\n".join(
            f"[{table}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in keys.items())
            for table, keys in SHEET.items()
        )
    )
    before = (folder / "experiment.toml").read_text()
    assert main(["init", str(folder), str(tmp_path / "optics.toml"), "--overwrite"]) == 0
    assert (folder / "experiment.toml").read_text() == before


def sheet_with(tmp_path, table, key, value):
    sheet = json.loads(json.dumps(SHEET))
    if value is None:
        del sheet[table][key]
    else:
        sheet[table][key] = value
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(sheet))
    return path


@pytest.mark.parametrize(
    ("table", "key", "value", "expected"),
    [
        ("main_lens", "focal_length_mm", None, "main_lens.focal_length_mm is missing"),
        ("main_lens", "focal_length_mm", "50", "main_lens.focal_length_mm = '50' is no number"),
        ("main_lens", "focal_length_mm", -50, "must be positive"),
        ("main_lens", "magnification", 1.0, "magnification"),
        ("main_lens", "aperture_mm", None, "main_lens.f_number is missing"),
        ("microlens_array", "lattice", "round", "give square or hexagonal"),
        ("sensor", "columns", 300, "300 x 224 pixels, but the images are 280 x 224"),
        ("sensor", "bits", None, "sensor.bits is missing"),
        ("recording", "orientation", None, "recording.orientation is missing"),
        ("recording", "dt_s", None, "recording.dt_s is missing"),
        ("seeding", "depth_mm", [2.0, -2.0], "must rise"),
        ("seeding", "depth_mm", "deep", "two numbers"),
        ("seeding", "depth_mm", [-40, 40], "is too deep"),
        (
            "seeding",
            "depth_mm",
            [-0.1, 0.1],
            "seeding.depth_mm = [-0.1, 0.1] mm is too thin: windows are 8 voxels deep",
        ),
        ("seeding", "depth_mm", [-0.1, 0.1], "makes 0.616 mm, and it holds 3"),
    ],
)
def test_init_names_what_is_wrong_with_the_sheet(folder, tmp_path, one_line, table, key, value, expected):
    before = tree(folder)
    sheet = sheet_with(tmp_path, table, key, value)
    message = one_line("init", folder, sheet, "--overwrite")
    assert expected in message
    assert "wrong.json" in message
    assert tree(folder) == before


def test_init_names_a_key_with_another_unit(folder, tmp_path, one_line):
    sheet = json.loads(json.dumps(SHEET))
    sheet["recording"]["dt_us"] = 1e6 * sheet["recording"].pop("dt_s")
    (tmp_path / "wrong.json").write_text(json.dumps(sheet))
    message = one_line("init", folder, tmp_path / "wrong.json", "--overwrite")
    assert "recording.dt_s is missing; recording.dt_us is no key" in message
    assert "is no key" not in one_line("init", folder, sheet_with(tmp_path, "recording", "dt_s", None), "--overwrite")


def test_init_names_what_is_wrong_with_the_folder(folder, tmp_path, one_line):
    sheet = tmp_path / "optics.json"
    assert "is already there; use --overwrite" in one_line("init", folder, sheet)
    (folder / "experiment.toml").unlink()
    assert "no such folder" in one_line("init", tmp_path / "none", sheet)
    assert "no such file" in one_line("init", folder, tmp_path / "none.json")
    (tmp_path / "broken.json").write_text("{")
    assert "neither valid JSON nor TOML" in one_line("init", folder, tmp_path / "broken.json")
    tifffile.imwrite(folder / "odd.tif", np.zeros((10, 20), np.uint16))
    assert "odd.tif: is 20 x 10 pixels, but White_0.tif is 280 x 224" in one_line("init", folder, sheet)
    (folder / "odd.tif").unlink()
    (folder / "frame9.tif").rename(folder / "calib.tif")
    assert "needs one white image" in one_line("init", folder, sheet)
    (folder / "White_0.tif").unlink()
    assert "1 frame beside calib.tif" in one_line("init", folder, sheet)
    assert not (folder / "experiment.toml").exists()
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no images" in one_line("init", empty, sheet)
