"""Correlation of the errors of neighbouring vectors, and whether the error bars of derivatives cover: simulated volumes
of a uniform motion against ``statistics.gradients``. Writes neighbours.json beside this file and the table of
docs/statistics.md; some minutes. "page" writes the latter alone."""

import json
import sys
from pathlib import Path

import numpy as np

from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.statistics.gradients import neighbour_correlation, velocity_gradients
from plenopiv.velocity import velocity_dataset

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tests"), str(ROOT / "benchmarks")]
import page_tables  # noqa: E402
from oracles.particle_volumes import render  # noqa: E402

from plenopiv.volume import DenseVolume, VoxelGrid  # noqa: E402

SHAPE, MOTION, JITTER, DENSITY = (112, 112, 112), np.array([0.3, -0.4, 0.2]), 0.15, 1.5e-3
GRID = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), SHAPE)
SETTINGS = {
    "sub-windows, 50 %": CorrelationSettings(windows=((32, 32, 32),)),
    "no sub-windows, 50 %": CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32), fine_passes=3),
    "sub-windows, 75 %": CorrelationSettings(windows=((32, 32, 32),), overlap=0.75),
    "sub-windows, 0 %": CorrelationSettings(windows=((32, 32, 32),), overlap=0.0),
}
RECORD = Path(__file__).with_suffix(".json")


def page(found):
    """Put the table into docs/statistics.md."""
    head, shares = (
        "windows | r(1), r(2) computed | measured x; y; z",
        "derivatives in 1, 2 std, % | vorticity | divergence",
    )
    lines = [f"| {head} | {shares} |", "|---|---|---|---|---|---|"]
    for name, told in found["settings"].items():
        computed, *measured = (f"{r1:.2f}, {r2:.2f}" for _, r1, r2 in (told["computed"][0], *told["measured"]))
        within = told["within_1_2_std"]
        inside = (", ".join(map(str, within[f"{of}, all"])) for of in ("derivative", "vorticity", "divergence"))
        lines.append("| " + " | ".join((name, computed, "; ".join(measured), *inside)) + " |")
    page_tables.put(ROOT / "docs" / "statistics.md", "neighbours", lines)


def volumes(seed):
    rng = np.random.default_rng(seed)
    count = rng.poisson(DENSITY * np.prod(np.array(SHAPE) + 24))
    middle = rng.uniform(-12, np.array(SHAPE) + 11, (count, 3))
    light = np.exp(0.3 * rng.standard_normal(count))
    for side in (-0.5, 0.5):
        at = middle + side * MOTION + JITTER * rng.standard_normal(middle.shape)
        yield DenseVolume(GRID, render(SHAPE, at, light, (1.0, 1.0, 1.0)))


def main(seeds):
    found = {}
    for name, settings in SETTINGS.items():
        sums, counts, within, derivatives = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(2), {}
        for seed in range(seeds):
            field = measure(*volumes(seed), settings)
            error = field.displacement - MOTION[:, None, None, None]
            for axis in range(3):
                along = np.moveaxis(error, 3 - axis, 1)
                for apart in range(3):
                    n = along.shape[1] - apart
                    if n > 0:
                        sums[axis, apart] += (along[:, :n] * along[:, apart:]).sum()
                        counts[axis, apart] += along[:, :n].size
            within += [np.mean(np.abs(error) < k * field.std) / seeds for k in (1, 2)]
            if min(field.displacement.shape[1:]) > 2:
                dataset = velocity_gradients(velocity_dataset(field, GRID, 1.0).isel(time=0), settings)
                for key in dataset:
                    if not key.endswith("_std") and key != "q":
                        ratio = (dataset[key] / dataset[f"{key}_std"]).values
                        group = key.split("_")[0] if key.startswith(("vort", "div")) else "derivative"
                        for place, values in (("inside", ratio[1:-1, 1:-1, 1:-1]), ("all", ratio)):
                            derivatives.setdefault(f"{group}, {place}", []).append(values.ravel())
        measured = sums / np.maximum(counts, 1)
        measured /= measured[:, :1]
        found[name] = {
            "computed": np.round(neighbour_correlation(settings), 3).tolist(),
            "measured": np.round(measured, 3).tolist(),
            "vectors_within_1_2_std": np.round(100 * within, 1).tolist(),
            "within_1_2_std": {
                k: [round(100 * float(np.mean(np.abs(np.concatenate(v)) < s)), 1) for s in (1, 2)]
                for k, v in derivatives.items()
            },
        }
        print(name, json.dumps(found[name]), flush=True)
    result = {"volumes": seeds, "jitter_voxels": JITTER, "particles_per_voxel": DENSITY, "settings": found}
    RECORD.write_text(json.dumps(result, indent=1) + "\n")
    page(result)


if __name__ == "__main__":
    if sys.argv[1:] == ["page"]:
        page(json.loads(RECORD.read_text()))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
