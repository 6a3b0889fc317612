"""A series ended at any step of its work on files, killed or by a full disk: what is there afterwards is whole."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
PROGRAM = """
import json, shutil, sys
from pathlib import Path
import numpy as np, xarray
from folder_steps import *

work, how, stride = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
shape, axes = (1, 3, 2, 4), {"time": [0.0], "z": [0.0, 1, 2], "y": [0.0, 1], "x": [0.0, 1, 2, 3]}
like = xarray.Dataset({name: (("time", "z", "y", "x"), np.ones(shape)) for name in ("u", "v", "w", "valid")}, axes)
end = {"kill": killed_at, "full": failing_from, "once": lambda *a: failing_from(*a, once=True)}[how]
first, second = lambda at: (lambda: session(at, like)), lambda at: (lambda: session(at, like, 0.75, True))
assert child(first(work / "one"))[0] == 0 and child(second(work / "two"))[0] == 0
one, two = contents(work / "one"), contents(work / "two")
wrong, cases = [], 0
for begun in ("new", "replacing", "damaged"):
    at = work / "at"
    made, wanted = (second(at), two) if begun == "replacing" else (first(at), one)

    def prepare():
        shutil.rmtree(at, ignore_errors=True)
        if begun != "new":
            shutil.copytree(work / "one", at)
        if begun == "damaged":
            (at / "pairs" / "pair-0001.nc").write_bytes(b"")

    prepare()
    for n in range(1, steps_of(at, made) + 1, stride):
        prepare()
        status, said = end(n, at, made)
        cases += 1
        here = f"{begun} {how} {n}: "
        before = contents(at) if at.exists() else {}
        shown = {name: content for name, content in before.items() if not name.startswith(".plenopiv")}
        if how != "kill" and (status != 2 or str(at) not in said) and (status != 0 or shown != wanted):
            wrong.append(f"{here}status {status}, {said[-800:]}")
        if begun == "replacing" and before.get("summary.json") == one["summary.json"]:
            if shown != one:
                wrong.append(f"{here}not whole: {[name for name in one if shown.get(name) != one[name]]}")
        stored = sum(name.startswith(".plenopiv/pairs/") and name.endswith(".json") for name in before)
        status, said = child(made)
        if status != 0:
            wrong.append(f"{here}the next run: status {status}, {said[-800:]}")
        elif contents(at) != wanted:
            now = contents(at)
            other = sorted(name for name in now.keys() | wanted.keys() if now.get(name) != wanted.get(name))
            wrong.append(f"{here}other files: {other}")
        elif begun == "new" and len(json.loads(said)) > PAIRS - stored:
            wrong.append(f"{here}{said} measured, though {stored} were stored")
print(json.dumps([cases, wrong]))
"""


def tried(folder, how, stride):
    environment = {**os.environ, "PYTHONPATH": f"{HERE}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-c", PROGRAM, str(folder), how, str(stride)]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600, check=False)
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.full
def test_killed_at_some_steps(tmp_path):
    cases, wrong = tried(tmp_path, "kill", 83)
    assert wrong == []
    assert cases > 4


@pytest.mark.full
@pytest.mark.parametrize("how", ["kill", "full", "once"])
def test_ended_at_any_step(tmp_path, how):
    cases, wrong = tried(tmp_path, how, 1)
    assert wrong == []
    assert cases > 150
