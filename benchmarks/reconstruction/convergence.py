"""Run variants of MART on the same recordings; tabulate every iteration:  convergence.py [WORDS] [--out DIR]

Runs the cases of cases.py whose group or name holds one of WORDS (all of them by default), keeps what other cases
found before in results.json, and writes results.json and results.md; without --out also the figures and the table of
docs/reconstruction.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cases import CASES, Case
from convergence_scene import CONDITIONS, SHIFT_VOXELS, WINDOWS, Condition
from convergence_table import into_page, page, summary
from figures import draw
from resampling import raw_where_resampled, resampled
from variants import candidates, dark_noise, first_guess, lit_threshold, residual, uniform_start

from plenopiv.accuracy import exact_volume, intensity_centre_mm, reconstruction_quality
from plenopiv.chain import Chain
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.lightfield import LightField, decode
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.reconstruct import SMALLEST_FLOOR
from plenopiv.volume import SparseVolume

HERE = Path(__file__).parent
DOCS = HERE.parents[1] / "docs"
OFF_FOCUS_MM = 1.2  # windows and particles further than this from focus are judged apart: four dead zones
DECODED = {"raw": decode, "resampled": resampled, "raw where resampled": raw_where_resampled}
CENTRE_REACH_VOXELS = (5.0, 5.0, 4.0)


@cache
def condition_of(name: str, seed: int) -> Condition:
    condition = CONDITIONS[name]
    return replace(condition, seed=condition.seed + 10 * seed)


@cache
def light_field(condition: Condition, frame: int, pixels: str) -> LightField:
    image = condition.images[frame]
    return DECODED[pixels](image, condition.layout)


@cache
def projector_of(condition: Condition, pixels: str, weights: str) -> PlenopticProjector:
    return PlenopticProjector(light_field(condition, 0, pixels).layout, condition.grid, weights)


@cache
def listed(condition: Condition, frame: int, pixels: str, weights: str, tolerance_px: float) -> SparseVolume:
    field, projector = light_field(condition, frame, pixels), projector_of(condition, pixels, weights)
    return candidates(field.values, projector, lit_threshold(field), tolerance_px)


@cache
def exact(condition: Condition):
    particles = condition.particles[0]
    return exact_volume(particles.position_mm, particles.electrons * condition.gain, condition.grid)


def start_of(case: Case, condition: Condition, frame: int, floor: float) -> SparseVolume:
    projector = projector_of(condition, case.pixels, case.weights)
    values = light_field(condition, frame, case.pixels).values
    if case.start == "everywhere":
        return uniform_start(values, projector, projector.every_voxel())
    voxels = listed(condition, frame, case.pixels, case.weights, case.tolerance_px)
    if case.start == "uniform":
        return uniform_start(values, projector, voxels)
    mean, _, power = case.start.partition("^")
    return first_guess(values, projector, voxels, floor, mean, float(power or 1.0))


def volumes(case: Case, condition: Condition, frame: int) -> Iterator[tuple[int, float, SparseVolume]]:
    """(iteration, seconds so far, volume) at the iterations that are judged; iteration 0 is the start."""
    field, projector = light_field(condition, frame, case.pixels), projector_of(condition, case.pixels, case.weights)
    floor = max(dark_noise(field), SMALLEST_FLOOR)
    start = start_of(case, condition, frame, floor)
    yield 0, 0.0, start
    rounds, spent = case.solver()(field.values, projector, start, floor=floor), 0.0
    for number in range(1, case.rounds[-1] + 1):
        begin = time.perf_counter()
        volume = next(rounds)
        spent += time.perf_counter() - begin
        if number in case.rounds:
            yield number, spent, volume


def displacement_errors(condition: Condition, a: SparseVolume, b: SparseVolume) -> tuple[np.ndarray, np.ndarray, float]:
    """Errors in voxels (window, 3) before outliers are replaced, |z| of the windows in mm, share replaced."""
    correlation = CorrelationSettings(WINDOWS, inner_window=WINDOWS[-1], fine_passes=3)
    field = Chain((condition.camera,), condition.grid, correlation=correlation).displacement(a, b)
    error = np.moveaxis(field.displacement, 0, -1) - SHIFT_VOXELS
    z = np.abs(condition.grid.first_mm[2] + field.z * condition.grid.voxel_mm[2])
    z = np.broadcast_to(z[:, None, None], error.shape[:3])
    return error.reshape(-1, 3), z.ravel(), float(1 - field.valid.mean())


def centre_errors(condition: Condition, volume: SparseVolume) -> np.ndarray:
    """Off-focus particles' intensity centres minus their places, voxels (n, 3)."""
    voxel = np.array(condition.grid.voxel_mm)
    reach = tuple(np.array(CENTRE_REACH_VOXELS) * voxel)
    dense = volume.dense()
    places = [p for p in condition.particles[0].position_mm if abs(p[2]) > OFF_FOCUS_MM]
    return np.array([(intensity_centre_mm(dense, tuple(p), reach) - p) / voxel for p in places])  # type: ignore[arg-type]


def rms(values: np.ndarray) -> list[float]:
    return np.sqrt(np.nanmean(values**2, axis=0)).tolist()


def judge(case: Case, name: str) -> Iterator[dict[str, Any]]:
    """One row for every iteration that is judged, over all of the case's recordings under one condition."""
    seeds = case.seeds if name != "alone" else 1
    found: dict[int, dict[str, list]] = {}
    for seed in range(seeds):
        condition = condition_of(name, seed)
        projector = projector_of(condition, case.pixels, case.weights)
        field = light_field(condition, 0, case.pixels)
        first = list(volumes(case, condition, 0))
        later = list(volumes(case, condition, 1)) if name != "alone" else []
        for n, (number, seconds, volume) in enumerate(first):
            row = found.setdefault(number, {})
            row.setdefault("residual", []).append(residual(field.values, projector, volume))
            row.setdefault("q", []).append(reconstruction_quality(volume, exact(condition)))
            row.setdefault("seconds", []).append(seconds)
            row.setdefault("voxels", []).append(volume.values.size / condition.grid.size)
            if name == "alone":
                row.setdefault("centre", []).append(centre_errors(condition, volume))
            elif number > 0 or case.start not in ("uniform", "everywhere"):
                error, z, replaced = displacement_errors(condition, volume, later[n][2])
                row.setdefault("error", []).append(error)
                row.setdefault("off_focus", []).append(error[z > OFF_FOCUS_MM])
                row.setdefault("replaced", []).append(replaced)
    for number, row in found.items():
        yield {
            "group": case.group,
            "name": case.name,
            "condition": name,
            "round": number,
            "work": number * case.work,
            **{key: float(np.mean(row[key])) for key in ("residual", "q", "seconds", "voxels")},
            **({"centre": rms(np.concatenate(row["centre"]))} if "centre" in row else {}),
            **({k: rms(np.concatenate(row[k])) for k in ("error", "off_focus")} if "error" in row else {}),
            **({"replaced": float(np.mean(row["replaced"]))} if "error" in row else {}),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="WORDS")
    parser.add_argument("--out", type=Path, default=HERE, metavar="DIR", help="where results.md and .json go")
    arguments = parser.parse_args()
    file = arguments.out / "results.json"
    known = json.loads(file.read_text())["rows"] if file.exists() else []
    for case in CASES:
        if arguments.words and not any(word in f"{case.group} {case.name}" for word in arguments.words):
            continue
        rows = [row for name in case.conditions for row in judge(case, name)]
        known = [row for row in known if row["name"] != case.name] + rows
        last = next(row for row in reversed(rows) if "error" in row)
        print(
            f"{case.name}: iteration {last['round']} ({last['condition']}): "
            f"{last['error']}, off focus {last['off_focus']}, {last['seconds']:.1f} s",
            flush=True,
        )
        names = [c.name for c in CASES]
        known = sorted((row for row in known if row["name"] in names), key=lambda row: names.index(row["name"]))
        noise = {name: condition_of(name, 0).noise_counts for name in CONDITIONS}
        file.write_text(json.dumps({"noise_counts": noise, "rows": known}, indent=1) + "\n")
    results = json.loads(file.read_text())
    says = {name: condition.says for name, condition in CONDITIONS.items()}
    (arguments.out / "results.md").write_text(page(results["rows"], results["noise_counts"], says))
    if arguments.out == HERE:
        text = DOCS / "reconstruction.md"
        text.write_text(into_page(text.read_text(), summary(results["rows"])))
        draw(results["rows"], results["noise_counts"], DOCS / "images")


if __name__ == "__main__":
    main()
