"""Do the stated intervals hold? Statistics of 200 synthetic fields whose turbulence is known, against the truth.

Gaussian fields with a mean, a Reynolds stress tensor and a correlation in time (each component a sum of AR(1)
processes) and in space, random errors of vectors that are known, and vectors that are missing. Writes error_bars.json
beside this file, and the tables of docs/statistics.md; two minutes.
"""

import json
import sys
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter

from plenopiv.statistics import SeriesStatistics
from plenopiv.statistics.variables import INTERVAL

SHAPE = (12, 20, 24)
STRESS = np.array([[1.0, -0.35, 0.1], [-0.35, 0.6, 0.05], [0.1, 0.05, 0.4]])
ROOT = np.linalg.cholesky(STRESS)
SMOOTH = 1.0  # vectors, sigma of the filter that makes neighbours alike
NOISE = 0.25  # m/s at the middle; 0.7 to 1.3 of it through depth
MISSING = 0.03
CASES = {  # memory of the AR(1) processes, number of fields
    "independent": ((0.0,), 200),
    "correlated, T = 1.9": ((0.3,), 200),
    "correlated, T = 4": ((0.6,), 200),
    "correlated, T = 9": ((0.8,), 200),
    "two time scales": ((0.3, 0.85), 200),
    "independent, 50 fields": ((0.0,), 50),
    "correlated, T = 4, 1000 fields": ((0.6,), 1000),
}
DRAWS = 3
PAGE = Path(__file__).parents[2] / "docs" / "statistics.md"


def turbulence(rng, memories, count):
    """Fields (3, z, y, x) with STRESS."""
    impulse = np.zeros(SHAPE)
    impulse[0, 0, 0] = 1.0
    left = np.sqrt((gaussian_filter(impulse, SMOOTH, mode="wrap") ** 2).sum())

    def white():
        return np.stack([gaussian_filter(c, SMOOTH, mode="wrap") for c in rng.normal(size=(3, *SHAPE))]) / left

    states = [white() for _ in memories]
    for _ in range(count):
        yield np.einsum("ij,j...->i...", ROOT, sum(states)) / np.sqrt(len(states))
        states = [a * s + np.sqrt(1 - a * a) * white() for a, s in zip(memories, states, strict=True)]


def statistics_of(seed, memories, count):
    rng = np.random.default_rng(seed)
    z, _, x = np.meshgrid(*(np.linspace(0, 1, n) for n in SHAPE), indexing="ij")
    mean = np.stack([5 + 3 * x, 2 - 4 * z, 0 * z])
    noise = NOISE * (0.7 + 0.6 * np.broadcast_to(z, (3, *SHAPE)))
    dims, statistics = ("z", "y", "x"), None
    for fluctuation in turbulence(rng, memories, count):
        values = mean + fluctuation + noise * rng.normal(size=noise.shape)
        measured = rng.random(SHAPE) > MISSING
        field = xr.Dataset(
            {n: (dims, np.where(measured, v, 0.0)) for n, v in zip("uvw", values, strict=True)}
            | {f"{n}_std": (dims, s) for n, s in zip("uvw", noise, strict=True)}
            | {"valid": (dims, measured.astype(np.int8))},
            {axis: np.arange(float(n)) for axis, n in zip(dims, SHAPE, strict=True)},
        )
        statistics = statistics or SeriesStatistics(field)
        statistics.add(field)
    truth = {f"{n}_skewness": 0.0 for n in "uvw"}
    for a, name in enumerate("uvw"):
        truth[f"{name}_mean"] = mean[a]
        truth[f"{name}_rms_corrected"] = np.sqrt(STRESS[a, a])
        truth[f"{name * 2}_corrected"] = STRESS[a, a]
        truth[f"{name * 2}"] = STRESS[a, a] + noise[a] ** 2
        truth[f"{name}_rms"] = np.sqrt(STRESS[a, a] + noise[a] ** 2)
        truth |= {name + "uvw"[b]: STRESS[a, b] for b in range(a + 1, 3)}
    return statistics.result(), truth


def group(name):
    base = name.removesuffix("_corrected")
    kind = base.split("_")[1] if "_" in base else ("normal stress" if base[0] == base[1] else "shear stress")
    return kind + (", less random errors" if name.endswith("_corrected") else "")


def main(cases):
    found = {}
    for name in cases:
        memories, count = CASES[name]
        inside, independent = {}, []
        for draw in range(DRAWS):
            result, truth = statistics_of(draw, memories, count)
            independent.append(float((result.samples / result.u_independent_samples).mean()))
            for key, value in truth.items():
                ok = np.abs(result[key] - value) < INTERVAL * result[f"{key}_std"]
                inside.setdefault(key, []).append(100 * float(ok.mean()))
        groups = {}
        for key, shares in inside.items():
            groups.setdefault(group(key), []).append(np.mean(shares))
        found[name] = {
            "fields": count,
            "T_true": round(true_spacing(memories), 2),
            "T_found": round(float(np.mean(independent)), 2),
            "within": {k: round(float(np.mean(v)), 1) for k, v in groups.items()},
            "lowest_and_highest_variable": [
                round(f(float(np.mean(v)) for k, v in inside.items() if "skew" not in k), 1) for f in (min, max)
            ],
        }
        print(name, json.dumps(found[name]), flush=True)
    path = Path(__file__).with_suffix(".json")
    known = json.loads(path.read_text())["cases"] if path.exists() else {}
    about = {"places": int(np.prod(SHAPE)), "draws": DRAWS, "noise_m_s": NOISE, "missing": MISSING}
    path.write_text(json.dumps(about | {"cases": known | found}, indent=1) + "\n")
    write_page()


def true_spacing(memories):
    """T of u, noise of the vectors included (its mean through depth is near enough)."""
    share = 1 / (1 + NOISE**2)
    return 1 + share * np.mean([2 * a / (1 - a) for a in memories])


def write_page():
    """The tables of docs/statistics.md from the two JSON files."""
    here = Path(__file__).parent
    cases = json.loads((here / "error_bars.json").read_text())["cases"]
    kinds = list(next(iter(cases.values()))["within"])
    rows = [f"| fields | n | T true / found | {' | '.join(kinds)} |", "|---|---:|---|" + "---:|" * len(kinds)]
    for name, case in cases.items():
        cells = [f"{case['within'][k]:.1f}" for k in kinds]
        times = f"{case['T_true']} / {case['T_found']}"
        rows.append(f"| {name} | {case['fields']} | {times} | {' | '.join(cells)} |")
    of_neighbours = json.loads((here / "neighbours.json").read_text())["settings"]
    other = [
        "| windows | r(1), r(2) computed | measured x; y; z | derivatives in 1, 2 std, % | vorticity | divergence |",
        "|---|---|---|---|---|---|",
    ]
    for name, case in of_neighbours.items():
        measured = "; ".join(f"{one:.2f}, {two:.2f}" for _, one, two in case["measured"])
        computed = "{1:.2f}, {2:.2f}".format(*case["computed"][0])
        shares = [
            "{}, {}".format(*case["within_1_2_std"][f"{kind}, all"])
            for kind in ("derivative", "vorticity", "divergence")
        ]
        other.append(f"| {name} | {computed} | {measured} | {' | '.join(shares)} |")
    text = PAGE.read_text()
    for mark, table in (("coverage", rows), ("neighbours", other)):
        begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
        before, rest = text.split(begin)
        text = before + begin + "\n" + "\n".join(table) + "\n" + end + rest.split(end)[1]
    PAGE.write_text(text)


if __name__ == "__main__":
    main(sys.argv[1:] or list(CASES))
