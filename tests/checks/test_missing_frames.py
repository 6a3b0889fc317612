"""Frames that are missing in the middle of a sequence, by the numbers in their names."""

import shutil
import sys
import tomllib

import pytest
from recordings import record

from plenopiv.checks import missing, repeats
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment


@pytest.mark.parametrize(
    ("names", "after"),
    [
        (["f00.tif", "f01.tif", "f02.tif", "f03.tif"], []),
        (["f00.tif", "f01.tif", "f03.tif", "f04.tif"], [1]),
        (["f8.tif", "f9.tif", "f11.tif"], [1]),
        (["f00.tif", "f05.tif", "f10.tif", "f20.tif"], [2]),
        ([f"run2_{k:03d}.tif" for k in (*range(8), *range(9, 15), *range(17, 22))], [7, 13]),
        (["f0.tif", "f2.tif", "f3.tif"], []),  # which step is usual nobody knows
        (["f0.tif", "f1.tif", "f4.tif", "f6.tif", "f9.tif", "f10.tif"], []),  # numbers that do not count
        (["20261129_235959.tif", "20261130_000000.tif", "20261130_000002.tif"], []),
        (["a.tif", "b.tif", "c.tif"], []),
        (["f0.tif", "f2.tif"], []),
        ([], []),
    ],
)
def test_numbers_that_are_left_out(names, after):
    assert missing.left_out(names) == after


@pytest.fixture
def sequence(tmp_path):
    """A sequence of four frames; the second and the third are the same images as the first two."""
    folder = tmp_path / "r"
    record(folder)
    for k, name in enumerate("abab"):
        shutil.copy(folder / f"{name}.tif", folder / f"f{k}.tif")
    for name in "ab":
        (folder / f"{name}.tif").unlink()
    return folder


def recording(folder):
    file = folder / "experiment.toml"
    tables = tomllib.loads(file.read_text())
    tables["recording"]["frames"] = "f*.tif"
    return Experiment.from_dict(tables, file).recording()


def test_a_missing_frame_is_named_and_an_empty_file_of_its_name_tells_that_it_is(sequence):
    assert missing.of_names(recording(sequence)) is None
    (sequence / "f1.tif").rename(sequence / "f7.tif")
    (sequence / "f7.tif").rename(sequence / "f4.tif")
    found = missing.of_names(recording(sequence))
    assert found.severity == "warning"
    assert "missing between f0.tif and f2.tif:" in found.words
    (sequence / "f1.tif").touch()
    assert missing.of_names(recording(sequence)) is None
    assert list(recording(sequence).damaged) == [1]


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_a_frame_that_is_a_link_to_nothing_is_told_of(sequence):
    (sequence / "f1.tif").unlink()
    (sequence / "f1.tif").symlink_to("nowhere.tif")
    with pytest.raises(PlenoPIVError, match=r"f1\.tif: no such file"):
        recording(sequence)


def test_a_frame_of_another_number_is_not_what_was_meant(sequence):
    file = sequence / "experiment.toml"
    tables = tomllib.loads(file.read_text())
    tables["recording"]["frames"] = ["f0.tif", "f9.tif", "f1.tif"]
    with pytest.raises(PlenoPIVError, match=r"f9\.tif: no such file; correct its name, or put it there"):
        Experiment.from_dict(tables, file).recording()
    tables["recording"]["frames"][1] = "g2.tif"
    with pytest.raises(PlenoPIVError, match=r"g2\.tif: no such file; did you mean f2\.tif"):
        Experiment.from_dict(tables, file).recording()


def test_of_a_frame_written_twice_in_a_sequence_the_step_beside_it_is_named(sequence):
    shutil.copy(sequence / "f0.tif", sequence / "f1.tif")
    found = repeats.findings(recording(sequence))
    assert all("twice as fast" in one.advice for one in found)
    assert found
