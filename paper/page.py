"""Write the tables of docs/paper.md, and the jet's of docs/uncertainty.md, from paper/results:  page.py

Only what stands between two marks, <!-- name: begin --> and <!-- name: end -->, is replaced.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any

import comparison_tables
from outputs import table, three

ROOT = Path(__file__).parents[1]
DOCS, RESULTS = ROOT / "docs", ROOT / "paper" / "results"
CAMERAS = ("pmr8", "pmr14", "pmr28")


def slashed(values: Iterable[float], digits: int = 3) -> str:
    """Several numbers in one cell, to so many digits."""
    return " / ".join(f"{float(f'{v:.{digits}g}'):,g}" for v in values)


def results(name: str) -> Any:
    """What a script has written."""
    return json.loads((RESULTS / f"{name}.json").read_text())


def resolution() -> str:
    """Free shifts and blocks by depth, of the three cameras."""
    found = results("resolution")
    rows = []
    for k, band in enumerate(found["pmr14"]["free_shift_by_depth"]):
        shifts = [found[name]["free_shift_by_depth"][k] for name in CAMERAS]
        areas = [found[name]["blocks_by_depth"][k]["area_um2"] for name in CAMERAS]
        rows.append(
            (
                f"{band['from_mm']:g} to {band['to_mm']:g}",
                slashed(s["y_mean_um"] for s in shifts),
                slashed(s["z_mean_um"] for s in shifts),
                slashed(areas),
            )
        )
    return table(("abs(z), mm", "free shift along y, um", "along z, um", "area of a block, um^2"), rows)


def normalisation() -> str:
    """Weights of planes, Q and errors."""
    from normalisation import TITLES

    rows = []
    for name, found in results("normalisation")["weights"].items():
        errors = three(found["rms"])
        rows.append((TITLES[name], f"{found['q']:.3f}", errors, f"{100 * found['gross']:.1f}"))
    return table(("planes", "Q", "RMS x / y / z (voxel)", "gross %"), rows)


METHODS = {
    "mart": "MART",
    "bound": "DRT-MART",
    "product": "DRT-MART, the paper's product",
    "strict": "DRT-MART, threshold of high density",
}
SERIES = {"axis": "on the axis, no noise", "spread": "over a microlens, no noise", "noisy": "over a microlens, noise"}


def single_particles() -> str:
    """Centres and Q of lone particles outside the dead zone."""
    found = {(row["series"], row["method"]): row for row in results("single_particles")["summary"]}
    rows = []
    for (series, said), (method, name) in product(SERIES.items(), METHODS.items()):
        row = found[series, method]
        mean, largest = row["dz_near_um"]
        q = row["q"]
        least = row.get("least_gain", {}).get("gauss")
        worst = "" if least is None else f"{least[0]:+.3f} at {least[1]:+.2f} mm"
        cells = name, f"{mean:.1f} / {largest:.0f}", f"{q['gauss']:.3f}", f"{q['point']:.3f}", f"{q['wide']:.3f}", worst
        rows.append((said if method == "mart" else "", *cells))
    head = (
        "",
        "",
        "z error, um, mean / largest",
        "Q, Gaussian of 3 voxels",
        "Q, point",
        "Q, 51 x 51 x 231 um",
        "smallest difference to MART",
    )
    return table(head, rows)


def time_and_density() -> str:
    """Time, voxels kept and Q of both methods against density."""
    found = {(row["ppm"], row["thin"] > 0, row["method"]): row for row in results("time_and_density")["rows"]}
    rows = []
    for ppm in sorted({ppm for ppm, *_ in found}):
        plain, shipped = ({m: found[ppm, thin, m] for m in ("mart", "bound", "product")} for thin in (False, True))
        rows.append(
            (
                f"{ppm:g}",
                " / ".join(f"{100 * plain[m]['kept']:.3g}" for m in ("bound", "product")),
                three(plain[m]["q"] for m in ("mart", "bound", "product")),
                three((plain[m]["seconds"] for m in ("mart", "bound", "product")), 1),
                f"{plain['mart']['seconds'] / plain['bound']['seconds']:.1f}",
                f"{shipped['mart']['seconds'] / shipped['bound']['seconds']:.1f}",
                f"{plain['mart']['seconds'] / shipped['bound']['seconds']:.1f}",
            )
        )
    head = (
        "ppm", "candidates, %, bound / product", "Q, MART / bound / product", "s",
        "MART over DRT-MART, no thinning", "thinning in both", "thinning in DRT-MART only",
    )  # fmt: skip
    return table(head, rows)


def needed_tracks() -> str:
    """Errors of a window's mean from perfect tracks, by density."""
    rows = []
    for line in results("needed")["tracks"]:
        errors = (three(line[key]) for key in ("mean", "linear_fit", "smooth_field"))
        rows.append((f"{line['particles_per_microlens']:g}", f"{line['particles_per_window']:.0f}", *errors))
    return table(("ppm", "tracks in a window", "their mean", "their linear fit", "smoothest field"), rows)


def needed_windows() -> str:
    """What sub-windows of the paper's windows find."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in results("needed")["windows"]:
        window = "none" if line["inner_window"] is None else " x ".join(map(str, line["inner_window"]))
        found.setdefault((window, f"{100 * line['overlap']:.0f} %"), {})[line["volumes"]] = line
    rows = []
    for (window, overlap), lines in found.items():
        light = lines["light_field"]
        bands = [lines["exact"]["bands"]["within"], *(light["bands"][band] for band in ("within", "within, smooth"))]
        errors = (three(band["rms_voxel"]) for band in (*bands, light["bands"]["beyond"]))
        inside = (comparison_tables.inside(bands[1], n) for n in (1, 2))
        cost = f"{light['correlation_s']:.0f}"
        rows.append((window if window == "none" else f"{window}, {overlap}", *errors, ", ".join(inside), cost))
    head = ("sub-windows, overlap", "exact volumes", "LF-PIV", "LF-PIV, smooth flow", "LF-PIV beyond 6 mm")
    return table((*head, "within 1, 2 std, %", "processor s"), rows)


def needed_beyond() -> str:
    """LF-PIV far from focus, by density and lit depth."""
    rows = []
    for line in results("needed")["beyond"]:
        (low, high), inner = line["z_mm"], line["inner_window"]
        bands = (line["bands"].get(band) for band in ("4-6 mm", "6-8 mm", "8-10 mm"))
        errors = ("" if band is None else three(band["rms_voxel"]) for band in bands)
        window = "none" if inner is None else " x ".join(map(str, inner))
        rows.append((f"{line['particles_per_microlens']:g}", f"{low:g} to {high:g}", window, *errors))
    return table(("ppm", "illuminated, z in mm", "sub-windows", "4 to 6 mm", "6 to 8 mm", "8 to 10 mm"), rows)


def jet_coverage() -> str:
    """How often errors of LF-PIV in the jet are within their error bars."""
    of = {"of the jet's cut": "comparison", "of all of the paper's volume": "comparison-full"}
    return comparison_tables.coverage(
        {words: results(name)["cases"]["light_field_inner"] for words, name in of.items()}
    )


def comparison_full() -> str:
    """LF-PIV in all of the paper's volume."""
    return comparison_tables.in_voxels(results("comparison-full")["cases"], ("light_field", "light_field_inner"))


def ghosts() -> str:
    """Matched Tomo-PIV about the jet's middle, with its ghosts and without."""
    rows = []
    for line in results("ghosts")["cases"]:
        cells = [" x ".join(f"{side:g}" for side in line["lit_mm"]), f"{100 * line['light_of_ghosts']:.0f}"]
        for found in (line["as_it_is"], line["without_ghosts"]):
            cells += [f"{100 * found['gross']:.0f}", three(found["rms_mm_s"], 0)]
        rows.append(cells)
    head = ("illuminated, mm", "ghost light, %", "gross %", "RMS, mm/s")
    return table((*head, "without ghosts: gross %", "RMS, mm/s"), rows)


def fill(text: str, name: str, content: str) -> str:
    """The text with ``content`` between the marks of ``name``."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    assert begin in text, name
    assert end in text, name
    return re.sub(f"{begin}.*?{end}", lambda _: f"{begin}\n{content}\n{end}", text, flags=re.DOTALL)


def gain_in_quality() -> str:
    """Q of MART and DRT-MART by iterations, relaxation and equations."""
    rows = [
        (row["way"], f"{row['mart']:.3f}", f"{row['drt']:.3f}", " to ".join(f"{gain:+.3f}" for gain in row["gain"]))
        for row in results("gain_in_quality")["ways"]
    ]
    return table(("MART", "Q", "Q, DRT-MART", "gain, by depth"), rows)


TABLES = {
    "resolution": resolution,
    "single particles": single_particles,
    "gain in quality": gain_in_quality,
    "time and density": time_and_density,
    "normalisation": normalisation,
    "comparison windows": lambda: comparison_tables.by_depth(results("comparison")["cases"], comparison_tables.WINDOWS),
    "comparison inner": lambda: comparison_tables.by_depth(results("comparison")["cases"], comparison_tables.INNER),
    "comparison full": comparison_full,
    "comparison full methods": lambda: comparison_tables.by_method(results("comparison-full")["cases"]),
    "ghosts": ghosts,
    "comparison once": lambda: comparison_tables.once(results("comparison")["cases"]),
    "comparison two": lambda: comparison_tables.two_cameras(results("comparison")["cases"]),
    "needed tracks": needed_tracks,
    "needed windows": needed_windows,
    "needed beyond": needed_beyond,
}


PAGES = {"paper.md": TABLES, "uncertainty.md": {"jet": jet_coverage}}


def main() -> None:
    """Write all tables whose numbers are there."""
    for page, tables in PAGES.items():
        text = (DOCS / page).read_text()
        for name, make in tables.items():
            text = fill(text, name, make())
        (DOCS / page).write_text(text)


if __name__ == "__main__":
    main()
