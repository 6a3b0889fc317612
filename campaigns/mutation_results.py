"""What became of each mutant: a JSON file, written anew after each, and the hand-kept list of equivalent ones."""

from __future__ import annotations

import json
import os
import platform
import tomllib
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mutation_plan import Mutant
from mutation_runs import Outcome


class Results:
    """The results in ``path``, by mutant."""

    def __init__(self, path: Path):
        self.path = path
        held = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        self.unmutated: dict[str, Any] = held.get("unmutated", {})
        self.machine: dict[str, Any] = held.get("machine", {})
        self.mutants: dict[str, dict[str, Any]] = held.get("mutants", {})

    def of(self, mutant: Mutant) -> dict[str, Any] | None:
        """The result of a mutant; None where there is none, or where the mutated function is another by now."""
        known = self.mutants.get(mutant.key)
        return known if known and known["source"] == mutant.source else None

    def add(self, mutant: Mutant, outcome: Outcome) -> None:
        """Keep a result."""
        result = asdict(outcome) | {"seconds": round(outcome.seconds, 1)}
        about = {name: getattr(mutant, name) for name in ("area", "kind", "file", "was", "becomes", "source")}
        self.mutants[mutant.key] = about | result
        self._write()

    def passed(self, state: str, seconds: float) -> None:
        """All tests passed without a mutant; ``state``: hash of sources and tests."""
        self.unmutated = {"state": state, "seconds": round(seconds, 1)}
        self._write()

    def tried_on(self, about: dict[str, Any]) -> None:
        """The machine of the latest run."""
        self.machine = about
        self._write()

    def _write(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        held = {"unmutated": self.unmutated, "machine": self.machine, "mutants": dict(sorted(self.mutants.items()))}
        aside = self.path.with_suffix(".new")
        aside.write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        os.replace(aside, self.path)


def equivalents(path: Path) -> dict[tuple[str, str], str]:
    """Why mutants are equivalent, by key and mutated line, of a TOML file of tables ``[[mutant]]`` with ``key``,
    ``becomes`` and ``reason``.

    ``becomes`` is the mutated line, so that the reason is not taken for another mutant should the function change.
    """
    if not path.is_file():
        return {}
    listed = tomllib.loads(path.read_text(encoding="utf-8")).get("mutant", [])
    return {(entry["key"], entry["becomes"]): " ".join(entry["reason"].split()) for entry in listed}


def machine() -> dict[str, Any]:
    """What the campaign runs on."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    versions = {name: version(name) for name in ("numpy", "numba", "pytest")}
    return {"processor": model, "cores": os.cpu_count(), "python": platform.python_version()} | versions
