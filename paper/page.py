"""Write the tables of docs/paper.md from paper/results:  page.py

Only what stands between two marks, <!-- name: begin --> and <!-- name: end -->, is replaced.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE, RESULTS = ROOT / "docs" / "paper.md", ROOT / "paper" / "results"
CAMERAS = ("pmr8", "pmr14", "pmr28")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown; numbers to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def slashed(values: Iterable[float], digits: int = 3) -> str:
    """Several numbers in one cell, to so many digits."""
    return " / ".join(f"{float(f'{v:.{digits}g}'):,g}" for v in values)


def results(name: str) -> Any:
    """What a script has written."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def resolution() -> str:
    """Free shifts and blocks by depth, of the three cameras."""
    found = results("resolution")
    rows = []
    for k, band in enumerate(found["pmr14"]["free_shift_by_depth"]):
        shifts = [found[name]["free_shift_by_depth"][k] for name in CAMERAS]
        areas = [found[name]["blocks_by_depth"][k]["area_um2"] for name in CAMERAS]
        rows.append(
            (
                f"{band['from_mm']:g} to {band['to_mm']:g}",
                slashed(s["y_mean_um"] for s in shifts),
                slashed(s["z_mean_um"] for s in shifts),
                slashed(areas),
            )
        )
    return table(("abs(z), mm", "free shift along y, um", "along z, um", "area of a block, um^2"), rows)


def normalisation() -> str:
    """Weights of planes, Q and errors."""
    from normalisation import TITLES

    rows = []
    for name, found in results("normalisation")["weights"].items():
        errors = " / ".join(f"{e:.3f}" for e in found["rms"])
        rows.append((TITLES[name], f"{found['q']:.3f}", errors, f"{100 * found['gross']:.1f}"))
    return table(("planes", "Q", "RMS x / y / z (voxel)", "gross %"), rows)


def fill(text: str, name: str, content: str) -> str:
    """The text with ``content`` between the marks of ``name``."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    assert begin in text, name
    assert end in text, name
    return re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{content}\n{end}", text, flags=re.DOTALL)


TABLES = {"resolution": resolution, "normalisation": normalisation}


def main() -> None:
    """Write all tables whose numbers are there."""
    text = PAGE.read_text()
    for name, make in TABLES.items():
        text = fill(text, name, make())
    PAGE.write_text(text)


if __name__ == "__main__":
    main()
