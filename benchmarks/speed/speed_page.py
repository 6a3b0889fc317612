"""Write what was measured into docs/speed.md:  speed_page.py

Reads the .json files beside this one, and results.json of benchmarks/correlation. Only what stands between the two
marks is replaced.
"""

from __future__ import annotations

import json
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "speed.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def machine() -> str:
    """What it was measured on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    packages = ", ".join(f"{name} {version(name)}" for name in ("numba", "numpy", "scipy"))
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}, {packages}."


def table(header: str, rows: list[list[str]]) -> str:
    """A Markdown table whose columns after the first are figures."""
    columns = header.count("|") + 1
    return "\n".join([f"| {header} |", "|---|" + "---:|" * (columns - 1), *(f"| {' | '.join(row)} |" for row in rows)])


def reconstruction(found: dict[str, Any]) -> str:
    """Fahringer's size, and MART over DRT-MART."""
    whole, rows = found["fahringer"], []
    for r in found["densities"]:
        mart, drt = r["mart"], r["drt-mart"]
        rows.append(
            [
                f"{r['ppm']:g} per microlens, {'thinned' if r['thin'] else 'not thinned'}",
                f"{mart['seconds']:.1f}",
                f"{drt['seconds']:.1f}",
                f"{mart['seconds'] / drt['seconds']:.1f}",
                f"{r['rate']:.2f}",
                f"{100 * drt['start']:.1f}",
            ]
        )
    return (
        f"300 x 200 x 200 voxels, all of them candidates, {found['rounds']} iterations, 1 particle per microlens: "
        f"{whole['seconds']:.1f} s and {whole['gb']:.2f} GB.\n\n"
        f"385 x 385 x 57 voxels, {found['rounds']} iterations:\n\n"
        + table(
            "recording | MART, s | DRT-MART, s | ratio | MART, million voxels x iterations per second | candidates, %",
            rows,
        )
    )


def limits(found: dict[str, Any]) -> str:
    """Kernels against stored indices and bare transforms."""
    rows = []
    for r in found["projections"]:
        cells = [f"{100 * r['listed']:g} % of the voxels", f"{r['pairs a voxel and view']:.1f}"]
        for ours, limit in (("forward", "scatter limit"), ("back", "gather limit")):
            cells += [f"{1e3 * r[ours] / 4:.1f}", f"{1e3 * r[limit] / 4:.1f}", f"{100 * r[limit] / r[ours]:.0f} %"]
        rows.append(cells)
    drt, c = found["ray tracing"], found["correlation"]
    header = (
        "candidates | pairs per voxel and view | forward, ms per view | limit | limit over time | back, ms | limit "
        "| limit over time"
    )
    return (
        table(header, rows)
        + f"\n\nDense ray tracing of all {drt['pairs']:.1e} pairs: {drt['drt']:.2f} s, a gather of as many pixels "
        f"{drt['gather limit']:.2f} s. A correlation pass with deformation, {c['windows']} windows: {c['pass']:.2f} s, "
        f"their bare transforms by `scipy.fft` {c['bare FFTs']:.2f} s, {c['pass'] / c['bare FFTs']:.2f} times."
    )


def peers(found: dict[str, Any]) -> str:
    """Peers that store their weights."""
    rows = []
    for r in [*found["stored weights"], found["richardson-lucy"]]:
        size = " x ".join(map(str, r["shape"]))
        for name, f in r["found"].items():
            left = "" if r is found["richardson-lucy"] else f"{f['residual']:.0f}"  # of another image
            rows.append([f"{size}: {name}", f"{f['seconds']:.2f}", f"{f['gb']:.2f}", left])
    rounds = found["rounds"]
    said = f"{rounds} iterations from an image (pyolaf one, times {rounds}), stored weights given:"
    return f"{said}\n\n" + table("voxels and method | s | GB | residual, counts RMS", rows)


def correlation(found: dict[str, Any]) -> str:
    """Vectors a CPU-second beside OpenPIV's."""
    rows = []
    for r in found["uniform_shifts"] + found["sinusoidal_shear"]:
        if "validated" in r["method"] or "agreement" in r["method"]:
            continue
        bias, rms = (" / ".join(f"{v:.3f}" for v in r["everywhere"][k]) for k in ("bias", "rms"))
        what = r["condition"]
        what = what if what.startswith("uniform") else f"shear of {what} windows' wavelength"
        rows.append([f"{what}: {r['method']}", f"{r['vectors_a_cpu_s']:.0f}", bias, rms])
    return (
        "Windows of 32 x 32 x 32 voxels that overlap by half, one thread each, no sub-windows; "
        "benchmarks/correlation/results.md has all of it.\n\n"
        + (table("volumes and method | vectors per CPU-second | bias x / y / z, voxels | RMS", rows))
    )


def start_and_threads(found: dict[str, Any]) -> str:
    """Cold start and repeats."""
    first, later = found["first"], found["later"]
    runs = [run for of_threads in later.values() for run in of_threads]
    return (
        f"The first `plenopiv demo` takes {first[0]:.0f} s, {first[1]:.0f} of them compilation; later ones "
        f"{min(run[0] for run in later['2']):.0f} s, at most {max(run[1] for run in runs):.1f} of them compilation. "
        f"{len(later['1'])} runs on one thread and {len(later['2'])} on two "
        f"{'are identical, bit for bit' if found['identical'] else 'DIFFER'}."
    )


def memory(found: dict[str, Any]) -> str:
    """Announced and taken."""
    rows = [[n, f"{v / 1e6:.1f}", f"{a:.2f}", f"{t:.2f}", f"{a / t:.2f}"] for n, (v, a, t) in found.items()]
    return table("run | voxels, millions | announced, GB | taken, GB | ratio", rows)


def scaling(found: dict[str, Any]) -> str:
    """Predicted and measured times."""
    rows = []
    for name, (voxels, frame, guess, pair, guess_pair, measured, whole) in found.items():
        cells = voxels / 1e6, frame, guess, pair, guess_pair
        rows.append([name, *(f"{cell:.1f}" for cell in cells), f"{whole / measured:.2f}"])
    header = (
        "run | voxels, millions | a frame, s | predicted | a pair, s | predicted | whole run, predicted over measured"
    )
    return f"{SPEEDS}\n\n![predicted over measured seconds](images/scaling.png)\n\n{table(header, rows)}"


SPEEDS = (
    "Runs of [Accuracy](accuracy.md) with default settings, on two cores. Measured times are multiplied with the "
    "median of the speeds that the runs found the machine to have, so that they are those of a machine of speed 1."
)
PARTS = {
    "Reconstruction": ("reconstruction", reconstruction),
    "Peers that store their weights": ("peers", peers),
    "Correlation beside OpenPIV": ("../correlation/results", correlation),
    "Kernels and their limits": ("limits", limits),
    "Start and threads": ("start_and_threads", start_and_threads),
    "Time predicted and taken": ("scaling", scaling),
    "Memory announced and taken": ("memory", memory),
}


def main() -> None:
    """Read, write."""
    parts = [machine()]
    for title, (name, write) in PARTS.items():
        file = HERE / f"{name}.json"
        if file.exists():
            parts.append(f"## {title}\n\n{write(json.loads(file.read_text()))}")
    before, mark, rest = PAGE.read_text().partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (mark and end):
        raise SystemExit(f"{PAGE} has no {BEGIN} ... {END}")
    PAGE.write_text(f"{before}{BEGIN}\n" + "\n\n".join(parts) + f"\n{END}{after}")


if __name__ == "__main__":
    main()
