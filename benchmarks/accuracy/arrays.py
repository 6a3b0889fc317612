"""What stretched and distorted arrays of microlenses cost a measurement: benchmarks/accuracy/arrays.json.

    python benchmarks/accuracy/arrays.py [NAME ...] [--pairs N] [--out DIR] [--again]

The case in air of windows.py with a regular array; with rows 0.5 % further apart; and with microlenses 2 px further off
the axis in the corner, as the cube of the distance. The experiment file knows of none of it: the white image tells.
Results: RMS and bias along x, y, z in voxels, and RMS over that of the regular array; ends with 1 where that is above
1.1 or a case is refused.
"""

from __future__ import annotations

import argparse
import json
import sys
from math import hypot
from pathlib import Path

from windows import BASE, DT_S, SPARE_MM, flow_in_air, measure

from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_recording import simulate_real_recording

RECORDED = Path(__file__).with_name("arrays.json")
SENSOR = BASE.camera().sensor
CASES = {
    "regular": {},
    "stretched": {"aspect": 0.005},
    "distorted": {"array_distortion": 2.0 / (0.5 * hypot(SENSOR.columns, SENSOR.rows))},
}
MOST = 1.1  # times the RMS of the regular array


def simulate(name, folder, pairs):
    """Make the recording of a case."""
    x, y, z = BASE.volume_mm()
    inside = (x[0] + SPARE_MM, x[1] - SPARE_MM), (y[0] + SPARE_MM, y[1] - SPARE_MM), z
    simulate_real_recording(
        folder,
        RealCamera.of(BASE.camera(), **CASES[name]),
        flow_in_air(),
        dt_s=DT_S,
        volume_mm=inside,
        pairs=pairs,
        voxel_mm=BASE.voxel_mm(),
        windows=BASE.windows,
        seed=BASE.seed,
    )


def failed(result):
    """Whether a case was refused, or measured too much worse than the regular array."""
    return "error" in result or max(result.get("rms_over_regular", [0.0])) > MOST


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CASES))
    parser.add_argument("--pairs", type=int, default=2, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("build/arrays"), metavar="DIR")
    parser.add_argument("--again", action="store_true", help="make recordings anew")
    options = parser.parse_args()
    results = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    for name in options.names or CASES:
        folder = options.out / name
        if options.again or not (folder / "experiment.toml").exists():
            simulate(name, folder, options.pairs)
        found = results[name] = measure("air", folder)
        if "rms" in found and "rms" in results.get("regular", {}):
            found["rms_over_regular"] = [a / b for a, b in zip(found["rms"], results["regular"]["rms"], strict=True)]
        RECORDED.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(name, {key: found.get(key) for key in ("error", "rms", "bias", "gross", "answered", "rms_over_regular")})
    sys.exit(1 if any(failed(results[name]) for name in options.names or CASES) else 0)


if __name__ == "__main__":
    main()
