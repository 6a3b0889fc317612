"""Campaign with series of pairs: is anything lost, or computed twice, whatever happens to a run or to its results?

    campaigns/series.py                    all that has no result yet; call it again to go on after a stop
    campaigns/series.py kills damages      these alone: kills, damages, faults, steps, long
    campaigns/series.py --again failed     those that failed once more; --again all: every case
    campaigns/series.py table              write docs/series-tried.md from the results

Results are in campaigns/results/series.json. Faults needs a Linux where it may mount (root in a container can).
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import series_damages
import series_faults
import series_kills
import series_long
import series_steps
from series_runs import SEED, Series
from series_table import table

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "campaigns" / "results" / "series.json"
PAGE = ROOT / "docs" / "series-tried.md"
PAIRS, KILLS, DAMAGES, FAULTS = 20, 50, 100, 39
KINDS: dict[str, tuple[Callable[[Any, int], dict[str, Any]], str, int]] = {
    "kills": (series_kills.tried, "kills", KILLS),
    "damages": (series_damages.tried, "damages", DAMAGES),
    "faults": (series_faults.tried, "faults", FAULTS),
    "steps": (series_steps.tried, "ways", len(series_steps.WAYS)),
    "long": (series_long.tried, "runs", len(series_long.LENGTHS)),
}
WITHOUT_A_SERIES = ("steps", "long")  # they make their own


class Results:
    """Results by kind and case; written after each case."""

    def __init__(self, path: Path):
        held = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        self.path, self.kinds = path, held.get("kinds", {}) if held.get("seed") == SEED else {}

    def cases(self, kind: str) -> dict[str, dict[str, Any]]:
        """Of a kind, by number."""
        return self.kinds.setdefault(kind, {})

    def count(self, kind: str, counted: str) -> int:
        """How many kills, damages, faults there were."""
        return sum(len(case[counted]) for case in self.cases(kind).values())

    def failed(self, kind: str) -> list[str]:
        """Numbers of the cases that went wrong."""
        return [number for number, case in self.cases(kind).items() if case["why"]]

    def save(self) -> None:
        """Write the file, in one step."""
        machine = {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
        aside = self.path.with_suffix(f".{os.getpid()}.new")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        held = {"seed": SEED, "machine": machine, "kinds": self.kinds}
        aside.write_text(json.dumps(held, indent=1) + "\n", encoding="utf-8")
        os.replace(aside, self.path)


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help="kills, damages, faults, steps, long, table")
    parser.add_argument("--again", choices=("failed", "all"), help="forget the results that there are")
    parser.add_argument("--count", type=int, help="kills, damages and so on of each kind, instead of all")
    parser.add_argument("--pairs", type=int, default=PAIRS, help=f"of the series ({PAIRS})")
    parser.add_argument("--first", type=int, default=0, help="number of the first case: others are drawn")
    parser.add_argument("--results", type=Path, default=RESULTS, help="file of results")
    return parser.parse_args(given)


def run(kinds: list[str], results: Results, folder: Path, options: argparse.Namespace) -> bool:
    """Try what is left; whether all went well."""
    series = None
    for kind in kinds:
        tried, counted, wanted = KINDS[kind]
        wanted = options.count or wanted
        if kind == "faults" and not series_faults.can_mount():
            print("faults: this process may not mount; left out")
            continue
        while results.count(kind, counted) < wanted:
            given: Any = folder
            if kind not in WITHOUT_A_SERIES:
                given = series = series or Series.made(folder / "series", options.pairs)
            began = time.monotonic()
            number = next(n for n in itertools.count(options.first) if str(n) not in results.cases(kind))
            case = tried(given, number) | {"seconds": round(time.monotonic() - began, 1)}
            results.cases(kind)[str(number)] = case
            results.save()
            print(f"{kind} {number}: {results.count(kind, counted)} of {wanted} {case['why'] or ''}", flush=True)
    return not any(results.failed(kind) for kind in kinds)


def main(given: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = arguments(given)
    results = Results(options.results)
    if "table" in options.what:
        PAGE.write_text(table(results.kinds, SEED), encoding="utf-8")
        print(f"wrote {PAGE.relative_to(ROOT)}")
        return 0
    kinds = [kind for kind in KINDS if kind in options.what or not options.what]
    for kind in kinds if options.again else ():
        for number in results.failed(kind) if options.again == "failed" else list(results.cases(kind)):
            del results.cases(kind)[number]
    with tempfile.TemporaryDirectory(prefix="plenopiv-series-") as folder:
        try:
            return 0 if run(kinds, results, Path(folder), options) else 1
        except KeyboardInterrupt:
            print("stopped; the same command goes on where it was", file=sys.stderr)
            return 130


if __name__ == "__main__":
    sys.exit(main())
