"""What lies beside results and is of others is said: nobody sees it on the files."""

import json
import warnings

import pytest
from test_series_folder import INPUTS, field, measure, session

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.io.beside import unfinished
from plenopiv.io.netcdf import read_velocity, write_velocity
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.io.series_statistics import fields_of, statistics_of

OTHER = {**INPUTS, "settings": {"correlation": {"overlap": 0.5}, "recording": {"dt_s": 1.0}}}
FIRST = {**INPUTS, "settings": {"correlation": {"overlap": 0.7}, "recording": {"dt_s": 0.5}}}


def changed(folder, value):
    """The same run again, of other pairs."""
    with SeriesFolder(folder, overwrite=True) as series:
        series.begin(FIRST)
        now = {**FIRST, "calibration": {"pitch": 0.077}}
        series.settle(now)
        write_velocity(series.path("velocity.nc"), field(0, value))
        series.write_text("summary.json", json.dumps({"inputs_sha256": series.depends}))
        series.publish(["velocity.nc", "summary.json"], now)


@pytest.mark.parametrize("name", ["statistics.nc", "phase-statistics.nc"])
def test_statistics_of_earlier_results_are_told_of(tmp_path, name):
    changed(tmp_path, 1.0)
    (tmp_path / name).write_bytes(b"of the first")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        changed(tmp_path, 1.0)  # the same vectors again
    with pytest.warns(PlenoPIVWarning, match=rf"{name}: is of the earlier results; plenopiv statistics .*--overwrite"):
        changed(tmp_path, 2.0)
    assert (tmp_path / name).read_bytes() == b"of the first"


def test_tracks_and_vectors_of_other_images_in_one_folder(tmp_path):
    """The one that comes later tells, whichever it is; how images were evaluated may differ."""
    tracked = {**FIRST, "tracking": {"method": "two-frame"}}
    session(tmp_path / "tracking", inputs=tracked)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        session(tmp_path, inputs={**FIRST, "settings": {**FIRST["settings"], "correlation": {"overlap": 0.2}}})
    with pytest.warns(
        PlenoPIVWarning, match=r"tracking: its tracks are of other inputs \(recording\.dt_s: was 0\.5, is"
    ):
        session(tmp_path, inputs=OTHER, overwrite=True)
    with pytest.warns(PlenoPIVWarning, match=r": its velocity\.nc are of other inputs \(recording\.dt_s: was 1\.0, is"):
        session(tmp_path / "tracking", inputs={**tracked, "files": {}}, overwrite=True)


def test_a_run_that_is_not_finished_is_told_of(tmp_path):
    assert unfinished(tmp_path) == ""
    session(tmp_path, pairs=range(3), publish=False)
    words = r"a run that is not finished has 3 pairs so far; plenopiv run with its experiment file goes on with it"
    for read in (lambda: read_velocity(tmp_path / "velocity.nc"), lambda: next(fields_of(tmp_path))):
        with pytest.raises(PlenoPIVError, match=rf"velocity\.nc: no such file; {words}"):
            read()
    session(tmp_path)
    with SeriesFolder(tmp_path, overwrite=True) as folder:
        folder.begin(OTHER)
        folder.settle({**OTHER, "calibration": {"pitch": 0.077}})
        measure(folder, 1)
    for read in (lambda: read_velocity(tmp_path / "velocity.nc"), lambda: next(fields_of(tmp_path))):
        with pytest.warns(PlenoPIVWarning, match=r"velocity\.nc: is of earlier results: .* has 1 pair so far"):
            read()


def test_ensembles_have_no_statistics_in_time(tmp_path):
    of_phases = field(0).assign(pairs=("time", [8]))
    write_velocity(tmp_path / "velocity.nc", of_phases)
    with pytest.raises(
        PlenoPIVError, match=r"velocity\.nc: is of ensembles, means over the pairs of a phase or of all"
    ):
        statistics_of(tmp_path)
