"""The memory that runs announce against what they take:  memory.py SCORES

SCORES: the scores.jsonl of benchmarks/accuracy/run_conditions.py, where each run is a process of its own with its
kernels compiled. Writes memory.json beside this file and prints a table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def main() -> None:
    """Read, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scores", type=Path)
    runs = {}
    for text in parser.parse_args().scores.read_text().splitlines():
        line = json.loads(text)
        if "score" in line:
            name = " ".join([line["name"], *line["settings"]])
            runs[name] = line["summary"]["voxels"], line["summary"]["memory_estimate_gb"], line["peak_bytes"] / 1e9
    print("| run | voxels, millions | announced, GB | taken, GB | ratio |\n|---|---:|---:|---:|---:|")
    for name, (voxels, announced, taken) in runs.items():
        print(f"| {name} | {voxels / 1e6:.1f} | {announced:.2f} | {taken:.2f} | {announced / taken:.2f} |")
    Path(__file__).with_suffix(".json").write_text(json.dumps(runs, indent=1) + "\n")


if __name__ == "__main__":
    main()
