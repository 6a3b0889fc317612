"""Faults while a series is measured: disk full, read-only, inputs gone, signals, a second run in the folder.

A fault ends the run with one line that names the file and exit code 2, a signal with 128 and its number; the next run,
once the cause is gone, keeps what was finished and leaves the results of an undisturbed run. The results folder is a
small file system in memory (tmpfs), filled up or made read-only while the run goes on: that takes the right to mount.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from series_runs import SEED, Ended, Series

KINDS = ("full", "full", "read-only", "input", "full", "read-only", "input", "full", "read-only", "input")  # 3 times
OTHERS = ("SIGHUP", "SIGTERM", "second")  # 3 times each, after those
LEFT = (0, 0, 1, 4, 16, 64)  # kB that a full disk has left
SIZE = "24m"
TRIES = 12  # of a case whose run was over, or could do without what was gone


def can_mount() -> bool:
    """Whether this process may mount."""
    return os.geteuid() == 0 and not subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode


def kind_of(number: int) -> str:
    """Of a case."""
    faults = 3 * len(KINDS)
    return KINDS[number % len(KINDS)] if number < faults else OTHERS[(number - faults) % len(OTHERS)]


def tried(series: Series, number: int) -> dict[str, Any]:
    """One fault at a moment drawn by chance, and the next run."""
    undo: Callable[[], object] = _nothing
    rng, kind = np.random.default_rng([SEED, 5, number]), kind_of(number)
    series.clear()
    series.results.mkdir()
    with mounted(series.results):
        for _ in range(TRIES):
            moment = float(rng.uniform(0.02, 0.85) * series.seconds)
            running = series.start()
            ended = running.wait(moment)
            if ended is None:
                what, expected, undo, ended = _happen(kind, series, running, rng)
                if ended.status not in (0, 3):
                    break
                undo()
                undo = _nothing
            _empty(series.results)  # the run was over, or could do without: again
        kept = series.finished()
        why = _wrong(ended, expected, series) if kind != "second" else []
        undo()
        if kind == "second" and ended.status != -signal.SIGKILL:
            why.append(f"second run: {ended}")
        last = series.run()
        why += series.wrong(last)
        if again := sorted(kept & set(last.pairs)):
            why.append(f"pairs {again} were kept, and measured again")
    said = ended.errors[0] if ended.errors else ""
    return {"faults": [what], "after_s": round(moment, 2), "kept": len(kept), "said": _short(said, series), "why": why}


def _happen(kind: str, series: Series, running: Any, rng: np.random.Generator) -> tuple[str, Any, Callable, Ended]:
    """Let it happen to a run: what, what the run should end with, how to undo it, and how it ended."""
    results = series.results
    if kind == "full":
        left = int(rng.choice(LEFT))
        _fill(results, left)
        return f"disk full but for {left} kB", 2, lambda: _unfill(results), running.wait()
    if kind == "read-only":
        _mount("--bind", results, results)
        _mount("-o", "remount,bind,ro", results)
        return "read-only", 2, lambda: subprocess.run(["umount", results], check=True), running.wait()
    if kind == "input":
        recording = results.parent
        names = ["all frames", *rng.choice(sorted(path.name for path in recording.glob("*.tif")), 3)]
        name = str(rng.choice(names))
        aside = recording / "aside"
        aside.mkdir(exist_ok=True)
        moved = list(recording.glob("*.tif")) if name == "all frames" else [recording / name]
        for path in moved:
            os.replace(path, aside / path.name)
        return f"{name} removed", 2, lambda: [os.replace(aside / p.name, p) for p in moved], running.wait()
    if kind == "second":
        from series_runs import run

        second = run(series.command, series.folder / "second")
        refused = second.status == 2 and len(second.errors) == 1 and "another run works" in second.errors[0]
        ended = running.kill()
        return "second run" + ("" if refused else f" not refused: {second}"), 0, _nothing, ended
    sent = getattr(signal, kind)
    return kind, 128 + sent, _nothing, running.kill(sent)


def _wrong(ended: Ended, expected: int, series: Series) -> list[str]:
    why = [] if ended.status == expected else [f"status {ended.status}, not {expected}: {ended.err[-800:]}"]
    if expected == 2:
        named = [line for line in ended.errors if ".tif" in line or str(series.results) in line]
        why += [] if len(ended.errors) == len(named) == 1 else [f"lines of error: {ended.errors}"]
    return why + [f"stderr: {line[:300]}" for line in ended.odd[:2]]


def _short(line: str, series: Series) -> str:
    """A line of error without the temporary folder."""
    line = line.removeprefix("plenopiv: error: ").replace(f"{series.results.parent}/", "")
    return re.sub(r"'/[^']*'", "...", line)[:160]


@contextmanager
def mounted(folder: Path) -> Iterator[None]:
    """A file system of its own on a folder."""
    _mount("-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", folder)
    try:
        yield
    finally:
        while os.path.ismount(folder):
            subprocess.run(["umount", "-l", folder], check=True)


def _mount(*words: object) -> None:
    subprocess.run(["mount", *map(str, words)], check=True)


def _fill(folder: Path, left_kb: int) -> None:
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            pass
        file.truncate(max(file.tell() - 1024 * left_kb, 0))


def _unfill(folder: Path) -> None:
    (folder / "filler").unlink()


def _nothing() -> None:
    pass


def _empty(folder: Path) -> None:
    for path in folder.iterdir():  # a mount point stays
        shutil.rmtree(path) if path.is_dir() else path.unlink()
