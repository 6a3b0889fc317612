"""Vectors of frames that are reconstructed together, beside those of frames that are reconstructed one by one:

    python benchmarks/accuracy/motion_tracking.py [NAME ...] [--out DIR]

Conditions of conditions.py; recordings are kept in DIR/NAME. Each is run with reconstruction.motion_tracking 0, 1
and 2. Writes motion_tracking.json and its table in docs/decisions/0064-both-frames-together.md: RMS errors in voxels
against the mean of the flow in the window and at the vector, share of errors within one and two error bars, processor
seconds.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
from conditions import CONDITIONS
from true_particles import scored

import plenopiv
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment

RECORDED = Path(__file__).with_name("motion_tracking.json")
PAGE = Path(__file__).parents[2] / "docs" / "decisions" / "0064-both-frames-together.md"
NAMES = "base", "dim", "ppm2", "abc", "ring", "depth20"
PASSES = 0, 1, 2
HEAD = (
    "| condition | together | RMS x / y / z | at the vector | within 1 std % | within 2 std % | processor s |\n"
    "|---|---:|---|---|---|---|---:|"
)


def measured(name: str, folder: Path, passes: int) -> dict[str, object]:
    """One run of a recording, scored."""
    experiment = Experiment.load(folder / "experiment.toml")
    begin = time.process_time()
    found = plenopiv.process(experiment.changed(motion_tracking=passes), overwrite=True)
    seconds = time.process_time() - begin
    score = scored(found.velocity, experiment)
    return {
        "rms": score.final.rms,
        "bias": score.final.bias,
        "gross": score.final.gross,
        "rms_at_point": None if score.final_at_point is None else score.final_at_point.rms,
        "inside_1_std": score.inside_1_std,
        "inside_2_std": score.inside_2_std,
        "processor_s": seconds,
    }


def table(found: dict[str, dict[str, dict]]) -> str:
    """Markdown."""
    lines = [HEAD]
    for name, runs in found.items():
        for passes, run in runs.items():
            rms, point = (" / ".join(f"{v:.3f}" for v in run[key] or ()) for key in ("rms", "rms_at_point"))
            one, two = (" ".join(f"{100 * v:.0f}" for v in run[key]) for key in ("inside_1_std", "inside_2_std"))
            lines.append(f"| `{name}` | {passes} | {rms} | {point} | {one} | {two} | {run['processor_s']:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, record, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("build/motion_tracking"), metavar="DIR")
    options = parser.parse_args()
    warnings.simplefilter("ignore", PlenoPIVWarning)
    found: dict[str, dict[str, dict]] = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    for name in options.names:
        folder = options.out / name
        if not (folder / "experiment.toml").exists():
            CONDITIONS[name].simulate(folder)
        found[name] = {}
        for passes in PASSES:
            found[name][str(passes)] = measured(name, folder, passes)
            print(name, passes, np.round(found[name][str(passes)]["rms"], 3), flush=True)
        RECORDED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    before, rest = PAGE.read_text(encoding="utf-8").split("<!-- together: begin -->\n")
    after = rest.split("<!-- together: end -->")[1]
    text = f"{before}<!-- together: begin -->\n{table(found)}\n<!-- together: end -->{after}"
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
