"""The fuzzing campaign: cases follow from a seed, what a command must not do is seen, and a stop costs nothing."""

import json
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from fuzz_cases import COUNT, KINDS, Case, Prepared, cases
from fuzz_mutations import BYTES, TEXT, as_json, as_toml, change_tables
from fuzz_results import Results
from fuzz_runs import Outcome, wrong
from fuzz_table import table

ROOT = Path(__file__).parents[2]
ERROR = "plenopiv: error: a.toml: is empty\n"


def test_the_cases_are_those_of_the_seed():
    every = cases()
    assert len(every) == len({case.name for case in every}) == COUNT == 3000
    assert {kind: sum(case.kind == kind for case in every) for kind in KINDS} == dict.fromkeys(KINDS, 600)
    assert cases(50) == every[:50]
    draws = [[case.random().random() for case in some] for some in (every[:9], cases(9), cases(9, seed=1))]
    assert draws[0] == draws[1] != draws[2]


@pytest.mark.parametrize("change", [*BYTES, *TEXT], ids=lambda change: change.__name__)
def test_changes_of_bytes_are_those_of_the_generator_and_take_anything(change):
    whole = b'[camera]\nrows = 224\npitch_mm = 0.077\nnames = ["a.tif", "b.tif"]\n' * 3
    made = [change(Case("optics", n).random(), whole) for n in range(30)]
    assert made == [change(Case("optics", n).random(), whole) for n in range(30)]
    assert sum(data != whole for data in made) > 10
    for data in (b"", b"\xff", b"1"):
        assert isinstance(change(Case("optics", 1).random(), data), bytes)


def test_changed_tables_leave_the_whole_ones_and_can_be_written():
    tables = {"camera": {"rows": 224, "pitch_mm": 0.077}, "frames": ["a.tif", "b.tif"]}
    before = json.dumps(tables)
    made = [change_tables(Case("optics", n).random(), tables) for n in range(300)]
    assert json.dumps(tables) == before
    assert sum(json.dumps(m, default=str) != before for m in made) > 250
    assert all(as_json(m) and isinstance(as_toml(m), bytes) for m in made)


def judged(status=2, command="info", seconds=0.1, memory=1e8, out="", err=ERROR, changes=(), left=()):
    case = Prepared({}, "run 7/a.toml", [command, "run 7/a.toml"])
    return wrong(case, status, seconds, memory, out, err, list(changes), list(left))


def test_what_a_command_may_do():
    assert judged() == []
    assert judged(0, out="two vectors\n", err="plenopiv: warning: a\nplenopiv: white image: 2.6 s\n") == []
    assert judged(0, "init", err="", changes=["changed run 7/experiment.toml"]) == []
    assert judged(2, "check", out="run 7: not usable as it is\n", err="", changes=["left run 7/look"]) == []
    assert judged(err="plenopiv: error: recording.frames: no file matches\n") == []


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"status": 1}, "exit status 1"),
        ({"status": -11, "err": ""}, "ended by signal 11"),
        ({"status": 1, "err": "Traceback (most recent call last):\n  x\nKeyError: 'a'\n"}, "traceback: KeyError: 'a'"),
        ({"status": None, "seconds": 10.2}, "took longer than 10 s"),
        ({"status": None, "memory": 2.1e9}, "took more than 2 GB"),
        ({"err": ""}, "0 lines of error with exit status 2"),
        ({"status": 0}, "1 lines of error with exit status 0"),
        ({"err": ERROR * 2}, "2 lines of error"),
        ({"err": "Exception ignored in: <File>\n" + ERROR}, "stderr: Exception ignored in"),
        ({"err": "plenopiv: error: no such thing\n"}, "names no file or key"),
        ({"err": f"plenopiv: error: a.toml: {'a' * 2000}\n"}, "a line of 2025 letters"),
        ({"changes": ["left .velocity.nc.123.part"]}, "left .velocity.nc.123.part"),
        ({"changes": ["changed run 7/a.toml"]}, "changed run 7/a.toml"),
        ({"command": "init", "changes": ["changed run 7/experiment.toml"]}, "changed run 7/experiment.toml"),
        ({"command": "export", "status": 0, "err": "", "changes": ["left out.txt", "left x"]}, "left x"),
        ({"left": ["tmp123"]}, "left tmp123 among temporary files"),
    ],
)
def test_what_it_must_not(told, why):
    assert any(reason.startswith(why) for reason in judged(**told))


PLANTED = """
    import json, os, sys, time
    from pathlib import Path
    sys.path.insert(0, {campaigns!r})
    import fuzz_runs, plenopiv.cli
    from fuzz_cases import Prepared

    class Noisy:
        def __del__(self):
            raise ValueError("cannot be closed")

    def main(command):
        what = command[1]
        if what == "hangs":
            time.sleep(60)
        elif what == "takes memory":
            held = bytearray(b"1" * 900_000_000)
        elif what == "raises":
            raise KeyError(what)
        elif what == "crashes":
            os.abort()
        elif what == "is noisy":
            loop = [Noisy()]
            loop.append(loop)
        elif what == "writes":
            Path("half.part").write_text("a")
            Path(os.environ["TMPDIR"], "b").write_text("b")
        return 0

    plenopiv.cli.main = main
    fuzz_runs.prepared = lambda case, corpus, draw: Prepared({{"a.toml": b"a"}}, "a.toml", ["info", case.kind])
    fuzz_runs.MEMORY, fuzz_runs.TRIES = 5e8, 1
    work = Path(sys.argv[1])
    kinds = "is good", "hangs", "takes memory", "raises", "crashes", "is noisy", "writes"
    from fuzz_cases import Case
    outcomes = {{}}
    for kind in kinds:
        fuzz_runs.SECONDS = 2.0 if kind == "hangs" else 30.0
        outcomes[kind] = fuzz_runs.tried(Case(kind, 0), work, work)
    print(json.dumps({{kind: [o.result, o.why, o.seconds, o.memory_gb] for kind, o in outcomes.items()}}))
"""


@pytest.mark.full
def test_the_limits_hold_and_each_fault_is_seen(tmp_path):
    """In processes of their own: none of them may end the campaign."""
    script = tmp_path / "planted.py"
    script.write_text(textwrap.dedent(PLANTED).format(campaigns=str(ROOT / "campaigns")))
    ended = subprocess.run([sys.executable, str(script), str(tmp_path)], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["is good"][:2] == ["read", ""]
    assert 0.01 < found["is good"][3] < 0.5
    for kind, why in {
        "hangs": "took longer than 2 s",
        "takes memory": "took more than 0 GB",
        "raises": "exit status 1; traceback: KeyError: 'raises'",
        "crashes": "ended by signal 6",
        "is noisy": "traceback: ValueError: cannot be closed",
        "writes": "left half.part; left b among temporary files",
    }.items():
        assert found[kind][0] == "failed", kind
        assert why in found[kind][1], kind
    assert found["hangs"][2] < 10
    assert found["takes memory"][3] < 2


def test_results_go_on_where_they_were(tmp_path):
    path = tmp_path / "kept" / "fuzz.json"
    results = Results(path, seed=3)
    first, second, third = (Case("image", n, 3) for n in range(3))
    results.add(first, Outcome("read", "", 0.5, 0.2, ""))
    results.add(second, Outcome("failed", "exit status 1", 2.0, 0.1, ""))
    results.save()
    results = Results(path, seed=3)
    assert [results.tried(case) for case in (first, second, third)] == [True, True, False]
    assert results.failed == {"image:1": "exit status 1"}
    results.add(second, Outcome("refused", "", 0.1, 0.3, ""), again=True)
    assert results.failed == {}
    held = results.of("image")
    assert (held["cases"], held["read"], held["refused"]) == (2, 1, 1)
    assert (held["slowest"]["case"], held["largest"]["case"]) == (1, 1)
    assert not Results(path, seed=4).tried(first)
    assert [p.name for p in path.parent.iterdir()] == ["fuzz.json"]


def campaign(*arguments):
    command = [sys.executable, str(ROOT / "campaigns" / "fuzz.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=os.environ | {"NO_COLOR": "1"})


def test_the_results_that_are_kept_are_those_of_all_cases():
    """And none of them failed."""
    held = json.loads((ROOT / "campaigns" / "results" / "fuzz.json").read_text())
    assert sum(kind["cases"] for kind in held["kinds"].values()) == COUNT
    assert all(kind["read"] + kind["refused"] == kind["cases"] for kind in held["kinds"].values())
    results = Results(ROOT / "campaigns" / "results" / "fuzz.json")
    assert not results.failed
    assert (ROOT / "docs" / "fuzzing.md").read_text() == table(results)


@pytest.mark.full
def test_two_hundred_cases_of_another_seed(tmp_path):
    """Of each kind some are read and some refused; the campaign is stopped and goes on."""
    out = tmp_path / "fuzz.json"
    began = campaign("--seed", "26", "--count", "15", "--results", str(out))
    assert began.returncode == 0, began.stdout + began.stderr
    ended = campaign("--seed", "26", "--count", "200", "--results", str(out))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "[100/185]" in ended.stdout
    lines = re.findall(r"^(\w+): 40 cases, (\d+) read, (\d+) refused, 0 failed", ended.stdout, re.MULTILINE)
    assert [kind for kind, _, _ in lines] == list(KINDS)
    assert all(int(read) > 0 and int(refused) > 0 for _, read, refused in lines)
