"""A pretended series (``pretended_series``) ended at any step of its work on files: what is there afterwards is whole.

A run is ended at one step, killed or by a full disk, in three folders: an empty one, one with results that the run
replaces, and one with a damaged pair. Results that were there must stay or be replaced as a whole, and the next run
must come to those of an undisturbed one without measuring a stored pair again.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
WAYS = ("kill", "full", "once")  # killed; a disk that is full from a step on, or at it alone
PROGRAM = """
import json, sys
from pathlib import Path
from series_steps import ended

folder, way, stride = sys.argv[1:]
print(json.dumps(ended(Path(folder), way, int(stride))))
"""
MOST_S = 3600


def tried(folder: Path, number: int, stride: int = 1) -> dict[str, Any]:
    """Way ``number``, at each ``stride``-th step, in a process of its own: forks of one with threads may hang."""
    way = WAYS[number % len(WAYS)]
    paths = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH", "")]))
    environment = {**os.environ, "PYTHONPATH": paths}
    command = [sys.executable, "-c", PROGRAM, str(folder / way), way, str(stride)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=MOST_S, check=False)
    if done.returncode != 0:
        return {"ways": [way], "steps": 0, "why": [done.stderr]}
    steps, wrong = json.loads(done.stdout)
    return {"ways": [way], "steps": steps, "why": wrong or None}


def ended(work: Path, way: str, stride: int) -> tuple[int, list[str]]:
    """How many steps a run was ended at, and what was wrong then."""
    import numpy as np
    import xarray
    from pretended_series import PAIRS, child, contents, failing_from, killed_at, session, steps_of

    shape, axes = (1, 3, 2, 4), {"time": [0.0], "z": [0.0, 1, 2], "y": [0.0, 1], "x": [0.0, 1, 2, 3]}
    like = xarray.Dataset({name: (("time", "z", "y", "x"), np.ones(shape)) for name in ("u", "v", "w", "valid")}, axes)
    end = {"kill": killed_at, "full": failing_from, "once": partial(failing_from, once=True)}[way]

    def first(at: Path) -> Callable[[], list[int]]:
        return lambda: session(at, like)

    def second(at: Path) -> Callable[[], list[int]]:
        return lambda: session(at, like, 0.75, overwrite=True)

    if child(first(work / "one"))[0] != 0 or child(second(work / "two"))[0] != 0:
        return 0, ["the undisturbed runs failed"]
    one, two, at = contents(work / "one"), contents(work / "two"), work / "at"
    wrong, steps = [], 0
    for begun in ("new", "replacing", "damaged"):
        made, wanted = (second(at), two) if begun == "replacing" else (first(at), one)
        _prepare(at, begun, work / "one")
        for n in range(1, steps_of(at, made) + 1, stride):
            _prepare(at, begun, work / "one")
            status, said = end(n, at, made)
            steps += 1
            here = f"{begun} {way} {n}: "
            before = contents(at) if at.exists() else {}
            shown = {name: content for name, content in before.items() if not name.startswith(".plenopiv")}
            if way != "kill" and (status != 2 or str(at) not in said) and (status != 0 or shown != wanted):
                wrong.append(f"{here}status {status}, {said[-800:]}")
            if begun == "replacing" and before.get("summary.json") == one["summary.json"] and shown != one:
                wrong.append(f"{here}not whole: {[name for name in one if shown.get(name) != one[name]]}")
            stored = sum(name.startswith(".plenopiv/pairs/") and name.endswith(".json") for name in before)
            status, said = child(made)
            now = contents(at)
            if status != 0:
                wrong.append(f"{here}the next run: status {status}, {said[-800:]}")
            elif now != wanted:
                other = sorted(name for name in now.keys() | wanted.keys() if now.get(name) != wanted.get(name))
                wrong.append(f"{here}other files: {other}")
            elif begun == "new" and len(json.loads(said)) > PAIRS - stored:
                wrong.append(f"{here}{said} measured, though {stored} were stored")
    return steps, wrong


def _prepare(at: Path, begun: str, whole: Path) -> None:
    shutil.rmtree(at, ignore_errors=True)
    if begun != "new":
        shutil.copytree(whole, at)
    if begun == "damaged":
        (at / "pairs" / "pair-0001.nc").write_bytes(b"")
