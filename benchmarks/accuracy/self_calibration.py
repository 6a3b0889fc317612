"""What self-calibration by particles makes of a calibration that was spoilt: self_calibration.json.

    python benchmarks/accuracy/self_calibration.py RECORDING [--out DIR]

RECORDING: a folder with experiment.toml, images of a target, frames and truth_particles_0001.npz (particles a and b of
the first pair in the frame of the results, mm), as simulate_real_recording makes it. Copies of it are calibrated and
spoilt: views shifted by 3 um RMS (a random polynomial of degree 3 of the view, without what no particle tells), the
exit pupil 2 % farther, z = 0 by 0.1 mm; each is measured as it is and after plenopiv selfcalibrate. Folders that are
there are not measured again. Results: RMS and bias along x, y, z in voxels, and what self-calibration says.
"""

from __future__ import annotations

import argparse
import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import plenopiv
from plenopiv.accuracy import score_velocity
from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration, save_calibration
from plenopiv.run.self_calibrate import self_calibrate
from plenopiv.run.target import target_calibration

RECORDED = Path(__file__).with_name("self_calibration.json")
FILE, CORRECTED, STATED = "calibration.toml", " corrected", "self_calibration.json"
SHIFT_UM, SEED, DEGREE = 3.0, 1, 3
FARTHER, DEEPER_MM = 1.02, 0.1
SPOILT = {"right": "", "views": "v", "pupil and depth": "pd", "views, pupil and depth": "vpd"}


def views_shifted(camera):
    """A random shift of views that is no displacement of what is seen, 3 um RMS."""
    rng = np.random.default_rng(SEED)
    at = rng.uniform(-1, 1, (3000, 2))
    at = at[np.hypot(*at.T) < 1]
    u = 0.5 * camera.main_lens.aperture_mm * at
    half = 0.5 * camera.sensor.pixel_pitch_mm * camera.sensor.columns
    s = rng.uniform(-1, 1, (len(u), 2)) * half
    terms = np.stack([at[:, 0] ** p * at[:, 1] ** (n - p) for n in range(DEGREE + 1) for p in range(n + 1)], 1)
    shift = (terms @ rng.normal(size=(terms.shape[1], 2))).T.ravel()
    ones, none = np.ones(len(u)), np.zeros(len(u))
    common = np.linalg.qr(np.stack([np.r_[ones, none], np.r_[none, ones], at.T.ravel()], 1))[0]
    shift -= common @ (common.T @ shift)
    shift = shift.reshape(2, -1).T
    shift *= 1e-3 * SHIFT_UM / np.sqrt((shift**2).sum(1).mean())
    return ViewShift.fitted(u, s, shift, DEGREE)


def spoil(folder, what):
    """Spoil the calibration of a folder."""
    found, inputs = load_calibration(folder / FILE)
    model = found.model
    if "p" in what:
        model = replace(model, reference_mm=FARTHER * model.reference_mm)
    if "d" in what:
        model = replace(model, medium=replace(model.medium, fluid_mm=model.medium.fluid_mm + DEEPER_MM))
    beside = views_shifted(found.camera) if "v" in what else None
    save_calibration(replace(found, model=model, beside=beside), inputs, folder / FILE)


def measured(folder, right):
    """RMS and bias of a folder's first pair, which is measured where it is not yet. ``right``: the calibration before
    it was spoilt, for what all views see."""
    experiment = Experiment.load(folder / "experiment.toml")
    results = experiment.output_directory / "velocity.nc"
    if not results.exists():
        plenopiv.process(experiment, overwrite=True)
    with np.load(folder / "truth_particles_0001.npz") as particles:
        score = score_velocity(
            plenopiv.io.read_velocity(results),
            particles["a"],
            particles["b"],
            right.camera,
            dt_s=experiment.recording_table.dt_s,
            voxel_mm=experiment.volume.voxel_mm,
            window_voxels=experiment.correlation.windows[-1],
            space=right.space(experiment.grid().limits_mm()),
        )
    return {
        "vectors": score.vectors,
        "gross": score.final.gross,
        "rms": score.final.rms,
        "bias": score.final.bias,
        "inside_1_std": score.inside_1_std,
    }


def corrected(folder):
    """Self-calibrate a folder, once; what is said of it."""
    if not (folder / STATED).exists():
        found = self_calibrate(Experiment.load(folder / "experiment.toml"))
        said = {key: value for key, value in vars(found).items() if key not in ("file", "shift")}
        (folder / STATED).write_text(json.dumps(said | {"corrected": found.shift is not None}))
    return json.loads((folder / STATED).read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path, metavar="RECORDING")
    parser.add_argument("--out", type=Path, default=Path("build/self_calibration"), metavar="DIR")
    options = parser.parse_args()
    warnings.simplefilter("ignore", PlenoPIVWarning)
    first = options.out / "right"
    if not first.exists():
        shutil.copytree(options.recording, first)
        experiment = Experiment.load(first / "experiment.toml")
        frames = experiment.recording().names[:2]
        (first / "experiment.toml").write_text(experiment.changed(pairs=[frames]).dump_toml(first))
    experiment = Experiment.load(first / "experiment.toml")
    right = target_calibration(experiment, experiment.recording())
    results = {}
    for name, what in SPOILT.items():
        folder = options.out / name
        if not folder.exists():
            shutil.copytree(first, folder, ignore=shutil.ignore_patterns("results*"))
            spoil(folder, what)
        results[name] = measured(folder, right)
        again = options.out / (name + CORRECTED)
        if not again.exists():
            shutil.copytree(folder, again, ignore=shutil.ignore_patterns("results*"))
        said = corrected(again)
        results[name + CORRECTED] = measured(again, right) | {"self_calibration": said}
        for key in (name, name + CORRECTED):
            print(key, results[key], flush=True)
        RECORDED.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
