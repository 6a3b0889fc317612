"""A preview: the right velocities from the middle of the field, beside results that it does not touch."""

import numpy as np
import pytest
import xarray as xr
from conftest import VELOCITY_M_S

from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.io.manifest import Manifest, hash_of
from plenopiv.run.preview import changed_since, cropped, not_of_a_preview, preview


@pytest.mark.full
def test_a_preview_measures_the_middle_and_leaves_results_alone(experiment):
    results = experiment.output_directory
    results.mkdir()
    (results / "velocity.nc").write_bytes(b"mine")
    found = preview(experiment)
    assert [path.name for path in results.iterdir()] == ["velocity.nc"]
    assert (results / "velocity.nc").read_bytes() == b"mine"
    folder = experiment.folder / "preview"
    assert found.directory == folder
    assert (folder / "preview.png").read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(folder / "velocity.nc", engine="h5netcdf") as stored:
        measured = [float(stored[name].median()) for name in "uvw"]
    voxel_m_s = np.array([36 / 2100, 36 / 2100, 0.077]) * 1e-3 / 0.0005
    assert (np.array(measured) - VELOCITY_M_S) / voxel_m_s == pytest.approx([0, 0, 0], abs=0.4)
    again = Experiment.load(folder / "experiment.toml")  # a recording of its own
    assert len(again.recording()) == 2
    assert again.recording().white().shape == (again.camera().sensor.rows, again.camera().sensor.columns)
    assert not [path for path in experiment.folder.iterdir() if path.name.startswith(".preview-")]
    assert not_of_a_preview(folder) == []


def test_a_preview_is_known_by_what_its_manifest_names(tmp_path):
    """All that a run writes, whatever it may be, so that a second preview can replace it."""
    assert not_of_a_preview(tmp_path / "preview") == []
    of_pair, others = ["velocity.nc", "volume-a.h5"], ["experiment.toml", "figures/lattice.png", "report.html"]
    manifest = Manifest({}, {0: {"pair": 0, "files": dict.fromkeys(of_pair, "")}}, dict.fromkeys(others, ""))
    (tmp_path / "manifest.jsonl").write_text(manifest.text())
    for name in (*of_pair, *others, "preview.png", "images/a.tif"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert not_of_a_preview(tmp_path) == []
    (tmp_path / "notes.txt").touch()
    assert not_of_a_preview(tmp_path) == ["notes.txt"]


def test_what_is_cropped_is_seen_by_every_view(experiment):
    part, tables = cropped(experiment)
    sensor = experiment.camera().sensor
    assert part.columns < sensor.columns
    assert (sensor.columns - part.columns) % 2 == (sensor.rows - part.rows) % 2 == 0  # the axis stays where it was
    small = Experiment.from_dict(tables, experiment.path)
    assert small.warnings() == []
    assert small.grid().size < experiment.grid().size / 3
    assert all(s <= w for s, w in zip(small.correlation.windows[0], experiment.correlation.windows[0], strict=True))


def test_inner_windows_of_a_preview_are_those_of_its_own_windows(experiment):
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["correlation"]["inner_window"] = list(experiment.correlation.windows[-1])
    _, quick = cropped(Experiment.from_dict(tables, experiment.path))
    assert "inner_window" not in quick["correlation"]


def test_a_preview_follows_drift_where_the_run_does_and_keeps_no_volumes(experiment, monkeypatch):
    def stopped(small, *arguments, **options):
        raise PlenoPIVError(f"drift {small.recording_table.drift}, volumes {small.output.volumes}")

    monkeypatch.setattr("plenopiv.run.preview.run", stopped)
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["output"]["volumes"] = True
    for drift in ("auto", "none"):
        tables["recording"]["drift"] = drift
        with pytest.raises(PlenoPIVError, match=f"drift {drift}, volumes False"):
            preview(Experiment.from_dict(tables, experiment.path))


def test_a_preview_that_cannot_be(experiment):
    tables = experiment.model_dump(by_alias=True, exclude_none=True)
    tables["volume"]["x_mm"] = [0.1, 0.7]
    tables["correlation"]["windows"] = [[32, 32, 16]]
    with pytest.raises(PlenoPIVError, match="leaves out the optical axis"):
        preview(Experiment.from_dict(tables, experiment.path))
    (experiment.folder / "preview").mkdir()
    (experiment.folder / "preview" / "notes.txt").write_text("mine")
    with pytest.raises(PlenoPIVError, match="holds something else than a preview"):
        preview(experiment)
    assert (experiment.folder / "preview" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("kind", ["link", "file"])
def test_a_preview_is_no_link(experiment, tmp_path, kind):
    """Found before it is measured."""
    place = experiment.folder / "preview"
    place.symlink_to(tmp_path) if kind == "link" else place.write_text("a note")
    with pytest.raises(PlenoPIVError, match=rf"preview: is no folder but a {kind}; move it away"):
        preview(experiment)


def test_an_experiment_file_that_was_changed_is_not_replaced(experiment):
    folder = experiment.folder / "preview"
    folder.mkdir()
    file = folder / "experiment.toml"
    file.write_text("as written")
    (folder / "manifest.jsonl").write_text(Manifest({}, {}, {"experiment.toml": hash_of(file)}).text())
    assert not changed_since(folder)
    file.write_text("iterations = 9")
    with pytest.raises(PlenoPIVError, match=r"preview/experiment\.toml: was changed, and a preview would replace it"):
        preview(experiment)
    assert file.read_text() == "iterations = 9"
