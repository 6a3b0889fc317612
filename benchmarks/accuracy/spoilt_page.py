"""The page of the campaign with spoilt recordings, docs/spoilt.md."""

from __future__ import annotations

from typing import Any

from conditions import CONDITIONS
from spoiling import Case

HEAD = """# Spoilt recordings: refused, set aside, warned of, or measured all the same

Written by `benchmarks/accuracy/spoilt.py`. One recording of four pairs (800 x 640 px, rotation with a drift), spoilt in
one way at a time and given to `plenopiv run`. RMS: of the errors, over that of the same particles unspoilt, the largest
of the three axes, *none* where all vectors are gross errors; *as if unspoilt* is at most 1.15 and no gross errors more.
A warning counts where it names the cause. *Silent* are those that no image can show: the orientation of all images,
swapped pulses, dt, microlens focal length and aperture together.
"""
WORDS = 160  # of a message that are shown


STATIC = """
## Static light taken off

Written by `benchmarks/accuracy/static_light.py`: ten of thirty pairs, pulses varying by 3 %, measured with images of
the static light of each pulse and a dark image, or with `recording.background = "minimum"` of all thirty. RMS errors
along x / y / z in voxels and over those of the clean recording, outside windows in which particles light saturated
pixels; share of the errors within one and two stated standard deviations. Asked for are 60 to 80 % and 90 to 98 %.

| light | taken off by | RMS | over clean | within 1 std, % | within 2 std, % | error bars |
|---|---|---|---|---|---|---|
"""


def page(lines: list[dict[str, Any]], cases: dict[str, Case], static: list[dict[str, Any]]) -> str:
    """The page as Markdown, from the lines of the campaign and those of static_light.py."""
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
        ratio = f"{line['ratio']:.2f}" if "ratio" in line else "none" if line.get("gross") == 1 else ""
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
    return "\n".join(parts) + "\n" + STATIC + "\n".join(map(_static, static)) + "\n"


def _static(line: dict[str, Any]) -> str:
    one, two = (" / ".join(f"{100 * share:.0f}" for share in shares) for shares in line["within"])
    rms, ratio = (" / ".join(f"{v:.{d}f}" for v in line[key]) for key, d in (("rms", 3), ("ratio", 2)))
    return f"| {line['what']} | {line['way']} | {rms} | {ratio} | {one} | {two} | {line['bars']} |"


def _outcomes(lines: list[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(line["outcome"] for line in lines))


def _shown(words: str) -> str:
    """A message as a cell of a table, without the folder of the temporary copy."""
    words = words.replace("|", "/").replace("\n", " ")
    return words if len(words) <= WORDS else words[: WORDS - 3].rsplit(" ", 1)[0] + " ..."
