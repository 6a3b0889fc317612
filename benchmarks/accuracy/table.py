"""Write the tables of docs/accuracy.md from scores:  table.py [SCORES.jsonl] [--into FILE]

Only what stands between the two marks is replaced. Where a condition was run several times with the same settings the
last run counts. One table for each choice of settings, in the order in which they first appear.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from conditions import CONDITIONS

BEGIN, END = "<!-- scores: begin -->", "<!-- scores: end -->"
HEADER = (
    "| condition | what | vectors | particles per window | RMS x / y / z | RMS z by third of depth | gross, raw % "
    "| replaced % | candidates % | within 1 / 2 std, x y z, % | s | GB |"
)


def rows(lines: list[dict[str, Any]]) -> list[str]:
    """Rows of one table, in the order of conditions.py; the last line of a condition counts."""
    last = {line["name"]: line for line in lines}
    return [row(last[name]) for name in CONDITIONS if name in last]


def row(line: dict[str, Any]) -> str:
    name = line["name"]
    cells = [f"`{name}`", CONDITIONS[name].varies]
    if "error" in line:
        return f"| {' | '.join(cells)} | failed: {line['error']} |" + " |" * 9
    score, frame = line["score"], next(iter(line["summary"]["reconstruction"].values()))
    final, raw = score["final"], score["raw"]
    bands = final["by_depth"]
    cells += [
        str(score["vectors"]),
        f"{score['particles_per_window']:.0f}",
        " / ".join(f"{v:.3f}" for v in final["rms"]),
        " / ".join(f"{band['rms'][2]:.2f}" for band in bands) + f" (to {bands[-1]['to_mm']:.1f} mm)" if bands else "",
        f"{100 * raw['gross']:.1f}",
        f"{100 * score['replaced']:.1f}",
        f"{100 * frame['candidate_share']:.1f}",
        " / ".join(" ".join(f"{100 * v:.0f}" for v in score[f"inside_{k}_std"]) for k in (1, 2)),
        f"{line['wall_s']:.0f}",
        f"{line['peak_bytes'] / 1e9:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def tables(lines: list[dict[str, Any]]) -> str:
    """All tables as Markdown, each under a line with its settings."""
    by_settings: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for line in lines:
        by_settings.setdefault(tuple(line["settings"]), []).append(line)
    parts = []
    for settings, group in by_settings.items():
        said = ", ".join(f"`{s}`" for s in settings) if settings else "as in the recordings' experiment files"
        versions = sorted({line["summary"]["plenopiv"] for line in group if "summary" in line})
        divider = "|---|---|" + "---:|" * (HEADER.count("|") - 3)
        table = "\n".join([HEADER, divider, *rows(group)])
        parts.append(f"Settings: {said}. PlenoPIV {', '.join(versions)}.\n\n{table}")
    return "\n\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", type=Path, nargs="?", default=Path("build/accuracy/scores.jsonl"))
    parser.add_argument("--into", type=Path, default=Path(__file__).parents[2] / "docs" / "accuracy.md", metavar="FILE")
    arguments = parser.parse_args()
    lines = [json.loads(text) for text in arguments.scores.read_text().splitlines()]
    page = arguments.into.read_text()
    before, mark, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        parser.error(f"{arguments.into} has no {BEGIN} ... {END}")
    arguments.into.write_text(f"{before}{BEGIN}\n{tables(lines)}\n{END}{after}")


if __name__ == "__main__":
    main()
