"""Recorded tables, and whether today's program would make them:  fresh.py [TABLE ...] [--again] [--pages]

tables.toml names every recorded table, made.json what each was made with: the defaults of the settings that it depends
on, and for each stage the number of the last decision (docs/decisions) that changed what the stage gives. A table whose
record is not today's, or whose content is not the one that was recorded, is stale. A setting that is new changes
nothing by itself: where its default does, a decision says so.

    benchmarks/fresh.py                   list all of them; exit code 1 where one is stale
    benchmarks/fresh.py --again           make stale ones anew, one after the other; call it again to go on after a stop
    benchmarks/fresh.py ensemble --again  this one, stale or not (of a table in parts, see below, the parts that are)
    benchmarks/fresh.py --pages           write into the pages which of their tables are stale, and docs/fresh.md

TABLE: a table's name, or a part of it. Tables are recorded here alone: a script that is run by itself leaves its table
stale.
Of tables that take hours each case carries a stamp of what made it (``stamp``): their scripts make the cases that are
not of today's program, one after the other, so that a table is made in parts, over several calls.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from plenopiv import __version__

ROOT = Path(__file__).resolve().parents[1]
TABLES, MADE, LIST = ROOT / "benchmarks" / "tables.toml", ROOT / "benchmarks" / "made.json", ROOT / "docs" / "fresh.md"
BEGIN, END = "<!-- fresh: begin -->", "<!-- fresh: end -->"
# Of each stage the last decision that changed what it gives. Raise it with one that does.
DECISIONS = {
    "optics": 1,
    "calibration": 53,
    "target": 95,
    "lens blur": 87,
    "checks": 84,
    "reconstruction": 62,
    "correlation": 76,
    "ensembles": 96,
    "tracking": 92,
    "links": 82,
    "smoothing": 91,
    "fields": 93,
    "bars of fields": 97,
    "statistics": 89,
    "device": 60,
}


@dataclass(frozen=True)
class Table:
    """One entry of tables.toml."""

    file: str
    page: str
    commands: list[str]
    stages: list[str]
    minutes: int

    @property
    def name(self) -> str:
        """Short, for lists."""
        return self.file.removeprefix("benchmarks/").removeprefix("docs/").removesuffix(".json")

    def content(self) -> str:
        """A hash of what is recorded: of the file, or of what stands between its two marks."""
        path, _, mark = self.file.partition("#")
        text = (ROOT / path).read_text(encoding="utf-8")
        if mark:
            text = text.split(f"<!-- {mark}: begin -->", 1)[1].split("end -->", 1)[0]
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def made_with_today(self) -> dict[str, Any]:
        """Of each of its stages the decision and the defaults."""
        defaults = settings_today()
        return {stage: {"decision": DECISIONS[stage], **defaults.get(stage, {})} for stage in self.stages}

    def why_stale(self, made: dict[str, Any]) -> str:
        """A few words; "" where it is fresh. ``made``: the content of made.json."""
        record = made.get(self.file)
        if record is None:
            return "made before tables were recorded"
        if record["content"] != self.content():
            return "not as it was recorded"
        today, found = self.made_with_today(), []
        for stage in self.stages:
            was, now = record["made_with"].get(stage, {}), json.loads(json.dumps(today[stage]))
            changed = [key for key in now if (key in was or key == "decision") and was.get(key) != now[key]]
            found += [f"{stage}.{key} {was.get(key)} -> {now[key]}" for key in changed]
        return "; ".join(found)


def settings_today() -> dict[str, dict[str, Any]]:
    """Defaults by stage, with what has no key in the experiment file."""
    from plenopiv.chain import HIDDEN
    from plenopiv.displacement.compression import BESIDE
    from plenopiv.displacement.settings import CorrelationSettings
    from plenopiv.reconstruction.reconstruct import THIN
    from plenopiv.reconstruction.settings import ReconstructionSettings

    correlation = asdict(CorrelationSettings()) | {"light_to_each_neighbour": BESIDE, "power_of_the_seen_share": HIDDEN}
    for of_the_recording in ("windows", "inner_window"):
        del correlation[of_the_recording]
    return {"reconstruction": asdict(ReconstructionSettings()) | {"thinning": THIN}, "correlation": correlation}


def tables() -> list[Table]:
    """All of them."""
    return [Table(**entry) for entry in tomllib.loads(TABLES.read_text(encoding="utf-8"))["table"]]


def records() -> dict[str, Any]:
    """The content of made.json."""
    return dict(json.loads(MADE.read_text(encoding="utf-8"))) if MADE.exists() else {}


def stamp(file: Path) -> str:
    """Of today's settings and decisions, for a case of the table that is recorded in ``file``."""
    table = next(table for table in tables() if ROOT / table.file == file)
    return hashlib.sha256(json.dumps(table.made_with_today(), sort_keys=True).encode()).hexdigest()[:16]


def make(table: Table) -> None:
    """Run what makes a table, and record it. Raises ``SystemExit`` where a command fails."""
    if not table.commands:
        raise SystemExit(f"{table.name}: is not made here; tables.toml says how")
    began = time.perf_counter()
    for command in table.commands:
        print(f"{table.name}: {command}", flush=True)
        if code := subprocess.run([sys.executable, *command.split()], cwd=ROOT, check=False).returncode:
            print(f"{table.name}: {command} ended with {code}: not recorded", file=sys.stderr)
            raise SystemExit(code)
    record(table, (time.perf_counter() - began) / 60.0)


def record(table: Table, minutes: float) -> None:
    """Write what a table was made with, and how long it took."""
    made = records()
    made[table.file] = {
        "version": __version__,
        "minutes": round(minutes, 1),
        "content": table.content(),
        "made_with": table.made_with_today(),
    }
    MADE.write_text(json.dumps(dict(sorted(made.items())), indent=1) + "\n", encoding="utf-8")


def pages() -> dict[Path, str]:
    """Each page that quotes tables, and docs/fresh.md, with what is stale written into it."""
    made, stale = records(), dict[str, list[Table]]()
    for table in tables():
        stale.setdefault(table.page, [])
        if table.why_stale(made):
            stale[table.page].append(table)
    out = {}
    for page, those in stale.items():
        if not page.startswith("docs/decisions/"):  # records of their day
            out[ROOT / page] = _marked((ROOT / page).read_text(encoding="utf-8"), those)
    return out | {LIST: _list(made)}


def _marked(text: str, stale: list[Table]) -> str:
    """A page with the line on its stale tables after its title, or without one."""
    if BEGIN in text:
        before, rest = text.split(BEGIN, 1)
        text = before + rest.split(END, 1)[1].lstrip("\n")
    if not stale:
        return text
    names = ", ".join(f"`{table.name}`" for table in stale)
    line = f"*An earlier program made {names}; [what differs](fresh.md).*"
    title, rest = text.split("\n", 1)
    return f"{title}\n\n{BEGIN}\n{line}\n{END}\n\n{rest.lstrip(chr(10))}"


INTRODUCTION = """\
# What made each figure

Every recorded table carries the settings and decisions that made it. Where they are not today's this list says what
differs, and so does the page. `make fresh` (`python benchmarks/fresh.py --again`) makes stale tables anew, one after
the other, and goes on where it was stopped; `--pages` writes this page. Minutes are those that it took, often on one
core beside other work, or where that was not recorded an estimate. Pages among the decisions are records of their day
([decision 63](decisions/0063-tables-say-what-made-them.md)).

| table | page | of the stages | minutes | made with settings that are |
|---|---|---|---|---|
"""


def _list(made: dict[str, Any]) -> str:
    rows = []
    for table in tables():
        where = table.page.removeprefix("docs/")
        cells = [f"`{table.name}`", f"[{where.removesuffix('.md')}]({where})", ", ".join(table.stages)]
        minutes = made.get(table.file, {}).get("minutes", table.minutes)
        cells += [f"{max(minutes, 1.0):.0f}", table.why_stale(made) or "today's"]
        rows.append(f"| {' | '.join(cells)} |\n")
    return INTRODUCTION + "".join(rows)


def asked_for(names: list[str]) -> list[Table]:
    """Those of these names, else those with them in their names."""
    every = tables()
    exact = {table.name for table in every} & set(names)
    parts = set(names) - exact
    return [table for table in every if table.name in exact or any(part in table.name for part in parts)]


def main() -> None:
    """List, make, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="*", help="a part of its name; default all")
    parser.add_argument("--again", action="store_true", help="make them anew")
    parser.add_argument("--pages", action="store_true", help="write what is stale into the pages")
    given = parser.parse_args()
    chosen = asked_for(given.table) if given.table else tables()
    if not chosen:
        raise SystemExit(f"no table has {' or '.join(given.table)} in its name; they are listed in {TABLES}")
    for table in chosen if given.again else []:
        if given.table or (table.commands and table.why_stale(records())):
            make(table)
    if given.again or given.pages:
        for path, text in pages().items():
            path.write_text(text, encoding="utf-8")
    made, stale = records(), 0
    for table in chosen:
        why = table.why_stale(made)
        stale += bool(why)
        print(f"{'stale' if why else 'fresh'}  {table.name}{': ' if why else ''}{why}")
    sys.exit(1 if stale else 0)


if __name__ == "__main__":
    main()
