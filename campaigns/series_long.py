"""A long series: memory by pair, what a run announces, what a pair takes beside reconstruction and correlation.

Each run is a process of its own (``plenopiv run``), which loads compiled kernels from the cache; its resident memory is
read from outside whenever a pair was finished.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from series_runs import THREADS, Series, in_a_child, load, make_recording

LENGTHS = (1, 20, 1000)  # pairs
SIMULATED = 10
EARLY = 20  # the pair that memory is compared with
PROGRAM = "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))"
BETWEEN = "import subprocess, sys; sys.exit(subprocess.run(sys.argv[1:]).returncode)"  # a process' peak starts there


def tried(place: Path | Series, number: int) -> dict[str, Any]:
    """One of the lengths."""
    return long_run(place.folder if isinstance(place, Series) else place, LENGTHS[number])


def long_run(folder: Path, pairs: int) -> dict[str, Any]:
    """A run of so many pairs, after one that compiled what it needs."""
    load()
    recording, why = folder / f"of-{pairs}", []
    in_a_child(lambda: make_recording(recording, pairs, min(pairs, SIMULATED)))
    for _ in range(2 if pairs < EARLY else 1):
        shutil.rmtree(recording / "results", ignore_errors=True)
        status, seconds, resident = _run(recording)
    summary = json.loads((recording / "results" / "summary.json").read_text())
    took, sizes = summary["timings_s"], {n: (recording / "results" / n).stat().st_size for n in ("report.html",)}
    peak, announced = max(summary["peak_memory_gb"].values()), summary["memory_estimate_gb"]
    if status not in (0, 3):
        why.append(f"status {status}")
    if not 1.0 <= announced / peak <= 1.2:
        why.append(f"announced {announced:.3f} GB, taken {peak:.3f} GB")
    grown, before, last = None, None, None
    if pairs > EARLY:
        before = next(gb for done, gb in resident if done >= EARLY)
        last = max(gb for done, gb in resident if pairs - 10 < done < pairs)  # after the last one the report is drawn
        grown = last / before
        if grown > 1.02:
            why.append(f"resident memory at the end {grown:.3f} times that at pair {EARLY}")
    again, stopped = _nothing_to_do(recording)
    if not stopped:
        why.append("a second run finds something to do")
    beside = seconds - sum(took[stage] for stage in ("check", "calibration", "reconstruction", "correlation", "report"))
    shutil.rmtree(recording)
    return {
        "pairs": pairs,
        "runs": [pairs],
        "seconds_of_run": round(seconds, 1),
        "timings_s": {stage: round(s, 2) for stage, s in took.items()},
        "beside_s": round(beside, 2),
        "again_s": round(again, 1),
        "announced_gb": round(announced, 3),
        "taken_gb": round(peak, 3),
        "resident_gb": [[done, round(gb, 4)] for done, gb in resident[:: max(len(resident) // 25, 1)]],
        "at_pair_20_and_last_gb": [before, last],
        "grown": None if grown is None else round(grown, 4),
        "report_mb": round(sizes["report.html"] / 1e6, 2),
        "why": why,
    }


def _run(recording: Path) -> tuple[int, float, list[tuple[int, float]]]:
    """Exit status, seconds, and GB resident by number of pairs finished."""
    command = [sys.executable, "-c", BETWEEN, sys.executable, "-c", PROGRAM, "--quiet", "run"]
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    began, resident, last = time.monotonic(), [], 0
    with subprocess.Popen([*command, str(recording / "experiment.toml")], env=environment) as process:
        work = recording / "results" / ".plenopiv" / "pairs"
        while process.poll() is None:
            time.sleep(0.2)
            done = len(list(work.glob("*.json"))) if work.is_dir() else 0
            if done > last and (gb := _resident_gb(process.pid)):
                resident.append((done, gb))
                last = done
    return process.returncode, time.monotonic() - began, resident


def _resident_gb(pid: int) -> float | None:
    """Of the child of a process."""
    with suppress(OSError, StopIteration, ValueError, IndexError):
        child = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0]
        lines = Path(f"/proc/{child}/status").read_text().splitlines()
        return 1.024e-6 * int(next(line.split()[1] for line in lines if line.startswith("VmRSS")))
    return None


def _nothing_to_do(recording: Path) -> tuple[float, bool]:
    """Seconds of the next run, and whether it finds all complete."""
    began = time.monotonic()
    command = [sys.executable, "-c", PROGRAM, "run", str(recording / "experiment.toml")]
    ended = subprocess.run(command, capture_output=True, text=True)
    return time.monotonic() - began, "nothing to do" in ended.stderr
