"""Two runs in one place where the lock was removed with its folder, and folders that are links to another disk."""

import errno
import os
import shutil
import warnings

import pytest
from test_series_folder import INPUTS, PAIRS, contents, field, measure, session

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.io import aside
from plenopiv.io.netcdf import read_velocity, write_velocity
from plenopiv.io.series_file import pair_file
from plenopiv.io.series_folder import WORK, SeriesFolder
from plenopiv.io.series_statistics import fields_of

GONE = "results: was removed or replaced while this run went on; begin it again"


def begun(folder):
    folder.begin(INPUTS)
    folder.settle({**INPUTS, "calibration": {"pitch": 0.077}})
    measure(folder, 0)


@pytest.mark.parametrize("removed", ["all", "lock"])
def test_a_run_whose_folder_was_removed_does_not_write_into_the_next_one_s(tmp_path, removed):
    results = tmp_path / "results"
    with SeriesFolder(results) as first:
        begun(first)
        shutil.rmtree(results) if removed == "all" else (results / WORK / "lock").unlink()
        with SeriesFolder(results, overwrite=True) as second:
            begun(second)
            before = contents(results)
            assert (first.is_mine, second.is_mine) == (False, True)
            for late in (lambda: measure(first, 1), first.check_whole, lambda: first.publish([], INPUTS)):
                with pytest.raises(PlenoPIVError, match=GONE):
                    late()
            first.discard()
            assert before.items() <= contents(results).items()
            second.check_whole()


def test_a_pair_s_file_that_another_run_wrote_over_is_not_put_together(tmp_path):
    with SeriesFolder(tmp_path / "results") as folder:
        begun(folder)
        measure(folder, 1)
        folder.check_whole()
        write_velocity(folder.path(pair_file(1)), field(1, 7.0))
        with pytest.raises(
            PlenoPIVError, match=r"pair-0001\.nc: is damaged since its pair was measured; begin the com"
        ):
            folder.check_whole()


def test_pairs_on_another_disk(tmp_path, monkeypatch):
    """As where results/pairs is a link: no file is renamed from one disk to another."""
    real = os.replace

    def replace(made, place):
        if place.parent.name == "pairs" and WORK in made.parts and WORK not in place.parts:
            raise OSError(errno.EXDEV, "Invalid cross-device link", str(made), None, str(place))
        real(made, place)

    monkeypatch.setattr(aside.os, "replace", replace)
    assert session(tmp_path / "results")[0] == list(range(PAIRS))
    assert not (tmp_path / "results" / WORK).exists()
    assert session(tmp_path / "results")[0] == []
    monkeypatch.undo()
    session(tmp_path / "other")
    assert contents(tmp_path / "results") == contents(tmp_path / "other")


def test_a_file_is_moved_by_a_copy_where_it_must(tmp_path, monkeypatch):
    (tmp_path / "made").write_text("new")
    (tmp_path / "place").write_text("old")
    real = os.replace
    names = []

    def replace(made, place):
        names.append(made.name)
        if made.name == "made":
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        real(made, place)

    monkeypatch.setattr(aside.os, "replace", replace)
    aside.moved(tmp_path / "made", tmp_path / "place")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"place": "new"}
    assert len(names) == 2
    with pytest.raises(FileNotFoundError):
        aside.moved(tmp_path / "none", tmp_path / "place")


def test_copies_that_a_killed_run_left_are_swept(tmp_path):
    session(tmp_path)
    (tmp_path / "pairs" / ".pair-0001.nc.elsewhere-1.part").write_text("half")
    session(tmp_path)
    assert not list(tmp_path.rglob("*.part"))


def test_a_field_of_one_pair_is_told_of_too(tmp_path):
    with SeriesFolder(tmp_path) as folder:
        folder.begin(INPUTS)
        folder.settle({**INPUTS, "calibration": {}})
        write_velocity(folder.path("velocity.nc"), field(0))
        folder.store({"pair": 0, "set_aside": None}, ["velocity.nc"])
        folder.write_text("summary.json", "{}")
        folder.publish(["summary.json"], {**INPUTS, "calibration": {}})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_velocity(tmp_path / "velocity.nc")
    write_velocity(tmp_path / "velocity.nc", field(0, 7.0))
    with pytest.warns(PlenoPIVWarning, match=r"velocity\.nc: is not as it was written"):
        read_velocity(tmp_path / "velocity.nc")


def test_a_velocity_file_that_is_not_its_run_s_is_told_of(tmp_path):
    session(tmp_path)
    read_velocity(tmp_path / "velocity.nc")
    changed = read_velocity(tmp_path / "velocity.nc")
    changed["u"][0, 0, 0, 0] = 9.0
    write_velocity(tmp_path / "velocity.nc", changed)
    for read in (lambda: read_velocity(tmp_path / "velocity.nc"), lambda: next(fields_of(tmp_path))):
        with pytest.warns(PlenoPIVWarning, match=r"velocity\.nc: is not as it was written: changed since, or dam"):
            read()
