"""docs/white-images.md from benchmarks/calibration/white_scores.json and benchmarks/accuracy/arrays.json.

python benchmarks/calibration/white_page.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from white_scores import RESULTS, RIGHT_PX, summary

PAGE = Path(__file__).resolve().parents[2] / "docs" / "white-images.md"
ARRAYS = PAGE.parents[1] / "benchmarks" / "accuracy" / "arrays.json"
# The method before cat's eyes, spots and maps were fitted, on the same 200 cameras.
BEFORE = {"answered": 175, "right": 112, "wrong and warned": 9, "wrong in silence": 54, "refused": 19, "crashed": 6}


def row(words, found):
    """One line of the table."""
    answered = [f["worst_px"] for f in found if "worst_px" in f]
    if not answered:
        return f"| {words} | {len(found)} | 0 | | | | |"
    s = summary(found)
    share = 100.0 * s["right"] / len(answered)
    return (
        f"| {words} | {len(found)} | {len(answered)} | {s['right']} ({share:.0f} %) | {s['wrong in silence']} | "
        f"{s['refused'] + s['crashed']} | {np.median(answered):.3f} |"
    )


def array_row(name, case):
    """One line of the table of arrays."""
    rms, over = (" / ".join(f"{v:.3f}" for v in case[key]) for key in ("rms", "rms_over_regular"))
    return f"| {name} | {case['pairs']} | {rms} | {over} |"


def page(found):
    """The page's text."""
    lines = list(found.values())
    kinds = {
        "all": lines,
        "rim clips more than 0.1 px": [f for f in lines if f["cat_eye_px"] > 0.1],
        "spots": [f for f in lines if f["spot"]],
        "neither": [f for f in lines if f["cat_eye_px"] <= 0.1 and not f["spot"]],
    }
    table = "\n".join(row(words, some) for words, some in kinds.items())
    refused = [f"- {k}: {v.get('refused') or v['crashed']}" for k, v in found.items() if "worst_px" not in v]
    wrong = [f"- {k}: {v['worst_px']:.2f} px" for k, v in found.items() if v.get("worst_px", 0) > RIGHT_PX]
    return f"""# White images of random cameras

Written by `benchmarks/calibration/white_page.py`. Cameras drawn at random, each from its number
(`benchmarks/calibration/random_cameras.py`, which shares no code with the calibration): square and hexagonal arrays,
pitch 6 to 40 px, any offset, turned by up to 6 degrees, stretched by up to 0.5 %, distorted by up to 2 px in the
corner, with vignetting, cat's eyes, spots, overlapping and under-filled micro-images, uneven light within them, noise
up to 25 electrons, hot pixels, dead microlenses, dust, saturation and stripes. *Right*: every fitted centre on the
sensor within {RIGHT_PX} px of its chief ray; *px*: the farthest centre of a camera, median over cameras.

| cameras | drawn | answered | right | wrong in silence | refused | px |
|---|---:|---:|---:|---:|---:|---:|
{table}

One similarity fitted to centres of whole discs, as before, answered {BEFORE["answered"]} of cameras 0 to 199,
{BEFORE["right"]} of them right and {BEFORE["wrong in silence"]} wrong in silence, refused {BEFORE["refused"]} and
crashed on {BEFORE["crashed"]}.

Refused, by number:

{chr(10).join(refused) or "none"}

Farther off than {RIGHT_PX} px:

{chr(10).join(wrong) or "none"}

## What irregular arrays cost a measurement

Written down by `benchmarks/accuracy/arrays.py`: one flow, recorded through a regular array, through one whose rows are
0.5 % further apart, and through one whose microlenses are 2 px further off the axis in the corner; RMS in voxels.

| array | pairs | RMS x / y / z | over the regular array |
|---|---:|---:|---:|
{chr(10).join(array_row(name, case) for name, case in json.loads(ARRAYS.read_text()).items())}
"""


if __name__ == "__main__":
    PAGE.write_text(page(json.loads(RESULTS.read_text())), encoding="utf-8")
