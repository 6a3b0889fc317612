"""The paper's section 4 (Fig. 10): DNS, LF-PIV and Tomo-PIV of one jet:  comparison.py [full | reduced | tiny]

Five measurements (``comparison_settings``), each in a process of its own: LF-PIV; exact volumes in place of its
reconstructed ones, which shows what its windows resolve; two plenoptic cameras at a right angle; Tomo-PIV at the
paper's settings; Tomo-PIV of the light field's particles in windows of the same size. All but the fourth are correlated
once more with sub-window averaging.

Cases that are not of today's program are measured, or those named after --only, one after the other. Ended and called
again it goes on: volumes are kept in build/comparison until all their fields are measured. Writes
results/comparison.json, its table results/comparison.md, and figures to docs/images/paper (comparison-full of the full
size, and what they show to results/fields); fields, with the DNS beside them, to build/comparison.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import comparison_figures
import lightfield_case
import numba
import numpy as np
import tomo_case
import two_cameras_case
from comparison_costs import announced
from comparison_scores import Judge
from comparison_settings import JET_M_S, SIZES, Comparison
from comparison_tables import inside, vorticity
from lightfield_case import Measured, Reconstructed
from outputs import table, three

from plenopiv.io.aside import written_aside
from plenopiv.io.netcdf import write_velocity
from plenopiv.run.memory import peak_so_far
from plenopiv.simulation.flows import flow

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
import fresh

ROOT = Path(__file__).parents[1]
TITLES = {
    "light_field": "LF-PIV",
    "light_field_inner": "LF-PIV, sub-windows",
    "exact": "exact volumes, LF's windows",
    "exact_inner": "exact volumes, sub-windows",
    "two": "LF-PIV, two cameras",
    "two_inner": "LF-PIV, two cameras, sub-windows",
    "tomo": "Tomo-PIV, the paper's",
    "matched": "Tomo-PIV, LF's particles and windows",
    "matched_inner": "Tomo-PIV, LF's particles, sub-windows",
}
MEASUREMENTS = tuple(name for name in TITLES if not name.endswith("_inner"))
SEED = 0


def reconstructed(name: str, setting: Comparison) -> Reconstructed:
    """One of MEASUREMENTS."""
    jet = flow("jet", at_mm=setting.jet_at_mm)
    if name == "light_field":
        return lightfield_case.reconstruct_light_field(setting.light_field, jet, SEED)
    if name == "exact":
        return lightfield_case.exact_volumes(setting.light_field, jet, SEED)
    if name == "two":
        lit = replace(setting.light_field, volume_mm=setting.two.volume_mm)
        return two_cameras_case.reconstruct_by_two(setting.two, lightfield_case.seeded(lit, jet, SEED), SEED)
    if name == "tomo":
        return tomo_case.reconstruct_tomo(setting.tomo, jet, seed=SEED)
    particles = lightfield_case.seeded(setting.light_field, jet, SEED)
    return tomo_case.reconstruct_tomo(setting.matched, jet, particles, SEED)


def fields_of(name: str) -> tuple[str, ...]:
    """The TITLES that one of MEASUREMENTS gives: with the setting's windows, and with sub-windows where it has any."""
    return tuple(title for title in (name, f"{name}_inner") if title in TITLES)


def kept(name: str, setting: Comparison, file: Path) -> tuple[Reconstructed, float | None]:
    """The volumes of one of MEASUREMENTS and the largest memory, bytes, that they took; of a ``file`` where it is
    there, and into it where it is not."""
    if file.exists():
        with file.open("rb") as stream:
            return pickle.load(stream)  # type: ignore[no-any-return]
    made = reconstructed(name, setting), peak_so_far()
    file.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(file) as aside, aside.open("wb") as stream:
        pickle.dump(made, stream)
    return made


def case(title: str, setting: Comparison, fields: Path, volumes: Path) -> dict[str, Any]:
    """Measure one of TITLES from volumes that are kept in a file, score it, and write the field with the window mean of
    the DNS as u_true, v_true, w_true and ``judged``."""
    made, before = kept(title.removesuffix("_inner"), setting, volumes)
    judge = Judge(flow("jet", at_mm=setting.jet_at_mm), made.setting.judged_mm)
    result = made.correlated(made.setting.inner_window if title.endswith("_inner") else None)
    return scored(title, result, judge, setting, fields, before)


def scored(
    name: str, result: Measured, judge: Judge, setting: Comparison, fields: Path, before: float | None
) -> dict[str, Any]:
    """What is told of one field; it is written. ``before``: memory, bytes, that its volumes took."""
    peak = max((each for each in (before, peak_so_far()) if each is not None), default=None)
    told, true = judge.score(result)
    dims = ("z", "y", "x")
    field = result.field.assign({f"{c}_true": (dims, v, {"units": "m s-1"}) for c, v in zip("uvw", true, strict=True)})
    field = field.assign(judged=(dims, np.isfinite(true[0]).astype("int8")))
    fields.mkdir(parents=True, exist_ok=True)
    write_velocity(fields / f"{setting.name}-{name}.nc", field)
    return told | {"peak_gb": None if peak is None else round(peak / 1e9, 3), "threads": numba.get_num_threads()}


def in_a_process(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What ``work`` returns, from a new process, so that the peak of memory is its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work).result()


def tables(results: dict[str, Any]) -> str:
    """Errors against the window mean by depth, then what else was measured, as Markdown."""
    rows, other = [], []
    for name, title in TITLES.items():
        found = results["cases"][name]
        for band, e in found["errors"]["window_mean"].items():
            shares = [f"{100 * e[key]:.1f}" for key in ("gross", "replaced")]
            voxels = [three(e[key]) for key in ("rms_voxel", "bias_voxel")]
            lengths = [three(e[key], 1) for key in ("rms_mm_s", "rms_percent", "stated_mm_s")]
            rows.append((title, band, f"{e['vectors']:,}", *voxels, *lengths, *shares))
        other.append((title, *_whole(found)))
    by_depth = ("method", "abs(z)", "vectors", "RMS u / v / w, voxel", "bias, voxel", "RMS, mm/s", "RMS, % of U")
    by_depth += ("stated, mm/s", "gross %", "replaced %")
    whole = ("method", "window, mm", "particles in it", "candidates %", "vorticity: RMS error of RMS, 1/s")
    whole += ("RMS against the point, mm/s", "against the particles, mm/s", "within 1 std, %", "within 2 std, %")
    whole += ("wall s", "processor s", "GB")
    return f"{table(by_depth, rows)}\n\n{table(whole, other)}\n"


def _whole(found: dict[str, Any]) -> list[str]:
    """What is told once of a method."""
    everywhere = {name: e["all"] for name, e in found["errors"].items()}
    return [
        " x ".join(f"{side:.2f}" for side in found["window_mm"]),
        f"{found['particles_per_window']:.1f}",
        f"{100 * found['candidates']:.1f}",
        vorticity(found),
        three(everywhere["point"]["rms_mm_s"], 1),
        three(everywhere["particles"]["rms_mm_s"], 1),
        *(inside(everywhere["window_mean"], n) for n in (1, 2)),
        *(f"{sum(found[clock].values()):.0f}" for clock in ("wall_s", "processor_s")),
        "" if found["peak_gb"] is None else f"{found['peak_gb']:.1f}",
    ]


def main(size: str, out: Path = ROOT, isolated: bool = True, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """Announce, measure, write JSON, table and figures into ``out``. ``only``: which cases to measure anew, by default
    those that are not of today's program; the others are taken from earlier results of the same size."""
    setting, target = SIZES[size], out / "paper" / "results"
    stem = "comparison-full" if size == "full" else "comparison"
    fields, file = out / "build" / "comparison", target / f"{stem}.json"
    earlier = json.loads(file.read_text()) if file.exists() else {"size": None}
    cases = dict(earlier["cases"]) if earlier["size"] == size else {}
    today = fresh.stamp(ROOT / "paper" / "results" / f"{stem}.json")
    only = only or tuple(
        name
        for name in MEASUREMENTS
        if any(cases.get(title, {}).get("made_with") != today for title in fields_of(name))
    )
    for name, line in announced(setting, only).items():
        print(f"{TITLES[name]}: {line}", flush=True)
    target.mkdir(parents=True, exist_ok=True)
    for name in only:
        volumes = fields / f"{setting.name}-{name}-{today}.volumes"
        for title in fields_of(name):
            if cases.get(title, {}).get("made_with") == today and volumes.exists():
                continue  # measured, and then it was ended
            work = partial(case, title, setting, fields, volumes)
            told = in_a_process(work) if isolated else work()
            print(f"{TITLES[title]}: {json.dumps(told['errors']['window_mean']['all'])}", flush=True)
            cases[title] = told | {"made_with": today}
            if size == "full" and title in comparison_figures.DRAWN:
                comparison_figures.keep(fields, setting, title, target / "fields")
            file.write_text(json.dumps({"size": size, "jet_m_s": JET_M_S, "cases": cases}, indent=1) + "\n")
        volumes.unlink(missing_ok=True)
    if set(cases) == set(TITLES):
        results = json.loads(file.read_text())
        (target / f"{stem}.md").write_text(tables(results))
        missing = comparison_figures.draw(results, setting, fields, out / "docs" / "images" / "paper", stem)
        for name in missing:
            again = f"measure it again: --only {name.removesuffix('_inner')}"
            print(f"not in slices and vortices: {TITLES[name]}, whose field is not in {fields}; {again}")
    return cases


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("size", nargs="?", choices=tuple(SIZES), default="reduced")
    parser.add_argument("--only", nargs="+", choices=MEASUREMENTS, default=())
    parser.add_argument("--out", type=Path, default=ROOT, help="folder for paper/results and docs/images/paper")
    asked = parser.parse_args()
    main(asked.size, asked.out, only=tuple(asked.only))
