"""What a main lens that is not sharp costs a measurement, with and without its blur in the weights: unsharp_lens.json.

    python benchmarks/accuracy/unsharp_lens.py [--blurs UM ...] [--ways WAY ...] [--out DIR] [--again] [--iterations N]

The camera of small_recording.py with 1400 x 1120 px, 8 mm deep, 1 particle per microlens, rotation about y with a
drift. Each recording is measured with main_lens.blur_mm = 0 ("sharp") and "auto", and, where asked for, "auto" with
reconstruction.motion_tracking = 1 ("both frames"). Results: the blur found, um, RMS and bias along x, y, z in voxels,
and the shares within one and two stated standard deviations.
"""

from __future__ import annotations

import argparse
import json
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path

from small_recording import CAMERA, DT_S, NOISE, rotation
from true_particles import scored

import plenopiv
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.sensor import Sensor
from plenopiv.simulation.simulated_recording import simulate_recording

RECORDED = Path(__file__).with_name("unsharp_lens.json")
WIDE = replace(CAMERA, sensor=Sensor(1400, 1120, 0.0055, 12, 60))
VOLUME_MM = ((-2.6, 2.6), (-2.0, 2.0), (-4.0, 4.0))
WINDOWS = ((96, 96, 32), (64, 64, 16))
RAYS = 200_000  # of a particle: blur sends each of them astray at random, so that few make noise of their own
BLURS_UM = (0, 10, 20, 40)
WAYS = {"sharp": (0.0, 0), "auto": ("auto", 0), "both frames": ("auto", 1)}  # blur_mm, motion_tracking


def simulate(blur_um, folder, seed):
    """Make the recording of a blur; its file does not state it."""
    simulate_recording(
        folder,
        replace(WIDE, blur_mm=1e-3 * blur_um),
        rotation(),
        dt_s=DT_S,
        volume_mm=VOLUME_MM,
        windows=WINDOWS,
        noise=NOISE,
        rays=RAYS,
        seed=seed,
        overwrite=True,
    )


def measure(folder, blur_mm, motion_tracking, iterations):
    """Run a recording with ``blur_mm`` of the main lens and so much ``motion_tracking``, and score it."""
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["camera"]["main_lens"]["blur_mm"] = blur_mm
    tables["reconstruction"] |= {"iterations": iterations, "motion_tracking": motion_tracking}
    experiment = Experiment.from_dict(tables, folder / "experiment.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        result = plenopiv.process(experiment, overwrite=True)
    score = scored(result.velocity, experiment)
    calibration = result.summary["calibration"]
    return {
        "found_um": 1e3 * calibration["blur_mm"] if blur_mm == "auto" else None,
        "findings": [finding["name"] for finding in result.summary["findings"]],
        "vectors": score.vectors,
        "gross": score.final.gross,
        "rms": score.final.rms,
        "bias": score.final.bias,
        "inside_1_std": score.inside_1_std,
        "inside_2_std": score.inside_2_std,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blurs", nargs="*", type=int, default=BLURS_UM, metavar="UM")
    parser.add_argument(
        "--ways", nargs="*", choices=WAYS, default=("sharp", "auto"), metavar="WAY", help=", ".join(WAYS)
    )
    parser.add_argument("--out", type=Path, default=Path("build/unsharp_lens"), metavar="DIR")
    parser.add_argument("--again", action="store_true", help="make recordings anew")
    parser.add_argument("--iterations", type=int, default=5, metavar="N")
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    results = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    for blur_um in options.blurs:
        folder = options.out / f"{blur_um}_um_{options.seed}"
        if options.again or not (folder / "experiment.toml").exists():
            simulate(blur_um, folder, options.seed)
        for way in options.ways:
            found = results[f"{blur_um} um, {way}"] = measure(folder, *WAYS[way], options.iterations)
            RECORDED.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
            print(f"{blur_um} um, {way}", found, flush=True)


if __name__ == "__main__":
    main()
