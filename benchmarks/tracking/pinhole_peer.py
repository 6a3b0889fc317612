"""OpenPTV on the images of pinholes.py: pinhole_peer.json.

    .venv/bin/python benchmarks/tracking/pinhole_peer.py [case ...]

OpenPTV's optv (LGPL, installed into build/peers-tracking, run as a process of its own) finds targets in images of 8
bits, matches them along epipolar lines and intersects their rays; cameras are given exactly. Of four thresholds for
targets, and with particles that three or two cameras show or without, the one of the best F-score counts, as judged by
the truth: no user has that.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from pinholes import BLACK, CAMERAS, CASES, LIMITS, SENSOR, _scored, recorded_frame
from recorded import run_cases, three, write_table

HERE = Path(__file__).parent
RECORD = HERE / "pinhole_peer.json"
ENVIRONMENT = HERE.parents[1] / "build" / "peers-tracking"
PACKAGE = "optv==0.3.2"
BRIGHT = 0.999  # quantile of the counts that is white


def python() -> Path:
    """Of an environment that holds the peer."""
    found = ENVIRONMENT / "bin" / "python"
    if not found.exists():
        subprocess.run([sys.executable, "-m", "venv", ENVIRONMENT], check=True)
    if subprocess.run([found, "-c", "import optv"], stderr=subprocess.DEVNULL).returncode:
        subprocess.run([found, "-m", "pip", "install", "--quiet", PACKAGE], check=True)
    return found


def measure(ppp: float) -> dict:
    """One density."""
    truth, counts = recorded_frame(ppp)
    above = np.stack(counts).astype(float) - BLACK
    images = np.clip(np.rint(above * 255.0 / np.quantile(above, BRIGHT)), 0, 255).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        np.savez(
            Path(folder) / "scene.npz",
            images=images,
            position=[camera.position_mm for camera in CAMERAS],
            turn=[camera.axes for camera in CAMERAS],
            focal_mm=[camera.focal_length_px * SENSOR.pixel_pitch_mm for camera in CAMERAS],
            pixel_mm=SENSOR.pixel_pitch_mm,
            limits=LIMITS,
        )
        subprocess.run([python(), HERE / "openptv_peer.py", folder], check=True)
        with np.load(Path(folder) / "found.npz") as found:
            tried = {}
            for name in found.files:
                cliques, threshold = name.rsplit("_", 1)
                if cliques == "seconds" or not len(found[name]):
                    continue
                seconds = float(found[f"seconds_{threshold}"])
                scored = _scored(truth.position_mm, found[name])
                tried[name] = scored | {"ms_per_particle": 1e3 * seconds / len(found[name])}
    best = max(tried, key=lambda name: _f_score(tried[name]))
    return {"particles": len(truth.electrons), "best": best, **tried[best]}


def _f_score(scored: dict) -> float:
    """Of what is found and what is true among what is reported, the harmonic mean."""
    found, true = scored["found"], 1.0 - scored["ghosts"]
    return 2.0 * found * true / max(found + true, 1e-9)


def page(record: dict) -> None:
    """Write the table into docs/tracking.md."""
    lines = [
        "| particles per pixel | n | found % | ghosts % | RMS x / y / z | median x / y / z | CPU ms a particle |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for case, own in record.items():
        lines.append(
            f"| {case} | {own['particles']} | {100 * own['found']:.1f} | {100 * own['ghosts']:.1f} | "
            f"{three(own['rms'])} | {three(own['median'])} | {own['ms_per_particle']:.2f} |"
        )
    write_table("pinhole peer", lines)


if __name__ == "__main__":
    run_cases(RECORD, CASES, {}, measure, page)
