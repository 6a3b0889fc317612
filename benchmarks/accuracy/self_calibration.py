"""What self-calibration by particles makes of a calibration that was spoilt: self_calibration.json.

    python benchmarks/accuracy/self_calibration.py [RECORDING] [--out DIR]

RECORDING: a folder with experiment.toml, images of a target, frames and truth_particles.npz or
truth_particles_0001.npz (particles a and b of the first pair in the frame of the results, mm); without it one of a tank
is simulated, with stop, rim, distortion and a tilted sensor. Copies of it are calibrated and spoilt: views shifted by
3 um RMS (a random polynomial of degree 3 of the view, without what no particle tells), the exit pupil 2 % farther,
z = 0 by 0.1 mm; each is measured as it is and after plenopiv selfcalibrate. Folders that are there are not measured
again. Results: RMS and bias along x, y, z in voxels, and what self-calibration says; "as_placed" those against the
particles where the calibration of the folder puts them, displaced and stretched as it has them: that no particle tells,
and what is left besides is what could be told.
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
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.space_map import ViewShift
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.calibration_file import load_calibration, save_calibration
from plenopiv.lattice import Lattice
from plenopiv.run.self_calibrate import self_calibrate
from plenopiv.run.target import target_calibration
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import Shear
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_recording import Extras, TargetPlanes, simulate_real_recording
from plenopiv.simulation.targets import DotTarget

RECORDED = Path(__file__).with_name("self_calibration.json")
FILE, CORRECTED, STATED = "calibration.toml", " corrected", "self_calibration.json"
SHIFT_UM, SEED, DEGREE = 3.0, 1, 3
FARTHER, DEEPER_MM = 1.02, 0.1
TRUE = PlenopticCamera(
    MainLens(50.0, 22.0, -1.0), Lattice("hexagonal", 0.077, 0.004, (0.012, -0.018)), 0.308,
    Sensor(1200, 960, 0.0055, 12, 60),
)  # fmt: skip
CAMERA = RealCamera.of(
    TRUE, stop_mm=12.0, distortion=0.006, gap_tilt=0.006, gap_tilt_direction_deg=20.0,
    medium=Medium(1.333, 60.0, 8.0, 1.52), pose=Pose(0.4, (0.05, -0.04, 0.2), (0.2, -0.1)),
)  # fmt: skip
SHEET = PlenopticCamera(MainLens(50.6, 22.4, -0.985), Lattice("hexagonal", 0.077), 0.3083, TRUE.sensor)  # as delivered
FLOW = Shear(45.0, "x", "z", (0.05, -0.06, 0.15))
VOLUME_MM = (-2.4, 2.4), (-1.9, 1.9), (-5.0, 5.0)
TARGET = TargetPlanes(DotTarget(0.6, 0.2, 0.36, 0.28), (-5.6, -4.2, -2.8, -1.4, 0.0, 1.4, 2.8, 4.2, 5.6))
SPOILT = {"right": "", "views": "v", "pupil and depth": "pd", "views, pupil and depth": "vpd"}


def simulate(folder):
    """The recording that is made where none is given."""
    simulate_real_recording(
        folder, CAMERA, FLOW, dt_s=5e-4, volume_mm=VOLUME_MM, sheet=SHEET, extras=Extras(TARGET, dark=True), seed=8
    )


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
    limits = experiment.grid().limits_mm()
    settings = {
        "dt_s": experiment.recording_table.dt_s,
        "voxel_mm": experiment.volume.voxel_mm,
        "window_voxels": experiment.correlation.windows[-1],
    }
    with np.load(next(folder.glob("truth_particles*.npz"))) as particles:
        true = particles["a"], particles["b"]
    true_space, space = right.space(limits), load_calibration(folder / FILE)[0].space(limits)
    placed = [space.to_laboratory(true_space.to_lens(at)) for at in true]
    velocity = plenopiv.io.read_velocity(results)
    score = score_velocity(velocity, *true, right.camera, **settings, space=true_space)
    as_placed = score_velocity(velocity, *placed, right.camera, **settings, space=space)
    return {
        "vectors": score.vectors,
        "gross": score.final.gross,
        "rms": score.final.rms,
        "bias": score.final.bias,
        "inside_1_std": score.inside_1_std,
        "as_placed": {"vectors": as_placed.vectors, "rms": as_placed.final.rms, "bias": as_placed.final.bias},
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
    parser.add_argument("recording", type=Path, nargs="?", metavar="RECORDING")
    parser.add_argument("--out", type=Path, default=Path("build/self_calibration"), metavar="DIR")
    options = parser.parse_args()
    warnings.simplefilter("ignore", PlenoPIVWarning)
    first = options.out / "right"
    if not first.exists():
        if options.recording is None:
            simulate(first)
        else:
            shutil.copytree(options.recording, first)
        experiment = Experiment.load(first / "experiment.toml")
        frames = experiment.recording().names[:2]
        (first / "experiment.toml").write_text(experiment.changed(frames=None, pairs=[frames]).dump_toml(first))
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
