"""The script of the paper's section 2 writes its pictures and numbers, and the numbers are possible."""

import json
import sys
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "paper"))
import resolution  # noqa: E402

pytestmark = pytest.mark.full

PICTURES = ("fig03-block.png", "fig04-pmr8.png", "fig05-pmr14.png", "fig06-pmr28.png", "resolution.png")
PITCH_UM = {"pmr8": 44.0, "pmr14": 77.0, "pmr28": 154.0}


@pytest.fixture(scope="module")
def reduced(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    resolution.main(reduced=True, out=folder)
    return folder


def test_every_file_is_written(reduced):
    assert {file.name for file in reduced.iterdir()} == {*PICTURES, "resolution.json"}
    for name in PICTURES:
        assert (reduced / name).read_bytes().startswith(b"\x89PNG")
        assert 5_000 < (reduced / name).stat().st_size < 200_000


@pytest.mark.parametrize("where", ["reduced", "kept"])
def test_numbers_are_sane(reduced, where):
    file = reduced if where == "reduced" else ROOT / "paper" / "results"
    numbers = json.loads((file / "resolution.json").read_text())
    assert list(numbers) == list(PITCH_UM)
    for name, pitch in PITCH_UM.items():
        of = numbers[name]
        assert of["block_about_focus_z_mm"] == pytest.approx(of["dead_zone_mm"])
        assert of["dead_zone_mm"] == pytest.approx([-0.308, 0.308], abs=0.0011)
        assert of["block_about_focus_y_um"] == pytest.approx(pitch)
        assert of["blocks"] > of["lines"]
        for row in of["blocks_by_depth"]:
            assert 0 < row["along_y_um"] <= pitch * 1.01
            assert 0 < row["along_z_um"] < 617
            assert 0 < row["area_um2"] < 0.5 * pitch * 617  # the rhombus about the focus
        for row in of["free_shift_by_depth"]:
            assert row["y_mean_um"] <= row["y_largest_um"] / 2 <= pitch / 2 * 1.01
        assert of["in_space"]["square_y_um"][0] == pytest.approx(pitch / 2, rel=1e-4)
        # in focus a block is 0.616 mm (1 - max(|x|, |y|)/(p/2)) deep, in the mean a third of 0.616 mm; half is free
        assert of["in_space"]["square_z_um"][0] == pytest.approx(616 / 6, rel=0.05 if where == "reduced" else 0.005)
    for band in (2, 3):  # outside the dead zone depth gains with PMR
        assert all(b < a for a, b in pairwise(numbers[n]["free_shift_by_depth"][band]["z_mean_um"] for n in PITCH_UM))


def test_kept_pictures_are_there_and_small():
    for name in PICTURES:
        assert 5_000 < (ROOT / "docs" / "images" / "paper" / name).stat().st_size < 200_000, name
