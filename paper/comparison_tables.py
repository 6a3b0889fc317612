"""Tables of docs/paper.md from results/comparison.json: errors by depth, and what is told once of a method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from outputs import table, three

BANDS = {
    "0-2 mm": "0 to 2 mm",
    "2-4 mm": "2 to 4 mm",
    "4-6 mm": "4 to 6 mm",
    "6-8 mm": "6 to 8 mm",
    "8-10 mm": "8 to 10 mm",
    "within": "**to 6 mm**",
    "within, smooth": "to 6 mm, smooth flow",
    "beyond": "beyond 6 mm",
}
TITLES = {
    "light_field": "LF-PIV",
    "exact": "exact volumes",
    "tomo": "Tomo-PIV, the paper's",
    "matched": "Tomo-PIV, matched",
    "two": "LF-PIV, two cameras",
}
WINDOWS = "light_field", "exact", "tomo", "matched"  # without sub-window averaging
INNER = "light_field_inner", "exact_inner", "matched_inner"


def title(name: str) -> str:
    """A method with its windows."""
    own = TITLES[name.removesuffix("_inner")]
    return f"{own}, sub-windows" if name.endswith("_inner") else own


def by_depth(cases: dict[str, Any], names: Sequence[str]) -> str:
    """RMS errors against the window mean: voxels of the first method, then mm/s of all."""
    found = {name: cases[name]["errors"]["window_mean"] for name in names}
    rows = []
    for band, words in BANDS.items():
        own = three(found[names[0]][band]["rms_voxel"])
        cells = [own, *(three(found[name][band]["rms_mm_s"], 1) for name in names)]
        rows.append((words, *(f"**{c}**" for c in cells)) if words.startswith("*") else (words, *cells))
    own, *_ = heads = [title(name).removesuffix(", sub-windows") for name in names]
    return table(("abs(z)", f"{own}, voxel", *heads), rows)


DEPTHS = {
    "within": "to 6 mm",
    "within, smooth": "to 6 mm, smooth flow",
    "beyond": "beyond 6 mm",
    "all": "all depths",
}


def two_cameras(cases: dict[str, Any]) -> str:
    """RMS errors against the window mean, mm/s, with sub-windows and without, of one camera, two, and Tomo-PIV."""
    rows = []
    for band, words in DEPTHS.items():
        cells = []
        for name in ("light_field", "two", "matched"):
            whole, inner = (cases[name + end]["errors"]["window_mean"][band]["rms_mm_s"] for end in ("", "_inner"))
            cells.append(f"{three(inner, 1)} ({three(whole, 1)})")
        rows.append((words, *cells))
    return table(("abs(z)", "one camera", "two cameras", "Tomo-PIV, matched"), rows)


def coverage(cases: dict[str, dict[str, Any]]) -> str:
    """Errors within one and two standard deviations, sub-windows, of the light-field cases ``cases`` by their words."""
    rows = []
    for words, case in cases.items():
        bands = (case["errors"]["window_mean"][band] for band in ("within", "within, smooth", "beyond"))
        rows.append((words, *(f"{inside(band, 1)}, {inside(band, 2)}" for band in bands)))
    return table(("within 1, 2 std (%), x / y / z", "to 6 mm", "to 6 mm, smooth flow", "beyond 6 mm"), rows)


def in_voxels(cases: dict[str, Any], names: Sequence[str]) -> str:
    """RMS errors against the window mean, voxels, and gross vectors."""
    found = [cases[name]["errors"]["window_mean"] for name in names]
    rows = []
    for band, words in BANDS.items():
        cells = [str(found[0][band]["vectors"])]
        for errors in found:
            cells += [three(errors[band]["rms_voxel"]), f"{100 * errors[band]['gross']:.2f}"]
        rows.append((words, *cells))
    return table(("abs(z)", "vectors", *(head for name in names for head in (title(name), "gross %"))), rows)


def once(cases: dict[str, Any], names: Sequence[str] = (*WINDOWS, *INNER)) -> str:
    """What is told once of each method, one row each."""
    lines: dict[str, Callable[[dict[str, Any]], str]] = {
        "vectors evaluated": lambda c: str(c["vectors"]),
        "to 6 mm: gross / replaced, %": lambda c: " / ".join(
            f"{100 * c['errors']['window_mean']['within'][key]:.1f}" for key in ("gross", "replaced")
        ),
        "RMS, all depths, mm/s": lambda c: three(c["errors"]["window_mean"]["all"]["rms_mm_s"], 1),
        "against the DNS at the vector": lambda c: three(c["errors"]["point"]["all"]["rms_mm_s"], 1),
        "against the window's particles": lambda c: three(c["errors"]["particles"]["all"]["rms_mm_s"], 1),
        "stated to 6 mm, mm/s": lambda c: three(c["errors"]["window_mean"]["within"]["stated_mm_s"], 1),
        "errors within 1 std, %": lambda c: inside(c["errors"]["window_mean"]["all"], 1),
        "errors within 2 std, %": lambda c: inside(c["errors"]["window_mean"]["all"], 2),
        "vorticity, RMS error of the RMS in its windows, 1/s": vorticity,
        "processor time, s; memory, GB": lambda c: f"{sum(c['processor_s'].values()):.0f}; {c['peak_gb']:.1f}",
    }
    rows = [(words, *(line(cases[name]) for name in names)) for words, line in lines.items()]
    return table(("", *map(title, names)), rows)


def by_method(cases: dict[str, Any]) -> str:
    """RMS errors against the window mean in mm/s, a row for each method and its windows, and what it takes."""
    rows = []
    for name, case in ((name, cases[name]) for own in TITLES for name in (own, f"{own}_inner") if name in cases):
        errors = (three(case["errors"]["window_mean"][band]["rms_mm_s"], 1) for band in DEPTHS)
        minutes = f"{sum(case['processor_s'].values()) / 60:.0f}; {case['peak_gb']:.1f}"
        rows.append((title(name), str(case["vectors"]), *errors, vorticity(case), minutes))
    return table(("", "vectors", *DEPTHS.values(), "vorticity, 1/s", "processor min; GB"), rows)


def inside(errors: dict[str, Any], stds: int) -> str:
    """Share of the errors within so many standard deviations, %."""
    return three([100 * v for v in errors[f"inside_{stds}_std"]], 0)


def vorticity(case: dict[str, Any]) -> str:
    """RMS error of the RMS of the DNS in the windows, 1/s; nothing where no vector has all its neighbours."""
    spin = case["vorticity"]
    return f"{spin['rms_1_s']:.0f} of {spin['true_rms_1_s']:.0f}" if spin["vectors"] else ""
