"""What became of the cases: a small JSON file, counts by kind, the failed ones, the slowest, the largest."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from fuzz_cases import KINDS, SEED, Case
from fuzz_runs import Outcome

MOST = 300  # failed cases of a kind that are kept


class Results:
    """The results in ``path``; those of another seed are not kept."""

    def __init__(self, path: Path, seed: int = SEED):
        held = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        self.path, self.seed = path, seed
        self.kinds: dict[str, dict[str, Any]] = held.get("kinds", {}) if held.get("seed") == seed else {}
        self.machine: dict[str, Any] = held.get("machine", {})

    def of(self, kind: str) -> dict[str, Any]:
        """The results of a kind: cases 0 to ``cases`` have been tried."""
        empty = {"cases": 0, "read": 0, "refused": 0, "failed": {}, "slowest": {}, "largest": {}, "seconds": 0.0}
        return self.kinds.setdefault(kind, empty)

    def tried(self, case: Case) -> bool:
        """Whether a case has a result."""
        return case.number < self.of(case.kind)["cases"]

    @property
    def failed(self) -> dict[str, str]:
        """Why, by the names of the cases."""
        return {f"{kind}:{number}": why for kind in self.kinds for number, why in self.of(kind)["failed"].items()}

    def count_failed(self, kind: str) -> int:
        """How many cases of a kind have failed, those too that are not kept."""
        held = self.of(kind)
        return held["cases"] - held["read"] - held["refused"]

    def add(self, case: Case, outcome: Outcome, again: bool = False) -> None:
        """Keep an outcome; ``again``: of a case that had failed, and counts once."""
        held, number = self.of(case.kind), str(case.number)
        if again:
            held["failed"].pop(number, None)
        else:
            held["cases"] = case.number + 1
        if outcome.result == "failed":
            if len(held["failed"]) < MOST:
                held["failed"][number] = outcome.why[:400]
        else:
            held[outcome.result] += 1
        held["seconds"] = round(held["seconds"] + outcome.seconds, 2)
        if outcome.seconds > held["slowest"].get("seconds", 0):
            held["slowest"] = {"case": case.number, "seconds": round(outcome.seconds, 2)}
        if outcome.memory_gb > held["largest"].get("gb", 0):
            held["largest"] = {"case": case.number, "gb": round(outcome.memory_gb, 3)}

    def save(self) -> None:
        """Write the file, in one step."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        kinds = {kind: self.of(kind) for kind in KINDS}
        aside = self.path.with_suffix(".new")
        held = {"seed": self.seed, "machine": self.machine, "kinds": kinds}
        aside.write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        os.replace(aside, self.path)
