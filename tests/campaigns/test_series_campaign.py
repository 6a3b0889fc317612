"""A sample of the campaign with series, of other cases than those recorded; and what it must notice."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import series
import series_faults
from series_damages import _damage
from series_runs import Ended, Series, differences
from series_table import table

ROOT = Path(__file__).parents[2]
WANTED = {
    "velocity.nc": b"\x89HDF",
    "summary.json": b'{"vectors": 12, "machine_speed": 0.61, "timings_s": {"report": 1.5}}',
    "report.html": b"<th>time</th><td>1.5 s</td><tr><th>machine_speed</th><td>0.61</td></tr>"
    b'<tr><rect width="7.6" height="4"></tr>',
    "manifest.jsonl": b'{"lines": 2}\n{"file": "report.html", "sha256": "1", "check": "2"}\n{"file": "velocity.nc"}\n',
}


def test_times_are_no_difference_and_all_else_is():
    other = WANTED | {
        "summary.json": b'{"vectors": 12, "machine_speed": 0.58, "timings_s": {"report": 2.5}}',
        "report.html": b"<th>time</th><td>12.5 s</td><tr><th>machine_speed</th><td>0.58</td></tr>"
        b'<tr><rect width="9.1" height="4"></tr>',
        "manifest.jsonl": WANTED["manifest.jsonl"].replace(b'"1"', b'"3"'),
    }
    assert differences(other, WANTED) == []
    for name, content in {
        "velocity.nc": b"\x89HDG",
        "summary.json": b'{"timings_s": {}, "vectors": 13}',
        "report.html": b"<th>time</th><td>13 vectors</td>",
        "manifest.jsonl": WANTED["manifest.jsonl"].replace(b"velocity", b"gradient"),
        "figures/a.png": b"",
    }.items():
        assert differences(WANTED | {name: content}, WANTED) == [name]
        assert differences(WANTED | {name: b"\xff\xfe"}, WANTED) == [name]
    assert differences({}, WANTED) == sorted(WANTED)


def test_what_is_wrong_with_a_run(tmp_path):
    made = Series(tmp_path, WANTED, 1.0, 2)
    made.clear(whole=True)
    assert made.wrong(Ended(0, 1.0, "", "plenopiv: warning: a\n")) == []
    assert made.wrong(Ended(-11, 1.0, "", "plenopiv: a\n"))[0].startswith("status -11")
    assert made.wrong(Ended(3, 1.0, "", "Traceback\n")) == ["stderr: Traceback"]
    (made.results / "velocity.nc").unlink()
    assert made.wrong(Ended(0, 1.0, "", "")) == ["other files: velocity.nc"]
    error = "plenopiv: error: "
    assert series_faults._wrong(Ended(2, 1.0, "", f"{error}{made.results}/a: b\n"), 2, made) == []
    assert len(series_faults._wrong(Ended(2, 1.0, "", f"{error}no space\n"), 2, made)) == 1
    assert len(series_faults._wrong(Ended(-11, 1.0, "", ""), 2, made)) == 2


def test_damages_are_damages(tmp_path):
    import numpy as np

    for number in range(60):
        path = tmp_path / ("manifest.jsonl" if number % 2 else "velocity.nc")
        path.write_bytes(WANTED[path.name])
        _damage(path, np.random.default_rng(number))
        assert not path.exists() or path.read_bytes() != WANTED[path.name]


def test_the_recorded_campaign_is_whole_and_its_page_is_written():
    results = series.Results(series.RESULTS)
    for kind, (_, counted, wanted) in series.KINDS.items():
        assert results.count(kind, counted) >= wanted
        assert results.failed(kind) == []
    assert all(case["steps"] > 150 for case in results.cases("steps").values())
    assert series.PAGE.read_text() == table(results.kinds, series.SEED)


@pytest.mark.full
def test_a_sample(tmp_path):
    """A kill by the clock and one while results are put in place, damages, two faults where this process may mount."""
    path = tmp_path / "series.json"
    command = [sys.executable, ROOT / "campaigns" / "series.py", "kills", "damages", "faults", "--results", path]
    options = ["--count", "2", "--pairs", "3", "--first", "1027"]
    ended = subprocess.run([*map(str, command), *options], capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    held = json.loads(path.read_text())["kinds"]
    assert sum(len(case["kills"]) for case in held["kills"].values()) >= 2
    assert sum(len(case["damages"]) for case in held["damages"].values()) >= 2
    if series_faults.can_mount():
        assert len(held["faults"]) == 2
