"""The page of the campaign with spoilt recordings, docs/spoilt.md."""

from __future__ import annotations

from typing import Any

from conditions import CONDITIONS
from spoiling import Case

HEAD = """# Spoilt recordings: refused, set aside, warned of, or measured all the same

Written by `benchmarks/accuracy/spoilt.py`. One recording of four pairs (800 x 640 px, rotation with a drift), spoilt in
one way at a time and given to `plenopiv run`. RMS: of the errors, over that of the same particles unspoilt, the largest
of the three axes; *as if unspoilt* is at most 1.15 and no gross errors more. A warning counts where it names the cause.
*Silent* are those that no image can show: the orientation of all images, swapped pulses, dt, magnification and pixel
pitch together, microlens focal length and aperture together.
"""
WORDS = 160  # of a message that are shown


def page(lines: list[dict[str, Any]], cases: dict[str, Case]) -> str:
    """The page as Markdown, from the lines of the campaign."""
    by_name = {line["name"]: line for line in lines}
    spoilt = [by_name[name] for name in cases]
    counts = {outcome: sum(line["outcome"] == outcome for line in spoilt) for outcome in _outcomes(spoilt)}
    said = ", ".join(f"{outcome} {count}" for outcome, count in counts.items())
    parts = [
        HEAD,
        f"{len(spoilt)} cases: {said}.",
        "",
        "| spoilt by | outcome | RMS | what is said |",
        "|---|---|---:|---|",
    ]
    for line in spoilt:
        ratio = f"{line['ratio']:.2f}" if "ratio" in line else ""
        parts.append(f"| {cases[line['name']].what} | {line['outcome']} | {ratio} | {_shown(line['why'])} |")
    quiet = [line for line in lines if line["name"] not in cases]
    parts += [
        "",
        "## No false alarm",
        "",
        "Nothing is wrong in these, the conditions of [accuracy](accuracy.md) on",
        "",
    ]
    parts[-2] = "Nothing is wrong with these: conditions of [accuracy.md](accuracy.md) on the small sensor, 5 mm deep."
    parts += ["| condition | outcome | what is said |", "|---|---|---|"]
    for line in quiet:
        what = CONDITIONS[line["name"].removeprefix("condition ")].varies
        parts.append(f"| {what} | {line['outcome']} | {_shown(line['why'])} |")
    took = sum(line["cpu_s"] for line in lines)
    parts += ["", f"{took / 60:.0f} minutes of one core in all."]
    return "\n".join(parts) + "\n"


def _outcomes(lines: list[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(line["outcome"] for line in lines))


def _shown(words: str) -> str:
    """A message as a cell of a table, without the folder of the temporary copy."""
    words = words.replace("|", "/").replace("\n", " ")
    return words if len(words) <= WORDS else words[: WORDS - 3].rsplit(" ", 1)[0] + " ..."
