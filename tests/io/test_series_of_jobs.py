"""A results folder that several runs share, and what dead ones left: array jobs, staging folders, odd manifests."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from test_series_folder import INPUTS, PAIRS, contents, field, session

from plenopiv.errors import PlenoPIVError
from plenopiv.io import OutputFolder, manifest
from plenopiv.io.manifest import Manifest, Records
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.output import made_stage, sweep_stages
from plenopiv.io.series_file import pair_file
from plenopiv.io.series_folder import WORK, SeriesFolder

OTHER = {**INPUTS, "settings": {"correlation": {"overlap": 0.75}}}


@pytest.fixture
def results(tmp_path):
    session(tmp_path / "results")
    return tmp_path / "results"


def test_what_a_killed_run_wrote_does_not_pass_for_a_damaged_result(results):
    """It was killed between the field of a damaged pair and its record."""
    before = contents(results)
    (results / pair_file(2)).write_bytes(b"damaged")
    with SeriesFolder(results) as folder:
        folder.begin(INPUTS)
        folder.settle({**INPUTS, "calibration": {"pitch": 0.077}})
        assert 2 not in folder.finished
        write_velocity(folder.path(pair_file(2)), field(2))
    measured, words = session(results)
    assert measured == [2]
    assert any("pair-0002.nc: is damaged; pair 2 is measured again" in line for line in words)
    assert contents(results) == before


def test_files_that_no_record_lists_are_removed_from_the_work_folder(tmp_path, results):
    stopped = tmp_path / "stopped"
    session(stopped, [0, 2], publish=False)
    (stopped / WORK / "figures").mkdir()
    (stopped / WORK / "figures" / "old.png").write_bytes(b"half")
    write_velocity(stopped / WORK / pair_file(1), field(3))
    assert session(stopped)[0] == [1, 3]
    assert contents(stopped) == contents(results)


def test_each_byte_of_the_manifest_counts(results):
    """Also those that JSON does not mind: blanks, line ends, capitals of numbers."""
    path = results / manifest.NAME
    whole = path.read_bytes()
    assert Manifest.read(path).damaged == 0
    rng = np.random.default_rng(1)
    spoilt = [whole[:-1], whole + b"\n", whole + whole.splitlines()[1] + b"\n", whole.replace(b"\n", b"\r\n")]
    spoilt += [whole.replace(b": ", b":\t", 1), whole.replace(b'"inputs"', b'"\\u0069nputs"', 1), b""]
    for _ in range(100):
        content = bytearray(whole)
        content[rng.integers(len(content))] ^= int(rng.integers(1, 256))
        spoilt.append(bytes(content))
    for content in spoilt:
        path.write_bytes(content)
        assert Manifest.read(path).damaged > 0


def test_inputs_are_known_from_any_record(results):
    before = contents(results)
    lines = (results / manifest.NAME).read_text().splitlines(keepends=True)
    (results / manifest.NAME).write_text("".join(lines[1:]))
    (results / "summary.json").unlink()
    measured, words = session(results)
    assert measured == []
    assert len(words) == 2
    assert contents(results) == before
    (results / manifest.NAME).write_text("")
    (results / "summary.json").unlink()
    with pytest.raises(PlenoPIVError, match=r"manifest\.jsonl: is damaged, and nothing says what"):
        session(results)


def test_damaged_inputs_of_a_stopped_run(tmp_path, results):
    stopped = tmp_path / "stopped"
    session(stopped, [0, 2], publish=False)
    (stopped / WORK / "inputs.json").write_text("{")
    assert session(stopped)[0] == [1, 3]
    assert contents(stopped) == contents(results)


def test_records_are_held_as_they_are_read(results):
    records = Records({1: {"b": (1.5, float("nan")), "a": {"x": np.float64(2)}}})
    assert list(records[1]) == ["a", "b"]
    assert records[1] == {"a": {"x": 2.0}, "b": [1.5, None]}
    assert dict(Manifest.read(results / manifest.NAME).pairs).keys() == set(range(PAIRS))


JOB = """
import sys
from test_series_of_jobs import *
folder = SeriesFolder(Path(sys.argv[1]), overwrite=True, first=int(sys.argv[2]), end=int(sys.argv[3]))
with folder:
    folder.begin(INPUTS if sys.argv[4] == "same" else OTHER)
    folder.settle({**(INPUTS if sys.argv[4] == "same" else OTHER), "calibration": {"pitch": 0.077}})
    measure(folder, int(sys.argv[2]))
    print(folder.recorded(), flush=True)
    sys.stdin.readline()
"""


def job(results, first, end, which="same"):
    program = "from pathlib import Path\nfrom test_series_folder import measure\n" + JOB
    command = [sys.executable, "-c", program, str(results), str(first), str(end), which]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, cwd=__file__.rsplit("/", 1)[0], **pipes)


@pytest.mark.full
def test_jobs_that_replace_results_do_not_undo_each_other(tmp_path, results):
    """The first one forgets an unfinished run of other inputs; the second one keeps what the first has."""
    session(results, [3], publish=False, overwrite=True, inputs=OTHER)
    with job(results, 0, 2) as first:
        assert first.stdout.readline() == "1\n"
        with job(results, 2, 4) as second:
            assert second.stdout.readline() == "2\n"
            second.communicate("\n")
        with job(results, 2, 4, "other") as third:
            assert "another run, of other inputs (settings.correlation.overlap: was 0.5" in third.communicate("\n")[1]
        first.communicate("\n")
    assert session(results)[0] == [1, 3]  # the replacement goes on
    assert first.returncode == second.returncode == 0


def test_a_job_does_not_discard_what_others_work_on(results):
    with job(results, 0, 1) as other:
        assert other.stdout.readline() == "1\n"
        with SeriesFolder(results, first=1, end=2) as folder:
            folder.discard()
        assert (results / WORK / "pairs" / "pair-0000.json").exists()
        other.communicate("\n")


STAGE = """
import sys, time
from plenopiv.io import OutputFolder
with OutputFolder(sys.argv[1], overwrite=True) as out:
    out.write_text("a.txt", "half")
    print("staged", flush=True)
    time.sleep(60)
"""


def test_staging_folders_of_dead_commands_are_swept(tmp_path):
    with subprocess.Popen([sys.executable, "-c", STAGE, str(tmp_path)], stdout=subprocess.PIPE, text=True) as command:
        assert command.stdout.readline() == "staged\n"
        with OutputFolder(tmp_path, overwrite=True) as out:  # the other one works: its stage stays
            out.write_text("b.txt", "whole")
        stages = list(tmp_path.glob(".plenopiv-*"))
        assert len(stages) == 1
        command.send_signal(signal.SIGKILL)
        command.wait()
    (tmp_path / ".plenopiv-mine").mkdir()  # of an older version: nothing says whose it is
    with OutputFolder(tmp_path, overwrite=True) as out:
        out.write_text("c.txt", "whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".plenopiv-mine", "b.txt", "c.txt"]


def test_stages_of_a_prefix(tmp_path):
    stage, lock = made_stage(tmp_path, ".preview-")
    sweep_stages(tmp_path, ".preview-")
    assert stage.exists()
    lock.__exit__()
    sweep_stages(tmp_path, ".other-")
    assert stage.exists()
    sweep_stages(tmp_path, ".preview-")
    assert json.dumps(list(map(str, tmp_path.iterdir()))) == "[]"
