"""The campaign with spoilt recordings: what may be silent, what it recorded, and how copies are spoilt."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from pages_of_benchmarks import as_written

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks" / "accuracy"))

from small_recording import CAMERA, Clean  # noqa: E402
from spoiling import BLACK, Copy, dimmed, read, write  # noqa: E402
from spoilt import CASES, MOST, QUIET  # noqa: E402
from spoilt_page import page  # noqa: E402

SILENT = {"swapped", "dt in ms", "orientation", "magnification and pixel pitch", "microlens f and aperture"}


@pytest.fixture(scope="module")
def recorded():
    names = "spoilt.json", "static_light.json"
    return [json.loads((ROOT / "benchmarks" / "accuracy" / name).read_text()) for name in names]


def test_only_what_no_image_shows_may_be_silent():
    assert len(CASES) >= 35
    assert {name for name, case in CASES.items() if case.silent} == SILENT


def test_every_case_was_tried_and_none_was_wrong_in_silence(recorded):
    lines = {line["name"]: line for line in recorded[0]}
    assert list(lines) == [*CASES, *(f"condition {name}" for name in QUIET)]
    assert {line["name"] for line in lines.values() if line["outcome"] == "WRONG"} == set()
    assert {name for name, line in lines.items() if line["outcome"] == "silent"} <= SILENT
    for line in lines.values():
        if line["outcome"] in ("as if unspoilt", "set aside") and "ratio" in line:
            assert line["ratio"] <= MOST


def test_static_light_is_taken_off(recorded):
    taken = [line for line in recorded[1] if line["way"] != "nothing taken off"]
    assert len({line["name"] for line in taken}) == 6
    assert max(max(line["ratio"]) for line in taken) <= MOST


def test_the_page_is_that_of_what_was_recorded(recorded):
    assert as_written(ROOT / "docs" / "spoilt.md") == page(recorded[0], CASES, recorded[1])


@pytest.fixture
def copy(tmp_path):
    """One pair of noise about 500 counts, to be spoilt."""
    folder, rng = tmp_path / "clean", np.random.default_rng(0)
    folder.mkdir()
    shape = CAMERA.sensor.rows, CAMERA.sensor.columns
    for name in ("white", "dark", "run_01_a", "run_01_b"):
        write(folder / f"{name}.tif", BLACK + 0.5 * rng.poisson(880.0, shape))
    (folder / "experiment.toml").write_text("[recording]\ndt_s = 0.5\n[camera.sensor]\nblack_level = 60\n")
    return Copy(Clean(folder, 1), tmp_path / "copy", 1, seed=1)


def test_added_light_has_shot_noise(copy):
    before = read(copy.frame(0, "a"))
    copy.add(np.full(before.shape, 200.0))
    added = read(copy.frame(0, "a")) - before
    assert added.mean() == pytest.approx(200.0, abs=0.5)
    assert added.std() == pytest.approx(np.sqrt(0.5 * 200.0), rel=0.02)


def test_dimmed_light_has_the_noise_of_less_light(copy):
    counts = read(copy.frame(0, "a"))
    less = dimmed(counts, 0.25, np.random.default_rng(2)) - BLACK
    assert less.mean() == pytest.approx(110.0, abs=0.5)
    assert less.std() == pytest.approx(np.sqrt(0.5 * 110.0 + (1 - 0.25**2) * 1.5**2), rel=0.02)


def test_keys_and_times_of_a_copy(copy):
    copy.times("recording.dt_s", 2.0)
    copy.key("camera.sensor.black_level", 0.0)
    text = copy.save().read_text()
    assert "dt_s = 1.0" in text
    assert "black_level = 0.0" in text
    copy.stamp(copy.frame(0, "a"), 0.25)
    with tifffile.TiffFile(copy.frame(0, "a")) as file:
        assert file.pages[0].tags[37521].value == "250000"
