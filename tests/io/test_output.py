"""The results folder and velocity.nc: whole or not at all."""

import json

import numpy as np
import pytest
import xarray as xr

from plenopiv.errors import PlenoPIVError
from plenopiv.io import OutputFolder, read_velocity, write_velocity


@pytest.fixture
def field():
    rng = np.random.default_rng(3)
    dims, shape = ("time", "z", "y", "x"), (1, 3, 4, 5)
    variables = {name: (dims, rng.normal(size=shape).astype(np.float32)) for name in "uvw"}
    variables["valid"] = (dims, np.ones(shape, np.int8))
    axes = {"time": [0.00025], "z": np.arange(3.0), "y": np.arange(4.0), "x": np.arange(5.0)}
    return xr.Dataset(variables, axes, {"Conventions": "CF-1.11"})


def test_a_field_comes_back(tmp_path, field):
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    xr.testing.assert_identical(read_velocity(path), field)
    assert [p.name for p in tmp_path.iterdir()] == ["velocity.nc"]


def test_a_field_that_cannot_be_written_leaves_the_old_one(tmp_path, field):
    path = tmp_path / "velocity.nc"
    write_velocity(path, field)
    before = path.read_bytes()
    with pytest.raises(Exception, match="object"):
        write_velocity(path, field.assign(u=(("x",), np.array([object()] * 5))))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["velocity.nc"]
    with pytest.raises(PlenoPIVError, match="cannot be written"):
        write_velocity(tmp_path / "none" / "velocity.nc", field)


def test_bad_velocity_files_are_named(tmp_path, field):
    with pytest.raises(PlenoPIVError, match="no such file"):
        read_velocity(tmp_path / "none.nc")
    path = tmp_path / "velocity.nc"
    path.write_bytes(b"no HDF5")
    with pytest.raises(PlenoPIVError, match="damaged"):
        read_velocity(path)
    write_velocity(path, field.drop_vars("w"))
    with pytest.raises(PlenoPIVError, match="has no w"):
        read_velocity(path)
    write_velocity(path, field.isel(time=0))
    with pytest.raises(PlenoPIVError, match="dimensions"):
        read_velocity(path)


def finish(folder, **options):
    with OutputFolder(folder, **options) as out:
        out.path("velocity.nc").write_bytes(b"field")
        out.write_json("summary.json", {"vectors": np.int64(3), "worst": np.nan, "at": np.arange(2)})


def fail(folder, error):
    with OutputFolder(folder, overwrite=True) as out:
        out.path("velocity.nc").write_bytes(b"half")
        raise error


def test_files_appear_together_at_the_end(tmp_path):
    folder = tmp_path / "a" / "results"
    with OutputFolder(folder) as out:
        out.write_text("report.html", "text")
        assert not (folder / "report.html").exists()
    assert [p.name for p in folder.iterdir()] == ["report.html"]
    finish(folder)
    (folder / "report.html").unlink()
    assert sorted(p.name for p in folder.iterdir()) == ["summary.json", "velocity.nc"]
    assert json.loads((folder / "summary.json").read_text()) == {"vectors": 3, "worst": None, "at": [0, 1]}


def test_a_complete_run_is_kept_unless_overwritten(tmp_path):
    folder = tmp_path / "results"
    finish(folder)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(PlenoPIVError, match="holds a complete run; use --overwrite"), OutputFolder(folder):
        pass
    finish(folder, overwrite=True)
    assert sorted(p.name for p in folder.iterdir()) == ["notes.txt", "summary.json", "velocity.nc"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, PlenoPIVError])
def test_a_failure_leaves_no_trace(tmp_path, error):
    folder = tmp_path / "a" / "results"
    with pytest.raises(error):
        fail(folder, error)
    assert list(tmp_path.iterdir()) == []


def test_a_failure_leaves_the_run_before_it(tmp_path):
    folder = tmp_path / "results"
    finish(folder)
    with pytest.raises(RuntimeError):
        fail(folder, RuntimeError)
    assert (folder / "velocity.nc").read_bytes() == b"field"
    assert sorted(p.name for p in folder.iterdir()) == ["summary.json", "velocity.nc"]


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "results").touch()
    with pytest.raises(PlenoPIVError, match="is a file"), OutputFolder(tmp_path / "results"):
        pass
    with pytest.raises(PlenoPIVError, match="cannot be written"), OutputFolder(tmp_path / "results" / "deeper"):
        pass


def test_a_folder_of_files_moves_as_a_whole_and_other_files_in_it_stay(tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "mine.txt").write_text("mine")
    (tmp_path / "figures" / "velocity.png").write_text("old")
    with OutputFolder(tmp_path) as out:
        out.path("figures").mkdir()
        out.path("figures/velocity.png").write_text("new")
        out.path("figures/summary.json").write_text("not the run's")
        out.write_json("summary.json", {})
        assert (tmp_path / "figures" / "velocity.png").read_text() == "old"
    found = {p.relative_to(tmp_path).as_posix(): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert found == {
        "figures/mine.txt": "mine",
        "figures/velocity.png": "new",
        "figures/summary.json": "not the run's",
        "summary.json": "{}\n",
    }
