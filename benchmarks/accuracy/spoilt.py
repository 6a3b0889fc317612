"""Recordings spoilt in many ways: what the program makes of each. Writes docs/spoilt.md.

    python benchmarks/accuracy/spoilt.py [NAME ...] [--again] [--out DIR]

All cases, or some; about twenty minutes on one core. A case that was tried on the same sources is not tried again but
with --again. Each ends in one of these ways:

    refused          one line that says why, and nothing is written
    set aside        pairs are left out, with the reason; the others are measured as if unspoilt
    warned           a finding names the cause
    as if unspoilt   RMS at most 1.15 times that of the same particles unspoilt, on every axis, nothing gross more
    silent           wrong without a word, and no image can show it
    WRONG            wrong without a word, or a false alarm, or an error in the program: then the script exits with 1
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from conditions import CONDITIONS
from small_recording import CAMERA, DT_S, WINDOWS, Clean, clean_recording
from spoiling import Case, Copy
from spoilings_of_files import OF_FILES
from spoilings_of_light import OF_LIGHT
from spoilt_page import page

import plenopiv
from plenopiv.accuracy import score_velocity
from plenopiv.accuracy.velocity import Score, pooled
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.run import written
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.simulated_recording import Seeding

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
RECORDED, STATIC_LIGHT, PAGE = HERE / "spoilt.json", HERE / "static_light.json", ROOT / "docs" / "spoilt.md"
MOST = 1.15  # times the RMS of the unspoilt recording
MORE_GROSS = 0.01  # share of vectors
PAIRS = 4
BASES: dict[str, dict[str, Any]] = {
    "clean": {},
    "fast": {"drift_m_s": 1.2},
    "thin": {"seeding": Seeding(particles_per_microlens=0.1)},
    "dense": {"seeding": Seeding(particles_per_microlens=6.0)},
    "dim": {"seeding": Seeding(electrons_per_pixel=20.0), "noise": SensorNoise(0.5, 5.0)},
}
CASES: dict[str, Case] = OF_LIGHT | OF_FILES
DEEP_WINDOWS = ((64, 64, 32), (48, 48, 24))  # for PMR 8 too, whose microlenses tell less of depth
SMALL = {"columns": 800, "rows": 640, "z_mm": (-2.5, 2.5), "windows": DEEP_WINDOWS}
QUIET = ("base", "square", "dim", "pmr8", "pmr28", "ppm0.25", "ppm2", "vortex-ring", "rotation1")  # of conditions.py

Line = dict[str, Any]


def digest(*paths: Path) -> str:
    """A short hash of Python sources."""
    found = sorted(file for path in paths for file in ([path] if path.is_file() else path.rglob("*.py")))
    return hashlib.sha256(b"".join(file.read_bytes() for file in found)).hexdigest()[:12]


def scores(velocity: Any, experiment: Experiment, clean: Clean) -> dict[int, Score]:
    """The score of each pair that was measured, by the true time between its frames; those set aside are NaN."""
    found = {}
    for n, seconds in enumerate(velocity.time.values):
        if not np.isfinite(velocity.u.values[n]).any():
            continue
        pair = round(float(seconds) / experiment.recording_table.dt_s - 0.5)
        settings = {"dt_s": DT_S, "voxel_mm": experiment.volume.voxel_mm, "time": n}
        found[pair] = score_velocity(velocity, *clean.truth(pair), CAMERA, window_voxels=WINDOWS[-1], **settings)
    return found


def unspoilt(found: dict[int, Score], reference: dict[int, dict[str, Any]]) -> tuple[bool, float]:
    """Whether errors are those of the unspoilt recording's same pairs, and the largest ratio of them."""
    here = pooled(list(found.values()))
    there = [reference[pair] for pair in found]
    rms = [(sum(r["rms"][k] ** 2 for r in there) / len(there)) ** 0.5 for k in range(3)]
    gross = sum(r["gross"] for r in there) / len(there)
    ratio = max(a / b for a, b in zip(here.rms, rms, strict=True)) if here.gross < 1 else float("inf")
    return ratio <= MOST and here.gross <= gross + MORE_GROSS and here.answered == 1.0, ratio


def tried(case: Case, copy: Copy, reference: dict[int, dict[str, Any]] | None) -> Line:
    """Run a spoilt copy, and say how that ended."""
    try:
        case.spoil(copy)
        experiment = Experiment.load(copy.save())
        result = plenopiv.process(experiment, overwrite=True)
    except PlenoPIVError as error:
        return {"outcome": "WRONG" if case.fine else "refused", "why": str(error).replace(f"{copy.folder}/", "")}
    except Exception as error:  # whatever the program did not foresee
        return {"outcome": "WRONG", "why": f"{type(error).__name__}: {error}"}
    found = result.summary["findings"]
    aside = {one["pair"]: one["reason"].replace(f"{copy.folder}/", "") for one in result.summary["set_aside"]}
    names = [one["name"] for one in found]
    line: Line = {"findings": names, "set_aside": sorted(aside)}
    measured = scores(result.velocity, experiment, copy.clean) if _is_measured(case, experiment) else {}
    if measured:
        errors = pooled(list(measured.values()))
        line |= {"rms": errors.rms, "gross": errors.gross}
        line["pairs"] = {str(pair): {"rms": s.final.rms, "gross": s.final.gross} for pair, s in measured.items()}
    as_unspoilt = False
    if measured and reference is not None:
        as_unspoilt, ratio = unspoilt(measured, reference)
        line |= {"ratio": ratio} if isfinite(ratio) else {}
    named = [one["words"] for one in found if one["name"] in case.causes]
    named += [words for words in result.summary["warnings"] if re.search(case.says, words)]
    if case.fine:
        alarms = result.summary["warnings"]
        right = not alarms and (as_unspoilt or reference is None)
        return line | {"outcome": "as if unspoilt" if right else "WRONG", "why": "; ".join(alarms)}
    if case.bad and set(aside) - set(case.bad):
        return line | {"outcome": "WRONG", "why": f"good pairs are set aside: {aside}"}
    if aside and as_unspoilt:
        return line | {"outcome": "set aside", "why": next(iter(aside.values()))}
    if named:
        return line | {"outcome": "warned", "why": named[0]}
    if as_unspoilt:
        return line | {"outcome": "as if unspoilt", "why": ""}
    others = "; ".join(result.summary["warnings"])
    return line | {"outcome": "silent" if case.silent else "WRONG", "why": others}


def _is_measured(case: Case, experiment: Experiment) -> bool:
    """Whether the fields are those of the pairs whose particles are known."""
    return experiment.recording_table.pairs is not None and case.base != "fast"


def case_line(name: str, recordings: Path, reference: dict[int, dict[str, Any]] | None) -> Line:
    """One of ``CASES``."""
    case = CASES[name]
    clean = clean_recording(recordings / case.base, PAIRS if case.base == "clean" else 1, **BASES[case.base])
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(clean, Path(folder) / "recording", case.pairs, seed=sum(name.encode()))
        return tried(case, copy, reference if case.base == "clean" else None)


def condition_line(name: str, recordings: Path) -> Line:
    """A recording with nothing wrong under one of the conditions of docs/accuracy.md: no word may come."""
    folder = recordings / f"conditions-{hashlib.sha256(repr(SMALL).encode()).hexdigest()[:8]}" / name
    if not (folder / "experiment.toml").exists():
        replace(CONDITIONS[name], **SMALL).simulate(folder)
    try:
        result = plenopiv.process(Experiment.load(folder / "experiment.toml"), overwrite=True)
    except PlenoPIVError as error:
        return {"outcome": "WRONG", "why": str(error)}
    shutil.rmtree(result.directory)
    alarms = result.summary["warnings"]
    return {"outcome": "WRONG" if alarms else "no word", "why": "; ".join(alarms)}


def write_page() -> None:
    """docs/spoilt.md from what was recorded, where there is all of it."""
    if RECORDED.exists() and STATIC_LIGHT.exists():
        PAGE.write_text(page(json.loads(RECORDED.read_text()), CASES, json.loads(STATIC_LIGHT.read_text())))


def main() -> None:
    everything = [*CASES, *(f"condition {name}" for name in QUIET)]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(everything).replace("%", "%%"))
    parser.add_argument("--again", action="store_true", help="try cases that were tried on the same sources")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "spoilt", metavar="DIR")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(everything):
        parser.error(f"no case is called {', '.join(sorted(unknown))}")
    written.write_report = lambda path, **named: path.write_text("")  # takes longer than a pair
    warnings.simplefilter("ignore", PlenoPIVWarning)
    warnings.showwarning = lambda *shown: None  # a run shows them all the same

    simulation = digest(ROOT / "src" / "plenopiv" / "simulation", HERE / "small_recording.py", HERE / "conditions.py")
    recordings = arguments.out / f"recordings-{simulation}"
    version = digest(ROOT / "src" / "plenopiv", *HERE.glob("spoil*.py"), HERE / "small_recording.py")
    kept = arguments.out / "results.jsonl"
    known = {line["name"]: line for line in map(json.loads, kept.read_text().splitlines())} if kept.exists() else {}
    for name in dict.fromkeys(["nothing", *(arguments.names or everything)]):
        asked_again = arguments.again and (name in arguments.names or not arguments.names)
        if name in known and known[name]["version"] == version and not asked_again:
            continue
        begin = time.process_time()
        if name == "nothing":
            line = case_line(name, recordings, None)
        elif name in CASES:
            of_pairs = {int(pair): errors for pair, errors in known["nothing"].get("pairs", {}).items()}
            line = case_line(name, recordings, of_pairs or None)
        else:
            line = condition_line(name.removeprefix("condition "), recordings)
        line = {"name": name, "version": version} | line | {"cpu_s": round(time.process_time() - begin, 1)}
        known[name] = line
        with kept.open("a") as file:
            file.write(json.dumps(line) + "\n")
        ratio = f" {line['ratio']:.2f}" if "ratio" in line else ""
        print(f"{name:32s} {line['outcome']:15s}{ratio} {line['why'][:120]}", flush=True)
    lines = [known[name] for name in everything if name in known]
    if len(lines) == len(everything):
        RECORDED.write_text(json.dumps(lines, indent=1) + "\n")
        write_page()
    sys.exit(1 if any(line["outcome"] == "WRONG" for line in lines) else 0)


if __name__ == "__main__":
    main()
