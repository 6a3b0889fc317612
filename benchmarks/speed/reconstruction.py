"""MART without candidates at Fahringer's size, and against DRT-MART on the paper's small camera:  reconstruction.py

Each measurement runs in a process of its own, which first does the same on a small volume, so that nothing is compiled
in the time that counts, and is the least of three or more that take ten seconds together: others share the machine, and
the least of many short times is to be as sure as that of few long ones. Writes reconstruction.json beside this file and
prints two tables.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from scene import DEPTH_MM, FAHRINGER, LATERAL_MM, Scene, small_camera

from plenopiv.reconstruction import reconstruct as chain
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings

ROUNDS = 5
REPEATS, TOGETHER_S = 3, 10.0  # at least
DENSITIES = (1.0, 2.0, 3.0, 4.0)  # particles per microlens
WARM_UP = Scene((40, 40, 40), (LATERAL_MM, LATERAL_MM, DEPTH_MM))


def peak_gb() -> float:
    """Of this process alone: getrusage also counts what its parent had taken."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6


def measured(scene: Scene, method: str, thin: float) -> dict[str, float]:
    """Seconds, and GB that the process took, for one frame from its light field; the least of several."""
    settings = ReconstructionSettings(method=method, iterations=ROUNDS)  # type: ignore[arg-type]
    chain.THIN = thin
    reconstruct(WARM_UP.lightfield.values, WARM_UP.projector, settings)
    lightfield, projector = scene.lightfield, scene.projector
    taken = []
    while len(taken) < REPEATS or sum(taken) < TOGETHER_S:
        begin = time.perf_counter()
        found = reconstruct(lightfield.values, projector, settings)
        taken.append(time.perf_counter() - begin)
    return {
        "seconds": min(taken),
        "gb": peak_gb(),
        "start": found.candidates,
        "kept": found.volume.occupancy,
        "residual": found.residuals[-1],
    }


def alone(*arguments) -> dict[str, float]:
    """``measured`` in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measured, *arguments).result()


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--densities", type=float, nargs="*", default=DENSITIES)
    asked = parser.parse_args()
    rows = []
    fahringer = alone(FAHRINGER, "mart", chain.THIN)
    print(f"300 x 200 x 200 voxels, {ROUNDS} iterations: {fahringer['seconds']:.1f} s, {fahringer['gb']:.2f} GB")
    print(
        "\n| per microlens | thinning | MART, s | DRT-MART, s | ratio | MART, M voxels x iterations / s "
        "| candidates, % |"
    )
    print("|---|---|---:|---:|---:|---:|---:|")
    for ppm in asked.densities:
        for thin in (chain.THIN, 0.0):
            both = {m: alone(small_camera(ppm), m, thin) for m in ("mart", "drt-mart")}
            mart, drt = both["mart"], both["drt-mart"]
            rate = 385 * 385 * 57 * mart["start"] * ROUNDS / mart["seconds"] / 1e6
            rows.append({"ppm": ppm, "thin": thin, "rate": rate} | both)
            print(
                f"| {ppm:g} | {'yes' if thin else 'no'} | {mart['seconds']:.1f} | {drt['seconds']:.1f} "
                f"| {mart['seconds'] / drt['seconds']:.1f} | {rate:.2f} | {100 * drt['start']:.1f} |",
                flush=True,
            )
    out = Path(__file__).with_suffix(".json")
    out.write_text(json.dumps({"rounds": ROUNDS, "fahringer": fahringer, "densities": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
