"""Predicted and measured times of the runs of docs/accuracy.md:  scaling.py SCORES RECORDINGS [--fit]

SCORES: the scores.jsonl of benchmarks/accuracy/run_conditions.py; RECORDINGS: the folder of its recordings. Writes
scaling.json beside this file, docs/images/scaling.png, and prints a table; --fit also prints the costs that fit best.

Times are those of the machine of docs/speed.md: what was measured times the median of the speeds that the runs found as
each began. Runs are made one after the other on a machine that nobody else uses.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.optimize import least_squares

from plenopiv.experiment import Experiment
from plenopiv.run import duration

HERE = Path(__file__).parent
COSTS = ("READ", "TRACE", "DECODE", "WINDOW", "FIRST_PAIR")


def predicted(experiment: Experiment) -> duration.TimeEstimate:
    """As the run itself says."""
    camera = experiment.camera()
    settings = experiment.reconstruction.settings().through(camera), experiment.correlation.settings()
    return duration.of_settings(camera, experiment.grid(), *settings, numba.get_num_threads())


def draw(found: dict[str, tuple[float, ...]]) -> None:
    """Predicted over measured, of frames and of pairs."""
    from matplotlib import pyplot as plt

    _, frame, guess, pair, guess_pair, *_ = np.array(list(found.values())).T
    figure, axes = plt.subplots(figsize=(5, 4.5), layout="constrained")
    line = np.array([min(pair.min(), guess_pair.min()) / 1.5, max(frame.max(), guess.max()) * 1.5])
    axes.fill_between(line, line / 1.3, line * 1.3, color="0.9", label="within 30 %")
    axes.loglog(frame, guess, "o", label="a frame's reconstruction")
    axes.loglog(pair, guess_pair, "s", label="a pair's correlation")
    axes.set(xlabel="measured, s", ylabel="predicted, s", xlim=line, ylim=line)
    axes.legend()
    figure.savefig(HERE.parents[1] / "docs" / "images" / "scaling.png", dpi=120)


def main() -> None:
    """Read, predict, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scores", type=Path)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--fit", action="store_true")
    asked = parser.parse_args()
    runs: dict[str, tuple[Experiment, dict[str, Any]]] = {}
    for text in asked.scores.read_text().splitlines():
        line = json.loads(text)
        if "score" in line:
            runs[line["name"]] = Experiment.load(asked.recordings / line["name"] / "experiment.toml"), line["summary"]
    speed = float(np.median([s["machine_speed"] for _, s in runs.values()]))
    frames = speed * np.array([s["timings_s"]["reconstruction"] / len(s["frames"]) for _, s in runs.values()])
    pairs = speed * np.array([s["timings_s"]["correlation"] / (len(s["frames"]) - 1) for _, s in runs.values()])
    if asked.fit:

        def misses(logarithms: np.ndarray) -> np.ndarray:
            for name, value in zip(COSTS, np.exp(logarithms), strict=True):
                setattr(duration, name, value)
            found = [predicted(e) for e, _ in runs.values()]
            return np.log(
                np.array([f.frame for f in found] + [f.pair + duration.FIRST_PAIR for f in found])
                / np.concatenate([frames, pairs])
            )

        fitted = least_squares(misses, np.log([getattr(duration, name) for name in COSTS]), loss="soft_l1", f_scale=0.1)
        print({name: float(f"{v:.2g}") for name, v in zip(COSTS, np.exp(fitted.x), strict=True)})
    found = {}
    print("| run | voxels, millions | frame, s | predicted | pair, s | predicted | all, ratio |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for (name, (experiment, summary)), frame, pair in zip(runs.items(), frames, pairs, strict=True):
        guess = predicted(experiment)
        whole, measured = guess.run(len(summary["frames"])), speed * sum(summary["timings_s"].values())
        first_pair = guess.pair + duration.FIRST_PAIR
        found[name] = summary["voxels"], frame, guess.frame, pair, first_pair, measured, whole
        cells = summary["voxels"] / 1e6, frame, guess.frame, pair, first_pair
        print(f"| {name} | {' | '.join(f'{cell:.1f}' for cell in cells)} | {whole / measured:.2f} |")
    draw(found)
    (HERE / "scaling.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
