"""Fuzzing campaign: does any file make the program crash, hang, or leave half a result behind?

3,000 cases follow from a seed: images, experiment files, optics sheets, files of velocities and results, each a small
whole file that was spoilt, by chance or where its parser looks, and a command that reads it. A case has failed when its
command shows a traceback, ends otherwise than with exit code 0 or 2, takes more than 10 s or 2 GB, says anything but
the program's own lines, one of them for an error, or leaves something behind.

    campaigns/fuzz.py                      try what has no result yet; call it again to go on after a stop
    campaigns/fuzz.py --again failed       those that failed once more; --again all: every case
    campaigns/fuzz.py --case image:17      one case, what it says, and its files (--keep FOLDER)
    campaigns/fuzz.py table                write docs/fuzzing.md from the results

Results are in campaigns/results/fuzz.json.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import signal
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import fuzz_corpus
from fuzz_cases import COUNT, SEED, Case, cases
from fuzz_results import Results
from fuzz_runs import in_a_child, load, tried, warm, write
from fuzz_table import table

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "campaigns" / "results" / "fuzz.json"
PAGE = ROOT / "docs" / "fuzzing.md"
SAVED = 20  # cases between two writings of the results


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", nargs="?", choices=("run", "table"), default="run")
    parser.add_argument("--again", choices=("failed", "all"), help="try again what has a result")
    parser.add_argument("--case", metavar="KIND:N", help="this one alone; results are left as they are")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where to write the files of --case")
    parser.add_argument("--count", type=int, default=COUNT, help=f"cases in all ({COUNT})")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of all cases ({SEED})")
    parser.add_argument("--results", type=Path, default=RESULTS, help="file of results")
    return parser.parse_args(given)


def corpus(work: Path) -> Path:
    """Whole files to start from, made in a process of its own."""
    folder = work / "corpus"

    def built() -> bytes:
        fuzz_corpus.build(folder)
        return b"built"

    if not in_a_child(built):
        raise RuntimeError("the files to start from could not be made")
    warm(folder, work)
    return folder


def one(case: Case, work: Path, keep: Path | None) -> None:
    """Try one case and say all about it."""
    whole = corpus(work)
    outcome = tried(case, whole, work)
    made = write(case, whole, work / "shown")
    print(f"plenopiv {' '.join(made.command)}   # spoilt: {made.spoilt}")
    print(f"{outcome.result}, {outcome.seconds:.2f} s, {outcome.memory_gb:.2f} GB {outcome.why}\n{outcome.said}")
    if keep:
        shutil.copytree(work / "shown", keep, dirs_exist_ok=True)


def run(options: argparse.Namespace, work: Path) -> int:
    """Try the cases that are left; returns how many of all have failed."""
    results = Results(options.results, options.seed)
    if options.again == "all":
        results.kinds = {}
    again = set(results.failed) if options.again == "failed" else set()
    todo = [c for c in cases(options.count, options.seed) if not results.tried(c) or c.name in again]
    results.machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
    whole = corpus(work)
    try:
        for done, case in enumerate(todo, 1):
            outcome = tried(case, whole, work)
            results.add(case, outcome, case.name in again)
            if outcome.why:
                print(f"{case.name}: {outcome.why}", flush=True)
            if done % SAVED == 0:
                results.save()
            if done % 100 == 0:
                print(f"[{done}/{len(todo)}]", flush=True)
    finally:
        results.save()
    for kind, held in results.kinds.items():
        slowest, largest = held["slowest"].get("seconds", 0), held["largest"].get("gb", 0)
        print(
            f"{kind}: {held['cases']} cases, {held['read']} read, {held['refused']} refused, "
            f"{results.count_failed(kind)} failed; slowest {slowest} s, largest {largest} GB"
        )
    return len(results.failed)


def _interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def main(given: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = arguments(given)
    if options.action == "table":
        PAGE.write_text(table(Results(options.results, options.seed)), encoding="utf-8")
        print(f"wrote {PAGE.relative_to(ROOT)}")
        return 0
    signal.signal(signal.SIGTERM, _interrupted)
    load()
    with tempfile.TemporaryDirectory(prefix="plenopiv-fuzz-") as folder:
        try:
            if options.case:
                kind, number = options.case.split(":")
                one(Case(kind, int(number), options.seed), Path(folder), options.keep)
                return 0
            return 1 if run(options, Path(folder)) else 0
        except KeyboardInterrupt:
            print("stopped; the same command goes on where it was", file=sys.stderr)
            return 130


if __name__ == "__main__":
    sys.exit(main())
