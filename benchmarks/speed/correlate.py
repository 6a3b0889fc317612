"""Time of vectors from kept volumes beside that of whole runs:  correlate.py FOLDER [--windows SIZES] [--repeats N]

FOLDER is a recording with its experiment.toml; it is copied. A run keeps the volumes; then whole runs with the windows
and `plenopiv correlate` with the same windows take turns, N times each, each in a process of its own, and their vectors
are compared bit for bit. Writes correlate.json: seconds of wall and of processor time, without a windows option for the
windows of the file.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from statistics import median

import tomli_w

from plenopiv.io import read_velocity

PROGRAM = "import sys; from plenopiv.cli import main; sys.exit(main(sys.argv[1:]))"


def timed(*words: str) -> tuple[float, float]:
    """Seconds of wall and of processor time of a command."""
    begin = time.perf_counter()
    child = os.spawnv(os.P_NOWAIT, sys.executable, [sys.executable, "-c", PROGRAM, "-q", *words])
    _, status, used = os.wait4(child, 0)
    if status:
        raise SystemExit(f"plenopiv {' '.join(words)} failed")
    return time.perf_counter() - begin, used.ru_utime + used.ru_stime


def stages(results: Path) -> dict[str, float]:
    """Seconds of wall time by stage."""
    found = json.loads((results / "summary.json").read_text())["timings_s"]
    return {name: round(seconds, 2) for name, seconds in found.items()}


def main() -> None:
    """Measure, compare, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--windows")
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "recording"
        shutil.copytree(given.folder, folder)
        tables = tomllib.loads((folder / "experiment.toml").read_text())
        tables["output"] = {"directory": "kept", "volumes": True}
        (folder / "keep.toml").write_text(tomli_w.dumps(tables))
        timed("run", str(folder / "keep.toml"))
        if given.windows:
            sizes = [[int(side) for side in size.split("x")] for size in given.windows.split(",")]
            tables["correlation"]["windows"] = sizes
            tables["correlation"].pop("inner_window", None)
        tables["output"] = {"directory": "whole"}
        (folder / "whole.toml").write_text(tomli_w.dumps(tables))
        windows = ",".join("x".join(map(str, size)) for size in tables["correlation"]["windows"])
        run = ["run", str(folder / "whole.toml"), "--overwrite"]
        again = ["correlate", str(folder / "kept"), "--windows", windows, "--out", str(folder / "again"), "--overwrite"]
        times: dict[str, list[tuple[float, float]]] = {"run": [], "correlate": []}
        for _ in range(given.repeats):
            times["run"].append(timed(*run))
            times["correlate"].append(timed(*again))
        whole, fields = (read_velocity(folder / name / "velocity.nc") for name in ("whole", "again"))
        same = all(fields[name].values.tobytes() == whole[name].values.tobytes() for name in whole.data_vars)
        found = {
            "windows": windows,
            "voxels": json.loads((folder / "whole" / "summary.json").read_text())["voxels"],
            "vectors": int(whole.valid.size),
            "same_bits": same,
            "times_s": {name: [[round(s, 1) for s in each] for each in taken] for name, taken in times.items()},
            "stages_s": {"run": stages(folder / "whole"), "correlate": stages(folder / "again")},
        }
    for k, name in enumerate(("wall", "processor")):
        run_s, again_s = (median(each[k] for each in times[command]) for command in ("run", "correlate"))
        found[f"{name}_ratio"] = round(again_s / run_s, 3)
        print(f"{name} time: run {run_s:.1f} s, correlate {again_s:.1f} s, ratio {again_s / run_s:.3f}")
    print(f"vectors the same bit for bit: {same}")
    here = Path(__file__).with_suffix(".json")
    kept = json.loads(here.read_text()) if here.exists() else {}
    here.write_text(json.dumps({**kept, f"{given.folder.resolve().name}, {windows}": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
