"""Where scripts write: numbers to paper/results, pictures to docs/images/paper; and how a table is written."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]


def write_numbers(out: Path, name: str, found: Any, indent: int = 1) -> None:
    """``found`` as ``out``/paper/results/``name``.json."""
    target = out / "paper" / "results" / f"{name}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(found, indent=indent) + "\n")


def write_picture(out: Path, name: str, figure: Figure, dpi: int) -> None:
    """A figure as ``out``/docs/images/paper/``name``.png."""
    folder = out / "docs" / "images" / "paper"
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=dpi, facecolor="white")


def command_line(main: Callable[[Path, bool], None], about: str) -> None:
    """Call ``main(out, reduced)`` with what the command line says; the first line of ``about`` is shown."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT, help="folder for paper/results and docs/images/paper")
    parser.add_argument("--reduced", action="store_true", help="a version of seconds")
    asked = parser.parse_args()
    main(asked.out, asked.reduced)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown; numbers to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def three(values: Iterable[float], digits: int = 3) -> str:
    """What is known along x, y and z in one cell."""
    return " / ".join(f"{v:.{digits}f}" for v in values)
