"""What `plenopiv design` predicts beside what full runs then score:  designed.py [NAMES] [--out DIR] [--depth LOW HIGH]

NAMES are presets, default the paper's three cameras. A full run is a recording of the camera's own sensor, simulated
with its white image and run as a user would; cameras with few windows are recorded several times, until some hundred
vectors are judged. Both move uniformly. Adds to designed.json beside this file and writes the table of docs/design.md.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from true_particles import scored

import plenopiv
from plenopiv.accuracy import Score, pooled
from plenopiv.cameras.plenoptic import PlenopticCamera
from plenopiv.cameras.presets import preset
from plenopiv.design.advice import Measurement, suggested
from plenopiv.design.twin import DT_S, SHIFT, mounted, twin
from plenopiv.experiment import Experiment
from plenopiv.simulation.flows import flow
from plenopiv.simulation.simulated_recording import simulate_recording

VECTORS, MOST_RECORDINGS = 400, 40
HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "design.md"
BEGIN, END = "<!-- designed: begin -->", "<!-- designed: end -->"


def recorded(camera: PlenopticCamera, measured: Measurement, folder: Path, seed: int) -> Score:
    """One recording, run and scored."""
    moved = [1e-3 * share * side / DT_S for share, side in zip(SHIFT, measured.window_mm, strict=True)]
    simulate_recording(
        folder,
        mounted(camera),
        flow("uniform", velocity_m_s=moved),
        dt_s=DT_S,
        volume_mm=measured.limits_mm,
        voxel_mm=measured.voxel_mm,
        windows=measured.windows,
        seed=seed,
        overwrite=True,
    )
    experiment = Experiment.load(folder / "experiment.toml")
    found = plenopiv.process(experiment, overwrite=True)
    return scored(found.velocity, experiment)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["pmr8", "pmr14", "pmr28"])
    parser.add_argument("--out", type=Path, help="where recordings go; default: nowhere that lasts")
    parser.add_argument("--depth", type=float, nargs=2)
    parser.add_argument("--predict", action="store_true", help="predict anew, full runs as they were")
    asked = parser.parse_args()
    path = HERE / "designed.json"
    rows = json.loads(path.read_text()) if path.exists() else {}
    for name in asked.names:
        camera = preset(name)
        measured = suggested(camera, asked.depth and tuple(asked.depth))
        key = name if asked.depth is None else f"{name}, z from {asked.depth[0]:g} to {asked.depth[1]:g} mm"
        made = twin(camera, measured)
        predicted, scores = made.errors, list[Score]()
        told = {
            "predicted": predicted.rms,
            "predicted_by_depth": [b.rms for b in predicted.by_depth],
            "vectors_of_twin": made.vectors,
        }
        if asked.predict:
            rows[key] |= told
            write(path, rows)
            continue
        with tempfile.TemporaryDirectory(dir=asked.out) as scratch:
            while sum(s.vectors for s in scores) < VECTORS and len(scores) < MOST_RECORDINGS:
                scores.append(recorded(camera, measured, Path(scratch), 100 + len(scores)))
        scored = pooled(scores)
        rows[key] = told | {
            "scored": scored.rms,
            "scored_by_depth": [b.rms for b in scored.by_depth],
            "vectors": sum(s.vectors for s in scores),
            "recordings": len(scores),
        }
        off = ", ".join(f"{p / s - 1:+.0%}" for p, s in zip(predicted.rms, scored.rms, strict=True))
        both = " ".join(f"{p:.3f}" for p in predicted.rms), " ".join(f"{s:.3f}" for s in scored.rms)
        print(f"{key}: predicted {both[0]}, scored {both[1]} ({rows[key]['vectors']} vectors): {off}", flush=True)
        write(path, rows)


def write(path: Path, rows: dict[str, dict]) -> None:
    """The figures, and the table of docs/design.md."""
    path.write_text(json.dumps(rows, indent=1) + "\n")
    text = PAGE.read_text()
    before, rest = text.split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{table(rows)}\n{END}{rest.split(END)[1]}")


def table(rows: dict[str, dict]) -> str:
    """Markdown: what was predicted, what was scored, and by how much they differ."""
    lines = [
        "| camera | predicted | scored | off, % | vectors, twin and run | z by thirds of depth, predicted | scored |",
        "|---|---|---|---|---:|---|---|",
    ]
    for name, row in rows.items():
        off = " / ".join(f"{100 * (p / s - 1):+.0f}" for p, s in zip(row["predicted"], row["scored"], strict=True))
        rms = (" / ".join(f"{e:.3f}" for e in row[key]) for key in ("predicted", "scored"))
        depth = (" / ".join(f"{b[2]:.2f}" for b in row[f"{key}_by_depth"]) for key in ("predicted", "scored"))
        counted = f"{row['vectors_of_twin']}, {row['vectors']}"
        lines.append(f"| {' | '.join([name, *rms, off, counted, *depth])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
