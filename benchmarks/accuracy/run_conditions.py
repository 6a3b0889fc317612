"""Simulate, run and score conditions:  run_conditions.py [NAMES] [--out DIR] [--settings KEY=VALUE ...]

NAMES are those of conditions.py, default all but "full". Recordings are kept in DIR/NAME and made only once. Each run
appends one line to DIR/scores.jsonl and prints one. Settings replace keys of the recording's experiment.toml, as in
reconstruction.relaxation=1.0 or correlation.windows=[[64,64,16]]; the value `default` removes a key from the file, so
that the library's default holds. Each condition runs in a process of its own: its peak memory is its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from conditions import CONDITIONS, Condition
from true_particles import scored

import plenopiv
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment

BYTES_A_KIB = 1024


def with_settings(tables: dict[str, Any], settings: list[str]) -> dict[str, Any]:
    """The tables of an experiment file with ``KEY=VALUE`` settings applied; values as TOML has them, or plain text."""
    for setting in settings:
        key, equals, text = setting.partition("=")
        *path, last = key.strip().split(".")
        if not equals or not path:
            raise SystemExit(f"--settings {setting}: give TABLE.KEY=VALUE, as in reconstruction.relaxation=1.0")
        table = tables
        for name in path:
            table = table.setdefault(name, {})
        if text == "default":
            table.pop(last, None)
            continue
        try:
            table[last] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            table[last] = text
    return tables


def measure(name: str, folder: Path, settings: list[str]) -> dict[str, Any]:
    """Run one recording and score it: everything that the line in scores.jsonl holds."""
    file = folder / "experiment.toml"
    tables = with_settings(tomllib.loads(file.read_text()), settings)
    experiment = Experiment.from_dict(tables, file)
    begin = time.perf_counter()
    line: dict[str, Any] = {"name": name, "settings": settings}
    try:
        result = plenopiv.process(experiment, overwrite=True)
    except PlenoPIVError as error:
        return line | {"error": str(error)}
    wall = time.perf_counter() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * BYTES_A_KIB
    try:
        score = scored(result.velocity, experiment).as_dict()
    except PlenoPIVError as error:
        return line | {"error": str(error)}
    return line | {
        "score": score,
        "wall_s": wall,
        "peak_bytes": peak,
        "summary": result.summary,
        "reconstruction": experiment.reconstruction.model_dump(),
        "correlation": experiment.correlation.model_dump(),
    }


def one_line(line: dict[str, Any]) -> str:
    """What a person wants to read of a run first."""
    if "error" in line:
        return f"{line['name']:18s} FAILED: {line['error']}"
    score, frames = line["score"], list(line["summary"]["reconstruction"].values())
    final, raw = score["final"], score["raw"]

    def triple(values) -> str:
        return " ".join(f"{v:.3f}" for v in values)

    depths = " | ".join(triple(band["rms"]) for band in final["by_depth"])
    return (
        f"{line['name']:18s} rms {triple(final['rms'])}  by depth {depths}  gross {100 * final['gross']:.1f} %  "
        f"raw {triple(raw['rms'])} gross {100 * raw['gross']:.1f} %  replaced {100 * score['replaced']:.1f} %  "
        f"bias {triple(final['bias'])}  {score['vectors']} vectors, {score['particles_per_window']:.0f} a window, "
        f"kept {100 * frames[0]['candidate_share']:.1f} %, {line['wall_s']:.0f} s, {line['peak_bytes'] / 1e9:.1f} GB"
    )


def simulated(condition: Condition, folder: Path) -> None:
    """Make the recording where there is none."""
    if not (folder / "experiment.toml").exists():
        condition.simulate(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAMES", help=", ".join(CONDITIONS))
    parser.add_argument("--out", type=Path, default=Path("build/accuracy"), metavar="DIR")
    parser.add_argument("--settings", nargs="+", default=[], metavar="KEY=VALUE")
    parser.add_argument("--simulate-only", action="store_true", help="make the recordings and stop")
    arguments = parser.parse_args()
    names = arguments.names or [name for name in CONDITIONS if name != "full"]
    if unknown := set(names) - set(CONDITIONS):
        parser.error(f"no condition is called {', '.join(sorted(unknown))}; there are {', '.join(CONDITIONS)}")
    arguments.out.mkdir(parents=True, exist_ok=True)

    for name in names:
        folder = arguments.out / name
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(max_workers=1, mp_context=spawn, max_tasks_per_child=1) as process:
            process.submit(simulated, CONDITIONS[name], folder).result()
            if arguments.simulate_only:
                continue
            line = process.submit(measure, name, folder, arguments.settings).result()
        with open(arguments.out / "scores.jsonl", "a") as scores:
            scores.write(json.dumps(line) + "\n")
        print(one_line(line))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
