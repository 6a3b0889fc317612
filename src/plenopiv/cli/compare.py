"""``plenopiv compare``: two results side by side."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from plenopiv.cli.progress import Progress
from plenopiv.cli.replacing import refuse_to_replace
from plenopiv.cli.terminal import Outcome
from plenopiv.comparison import Comparison
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.io.series_statistics import velocity_file

PAGE = "compare.html"


def compare(a: Path, b: Path, out: Path | None, overwrite: bool) -> Outcome:
    """Compare two results, write the page, and print the table.

    Raises:
        PlenoPIVError: a result cannot be read, nothing is in both, or the page is no .html, is there already or
            cannot be written.
    """
    page = out or a.parent / PAGE
    if page.suffix.lower() != Path(PAGE).suffix:
        raise PlenoPIVError(f"{page}: a comparison is an HTML page; use a name that ends in .html")
    refuse_to_replace(page, (velocity_file(a), velocity_file(b)), overwrite, "another name with --out")
    if not page.parent.is_dir():
        raise PlenoPIVError(f"{page}: its folder is not there; make it, or name another with --out")
    from plenopiv.report.comparison import write_comparison
    from plenopiv.run.compared import compare as compared

    with Progress() as progress:
        found = compared(a, b, progress)
    write_comparison(page, found)
    return Outcome(f"{_text(found)}\n{page}", {"file": str(page), **_facts(found)})


def _text(found: Comparison) -> str:
    from plenopiv.report.comparison import HEAD, UNITS, cells, setting_text, what_was_compared

    rows = [list(HEAD), list(UNITS), *cells(found.rows)]
    widths = [max(len(row[n]) for row in rows) for n in range(len(HEAD))]
    table = ["  ".join(f"{cell:>{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines = [f"A  {found.a}", f"B  {found.b}", *what_was_compared(found), "", "B - A:", *table, ""]
    if found.settings is None:
        lines.append("settings: not compared, a result has no experiment.toml beside it")
    elif not found.settings:
        lines.append("settings: the same")
    else:
        lines += ["settings that differ:"]
        lines += [f"  {s.key}: {setting_text(s.a)} | {setting_text(s.b)}" for s in found.settings]
    return "\n".join(map(printable, lines))


def _facts(found: Comparison) -> dict[str, Any]:
    """For programs: all that is printed, as numbers."""
    return {
        "times": dict(zip(("both", "a", "b"), found.times, strict=True)),
        "interpolated": found.interpolated,
        "vectors": {"a": found.vectors, "within_b": found.within, "measured_in_both": found.both},
        "replaced": dict(zip("ab", found.replaced, strict=True)),
        "differences": [_plain(asdict(row)) for row in found.rows],
        "settings": None
        if found.settings is None
        else [{"key": s.key, "a": str(s.a), "b": str(s.b)} for s in found.settings],
    }


def _plain(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value
