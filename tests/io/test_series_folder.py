"""The results folder of a series: what is kept, found damaged, refused; locks, manifest, velocity.nc of many pairs."""

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray

from plenopiv.errors import PlenoPIVError
from plenopiv.io import manifest
from plenopiv.io.lock import FolderLock
from plenopiv.io.manifest import Manifest
from plenopiv.io.netcdf import read_velocity, write_velocity
from plenopiv.io.series_file import open_series, pair_file, write_series
from plenopiv.io.series_folder import WORK, SeriesFolder

INPUTS = {"versions": {"plenopiv": "1"}, "settings": {"correlation": {"overlap": 0.5}}}
PAIRS = 4


def field(number, value=None):
    shape, axes = (1, 3, 2, 4), {"time": [number + 0.5], "z": [0.0, 1, 2], "y": [0.0, 1], "x": [0.0, 1, 2, 3]}
    values = np.full(shape, float(number if value is None else value)) + np.arange(24).reshape(shape)
    names = {name: (("time", "z", "y", "x"), values + k, {"units": "m s-1"}) for k, name in enumerate("uvw")}
    names["valid"] = (("time", "z", "y", "x"), np.ones(shape, np.int8))
    return xarray.Dataset(names, axes, {"dt_s": 0.5, "source": "a test"})


def measure(folder, number):
    name = pair_file(number)
    write_velocity(folder.path(name), field(number))
    return folder.store({"pair": number, "set_aside": None}, [name])


def session(directory, pairs=range(PAIRS), publish=True, overwrite=False, inputs=INPUTS):
    """A run of pretended pairs; the numbers of those that it measured, and what it found damaged."""
    with SeriesFolder(directory, overwrite) as folder:
        folder.begin(inputs)
        now = {**inputs, "calibration": {"pitch": 0.077}}
        folder.settle(now)
        if folder.is_complete:
            folder.discard()
            return [], folder.words
        measured = [number for number in pairs if number not in folder.finished]
        for number in measured:
            measure(folder, number)
        if publish:
            files = {number: folder.there(pair_file(number)) for number in range(PAIRS)}
            write_series(
                folder.path("velocity.nc"), field(0), {"time": np.arange(PAIRS) + 0.5}, files, {"quality": "good"}
            )
            folder.write_text("summary.json", json.dumps({"inputs_sha256": folder.depends}))
            folder.publish(["velocity.nc", "summary.json"], now)
        return measured, folder.words


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in sorted(directory.rglob("*")) if p.is_file()}


@pytest.fixture
def results(tmp_path):
    assert session(tmp_path / "results")[0] == [0, 1, 2, 3]
    return tmp_path / "results"


def test_a_series_is_one_file_and_one_of_each_pair(results):
    assert set(contents(results)) == {"velocity.nc", "summary.json", "manifest.jsonl", *map(pair_file, range(PAIRS))}
    with open_series(results / "velocity.nc") as velocity:
        assert velocity.u.dims == ("time", "z", "y", "x")
        assert velocity.time.values.tolist() == [0.5, 1.5, 2.5, 3.5]
        for number in range(PAIRS):
            assert (velocity.v.values[number] == field(number).v.values[0]).all()
        assert velocity.attrs["quality"] == "good"
        assert velocity.u.attrs["units"] == "m s-1"


def test_pairs_without_a_file_are_nan_and_not_valid(tmp_path):
    write_velocity(tmp_path / "b.nc", field(1))
    for name in ("velocity.nc", "again.nc"):
        write_series(tmp_path / name, field(1), {"time": [0.5, 1.5]}, {1: tmp_path / "b.nc"}, {})
    velocity = read_velocity(tmp_path / "velocity.nc")
    assert np.isnan(velocity.u.values[0]).all()
    assert velocity.valid.values.sum((1, 2, 3)).tolist() == [0, 24]
    assert velocity.valid.dtype == np.int8
    assert (tmp_path / "velocity.nc").read_bytes() == (tmp_path / "again.nc").read_bytes()


def test_flags_of_the_grid_are_those_of_all_times(tmp_path):
    """A pair without a field has none of its own, but a body is where it was."""
    one = field(1)
    for name in ("inside_body", "near_focus", "near_face"):
        one[name] = one.valid.copy()
    write_velocity(tmp_path / "b.nc", one)
    write_series(tmp_path / "velocity.nc", one, {"time": [0.5, 1.5]}, {1: tmp_path / "b.nc"}, {})
    velocity = read_velocity(tmp_path / "velocity.nc")
    sums = [int(velocity[name][0].sum()) for name in ("inside_body", "near_focus", "near_face", "valid")]
    assert sums == [24, 24, 24, 0]


def test_a_pair_that_is_stored_otherwise_is_copied_all_the_same(tmp_path):
    field(1).to_netcdf(tmp_path / "plain.nc", engine="h5netcdf")
    write_series(tmp_path / "velocity.nc", field(1), {"time": [1.5]}, {0: tmp_path / "plain.nc"}, {})
    assert (read_velocity(tmp_path / "velocity.nc").w.values == field(1).w.values).all()


def test_finished_results_are_left_alone(results):
    before = contents(results)
    assert session(results) == ([], [])
    assert contents(results) == before


def test_what_a_killed_run_finished_is_kept(tmp_path, results):
    stopped = tmp_path / "stopped"
    assert session(stopped, [0, 2], publish=False)[0] == [0, 2]
    assert not (stopped / "velocity.nc").exists()
    assert session(stopped)[0] == [1, 3]
    assert contents(stopped) == contents(results)


def damage(path, how):
    if how == "gone":
        path.unlink()
    elif how == "short":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    else:
        content = bytearray(path.read_bytes())
        content[len(content) // 3] ^= 1
        path.write_bytes(content)


@pytest.mark.parametrize("how", ["flipped", pytest.param("short", marks=pytest.mark.full), "gone"])
@pytest.mark.parametrize(
    ("name", "again"),
    [(pair_file(2), [2]), ("velocity.nc", []), ("summary.json", []), ("manifest.jsonl", None)],
)
def test_only_what_is_damaged_is_made_again(results, how, name, again):
    before = contents(results)
    damage(results / name, how)
    measured, words = session(results)
    assert any(name in line for line in words)
    assert again is None or measured == again
    assert len(measured) < PAIRS or again is None
    assert contents(results) == before
    assert session(results) == ([], [])


@pytest.mark.parametrize("which", [0, 2, 5, -1])
def test_a_line_that_was_taken_out_of_the_manifest_is_missed(results, which):
    before = contents(results)
    lines = (results / "manifest.jsonl").read_text().splitlines(keepends=True)
    del lines[which]
    (results / "manifest.jsonl").write_text("".join(lines))
    measured, words = session(results)
    assert any("manifest.jsonl: 1 line damaged or gone" in line for line in words)
    assert measured == ([1] if which == 2 else [])
    assert contents(results) == before


def test_a_damaged_record_of_a_run_that_was_stopped(tmp_path, results):
    stopped = tmp_path / "stopped"
    session(stopped, [0, 1, 2], publish=False)
    damage(stopped / WORK / "pairs" / "pair-0001.json", "flipped")
    damage(stopped / WORK / "pairs" / "pair-0002.nc", "short")
    measured, words = session(stopped)
    assert measured == [1, 2, 3]
    assert len(words) == 2
    assert contents(stopped) == contents(results)


def test_other_inputs_are_refused_and_named(tmp_path, results):
    other = {**INPUTS, "settings": {"correlation": {"overlap": 0.75}}}
    before = contents(results)
    with pytest.raises(PlenoPIVError, match=r"settings\.correlation\.overlap: was 0\.5, is 0\.75\); use --overwrite"):
        session(results, inputs=other)
    assert contents(results) == before
    session(tmp_path / "stopped", [0], publish=False)
    with pytest.raises(PlenoPIVError, match=r"unfinished run of other inputs \(settings\.correlation\.overlap"):
        session(tmp_path / "stopped", inputs=other)
    assert session(tmp_path / "stopped", inputs=other, overwrite=True)[0] == [0, 1, 2, 3]


def test_another_calibration_is_refused(results):
    with SeriesFolder(results) as folder:
        folder.begin(INPUTS)
        with pytest.raises(PlenoPIVError, match=r"another calibration \(calibration\.pitch: was 0\.077, is 0\.08"):
            folder.settle({**INPUTS, "calibration": {"pitch": 0.08}})
        folder.discard()


def test_other_tiles_are_refused_unless_they_replace_what_there_is(tmp_path):
    """Volumes in tiles have other bits."""
    path, whole, cut = tmp_path / "results", {**INPUTS, "tiles": 1}, {**INPUTS, "tiles": 3}
    said = r"another number of tiles \(tiles: was 1, is 3\); give the same --memory, use --overwrite"
    with SeriesFolder(path) as folder:
        folder.begin(INPUTS)
        folder.settle(whole)
        measure(folder, 0)
    with SeriesFolder(path) as folder:
        folder.begin(INPUTS)
        with pytest.raises(PlenoPIVError, match=said):
            folder.settle(cut)
    with SeriesFolder(path) as folder:
        folder.begin(INPUTS)
        folder.settle(whole)
        assert set(folder.finished) == {0}
    with SeriesFolder(path, overwrite=True) as folder:
        folder.begin(INPUTS)
        folder.settle(cut)
        assert not folder.finished


def test_jobs_that_begin_together_have_the_same_tiles(tmp_path):
    with SeriesFolder(tmp_path / "results", first=0, end=2) as folder:
        folder.begin(INPUTS)
        settled = manifest.line({"inputs": {**INPUTS, "tiles": 1}, "mode": "new"})
        (folder.work / "inputs.json").write_text(settled)  # by a job of other pairs, which began before
        with pytest.raises(PlenoPIVError, match=r"another number of tiles \(tiles: was 1, is 3\)"):
            folder.settle({**INPUTS, "tiles": 3})


def test_results_stay_whole_until_they_are_replaced(results):
    before = contents(results)
    other = {**INPUTS, "settings": {"correlation": {"overlap": 0.75}}}
    session(results, [0, 1], publish=False, overwrite=True, inputs=other)
    kept = {name: content for name, content in contents(results).items() if not name.startswith(WORK)}
    assert kept == before
    assert session(results, inputs=other)[0] == [2, 3]  # goes on with the replacement
    assert Manifest.read(results / manifest.NAME).inputs["settings"] == other["settings"]


def test_files_of_replaced_results_go(results):
    (results / "mine.txt").write_text("a note")
    with SeriesFolder(results, overwrite=True) as folder:
        folder.begin(INPUTS)
        folder.settle(INPUTS)
        write_velocity(folder.path("velocity.nc"), field(0))
        folder.store({"pair": 0, "set_aside": None}, ["velocity.nc"])
        folder.write_text("summary.json", "{}")
        folder.publish(["summary.json"], INPUTS)
    assert set(contents(results)) == {"velocity.nc", "summary.json", "manifest.jsonl", "mine.txt"}


def test_moves_that_were_cut_off_are_ended(tmp_path, results, monkeypatch):
    stopped, moves = tmp_path / "stopped", []
    replace = os.replace

    def once(a, b):
        if WORK not in str(b):
            moves.append(b)
            if len(moves) == 3:
                raise KeyboardInterrupt
        replace(a, b)

    monkeypatch.setattr("plenopiv.io.series_folder.os.replace", once)
    with pytest.raises(KeyboardInterrupt):
        session(stopped)
    assert not (stopped / "summary.json").exists()
    monkeypatch.undo()
    assert session(stopped) == ([], [])
    assert contents(stopped) == contents(results)


def test_a_run_that_fails_at_once_leaves_nothing(tmp_path):
    def begun():
        with SeriesFolder(tmp_path / "new" / "results") as folder:
            folder.begin(INPUTS)
            folder.settle(INPUTS)
            raise PlenoPIVError("no")

    with pytest.raises(PlenoPIVError, match="no"):
        begun()
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_place_of_the_folder(tmp_path):
    (tmp_path / "results").write_text("")
    with pytest.raises(PlenoPIVError, match="is a file"), SeriesFolder(tmp_path / "results"):
        pass


def test_two_runs_in_one_folder(tmp_path):
    with SeriesFolder(tmp_path / "results"):
        with pytest.raises(PlenoPIVError, match="another run works in this folder"), SeriesFolder(tmp_path / "results"):
            pass
        assert (tmp_path / "results" / WORK).exists()


HOLD = """
import sys, time
from pathlib import Path
from plenopiv.io.lock import FolderLock
first, end = (int(word) if word != "None" else None for word in sys.argv[2:])
with FolderLock(Path(sys.argv[1]), first, end):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize(("other", "free"), [((4, 8), True), ((2, 5), False), ((0, None), False)])
def test_locks_between_processes(tmp_path, other, free):
    path = tmp_path / "work" / "lock"
    path.parent.mkdir()
    command = [sys.executable, "-c", HOLD, str(path), "0", "4"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        try:
            if free:
                with FolderLock(path, *other) as lock:
                    assert not lock.alone()
            else:
                with pytest.raises(PlenoPIVError, match="another run works in this folder"), FolderLock(path, *other):
                    pass
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
    with FolderLock(path, *other) as lock:  # a killed run leaves none behind
        assert lock.alone()
    assert "pairs 0 to 3" in path.read_text()


def test_the_manifest_knows_each_flipped_bit():
    made = Manifest(INPUTS, {0: {"pair": 0, "files": {"a": "1"}}}, {"b": "2"}).text()
    rng = np.random.default_rng(0)
    for _ in range(200):
        content = bytearray(made.encode())
        at, bit = int(rng.integers(len(content))), int(rng.integers(7))
        content[at] ^= 1 << bit
        lines = content.decode(errors="replace").split("\n")[: made.count("\n")]
        found = [manifest.whole(line) for line in lines]
        assert None in found or content.count(b"\n") != made.count("\n")


def test_time_of_a_lock_and_who_holds_it(tmp_path):
    with FolderLock(tmp_path / "lock"):
        line = (tmp_path / "lock").read_text()
    assert f"process {os.getpid()}, {time.strftime('%Y')}" in line
    assert line.endswith("all pairs\n")


def test_inputs_that_only_one_of_both_runs_has_are_named(results):
    with pytest.raises(PlenoPIVError, match="ensemble: was null, is "):
        session(results, inputs=INPUTS | {"ensemble": {"pairs": [4]}})
    assert session(results, overwrite=True, inputs=INPUTS | {"ensemble": {"pairs": [4]}})[0] == [0, 1, 2, 3]
    with pytest.raises(PlenoPIVError, match=r"ensemble: was .*, is null"):
        session(results)


def test_what_the_pairs_that_are_there_were_calibrated_as_is_known_before_it_is_settled(results, tmp_path):
    for directory in (results, tmp_path / "unfinished"):
        session(directory, publish=False)
        for _ in range(2):  # the second time after a run that was killed before it had settled
            with SeriesFolder(directory) as folder:
                assert folder.calibration is None
                folder.begin(INPUTS)
                assert folder.calibration == {"pitch": 0.077}
    with SeriesFolder(tmp_path / "new") as folder:
        folder.begin(INPUTS)
        assert folder.calibration is None


def test_results_that_are_replaced_say_nothing_of_a_calibration(results):
    with SeriesFolder(results, overwrite=True) as folder:
        folder.begin(INPUTS)
        assert folder.calibration is None


def test_a_run_of_some_pairs_looks_at_those_alone(results):
    (results / pair_file(3)).unlink()
    with SeriesFolder(results, first=1, end=3) as folder:
        folder.begin(INPUTS)
        folder.settle({**INPUTS, "calibration": {"pitch": 0.077}})
        assert set(folder.finished) == {1, 2}
        assert folder.words == []
        assert folder.recorded() == PAIRS
        measure(folder, 1)
        assert folder.recorded() == PAIRS


def test_what_another_command_still_writes_is_not_swept(results):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    alive, dead = (results / f".s.nc.{socket.gethostname()}-{pid}.part" for pid in (os.getppid(), ended.pid))
    elsewhere = results / f".s.nc.another-host-{os.getppid()}.part"
    for path in (alive, dead, elsewhere):
        path.touch()
    with SeriesFolder(results):
        pass
    assert [path.exists() for path in (alive, dead, elsewhere)] == [True, False, False]
