"""What microlenses that have moved since the white image cost a measurement, and how well frames show it: drift.json.

    python benchmarks/accuracy/drift.py [--drifts NAME ...] [--seeds N ...] [--still] [--out DIR] [--again]

The camera of small_recording.py with 1400 x 1120 px, 8 mm deep, 1 particle per microlens, rotation about y with a
drift. Each recording is measured with recording.drift = "none" (forced, where it is refused), "auto", and "none" with a
white image of the array where it is now ("new white image"), which is the best that can be. Results: the
drift found and its error, px, at most on the sensor; RMS and bias along x, y, z in voxels. With --still, what is found
of two frames of an array that has not moved, or has moved by 0.5 px, in other light and seeding, for each of --seeds.
"""

from __future__ import annotations

import argparse
import json
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile
from small_recording import CAMERA, DT_S, NOISE, RAYS, rotation
from true_particles import scored

import plenopiv
from plenopiv.calibration import find_lattice
from plenopiv.calibration.drift import find_drift
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import seed_box
from plenopiv.simulation.sensor_noise import digitise
from plenopiv.simulation.simulated_recording import simulate_recording
from plenopiv.simulation.white import white_image

NEW = "new white image"
RECORDED = Path(__file__).with_name("drift.json")
WIDE = replace(CAMERA, sensor=Sensor(1400, 1120, 0.0055, 12, 60))
VOLUME_MM = ((-2.6, 2.6), (-2.0, 2.0), (-4.0, 4.0))
WINDOWS = ((96, 96, 32), (64, 64, 16))
DRIFTS = {
    "none": ArrayDrift(),
    "0.5 px": ArrayDrift((0.4, -0.3)),
    "0.5 px, 0.02 degrees": ArrayDrift((0.4, -0.3), 0.02),
    "2 px": ArrayDrift((-1.2, 1.6)),
    "2 px, 0.02 degrees": ArrayDrift((-1.2, 1.6), 0.02),
    "0.02 %": ArrayDrift(scale=2e-4),
}
HALF = ArrayDrift((-0.3, 0.4), 0.02)
FIELD_MM = ((-4.3, 4.3), (-3.5, 3.5), (-4.0, 4.0))


def off_px(found, true):
    """The largest error of a drift over the sensor, px."""
    rows, columns = WIDE.sensor.rows, WIDE.sensor.columns
    corners = np.array([s + 1j * t for s in (-0.5, 0, 0.5) for t in (-0.5, 0, 0.5)])
    corners = corners.real * columns + 1j * corners.imag * rows

    def moved(drift):
        by = (1 + drift.scale) * np.exp(1j * np.radians(drift.turn_deg))
        return corners * by + complex(-drift.shift_px[0], drift.shift_px[1])

    return float(np.abs(moved(found) - moved(true)).max())


def simulate(drift, folder, seed):
    """Make the recording of a drift; its file does not state it."""
    simulate_recording(
        folder,
        WIDE,
        rotation(),
        dt_s=DT_S,
        volume_mm=VOLUME_MM,
        windows=WINDOWS,
        noise=NOISE,
        rays=RAYS,
        drift=drift,
        seed=seed,
        overwrite=True,
    )


def measure(folder, way, true):
    """Run a recording with ``recording.drift = way``, or with a new white image, and score it."""
    tables = tomllib.loads((folder / "experiment.toml").read_text())
    tables["recording"]["drift"] = way
    if way == NEW:
        light = white_image(true.of(WIDE), diffraction_nm=532.0)
        tifffile.imwrite(folder / "white_now.tif", digitise(light, WIDE.sensor, NOISE, np.random.default_rng(1)))
        tables["recording"] |= {"drift": "none", "white": "white_now.tif"}
    experiment = Experiment.from_dict(tables, folder / "experiment.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlenoPIVWarning)
        result = plenopiv.process(experiment, overwrite=True, force=way == "none")
    score = scored(result.velocity, experiment)
    found = result.summary["calibration"].get("drift")
    drift = ArrayDrift(tuple(found["shift_px"]), found["turn_deg"], found["scale"]) if found else ArrayDrift()
    return {
        "found": found,
        "off_px": None if way == NEW else off_px(drift, true),
        "quality": result.summary["quality"],
        "vectors": score.vectors,
        "gross": score.final.gross,
        "rms": score.final.rms,
        "bias": score.final.bias,
    }


def lattice_of(kind, pmr=14.0):
    """The camera with another lattice."""
    pitch = pmr * 0.0055
    lens = replace(WIDE.main_lens, aperture_mm=100.0 * pitch / 0.308)
    return replace(WIDE, lattice=Lattice(kind, pitch, 0.002, (0.02, -0.01)), main_lens=lens)


STILL = {
    "as above": {},
    "fills the field": {"volume_mm": FIELD_MM},
    "20 mm deep, 0.5 per microlens": {"volume_mm": (*VOLUME_MM[:2], (-10.0, 10.0)), "per_microlens": 0.5},
    "before focus alone": {"volume_mm": (*VOLUME_MM[:2], (1.0, 4.0))},
    "one half of the field": {"volume_mm": ((-3.5, 0.5), *VOLUME_MM[1:])},
    "a tenth of the light": {"electrons": 40.0},
    "a tenth of the particles": {"per_microlens": 0.1},
    "a tenth of both": {"electrons": 40.0, "per_microlens": 0.1},
    "none on the left, all on the right": {"thinned": lambda x: np.clip(0.5 + x[:, 0] / 5.2, 0, 1)},
    "a blob of 1 mm": {"thinned": lambda x: np.exp(-((x[:, 0] - 0.6) ** 2 + (x[:, 1] + 0.4) ** 2 + x[:, 2] ** 2 / 4))},
    "main lens blurs by 20 um": {"blur_mm": 0.02},
    "square lattice": {"camera": lattice_of("square")},
    "square lattice, 15.4 px": {"camera": lattice_of("square", 15.4)},
    "eight pixels across": {"camera": lattice_of("hexagonal", 8.0)},
}


def still(
    drift, seed, *, volume_mm=VOLUME_MM, per_microlens=1.0, electrons=400.0, thinned=None, blur_mm=0.0, camera=WIDE
):
    """What two frames show of an array that has moved by ``drift``."""
    rng, level = np.random.default_rng(seed), np.float32(60)
    white = digitise(white_image(camera, diffraction_nm=532.0), camera.sensor, NOISE, rng)
    now, light = drift.of(replace(camera, blur_mm=blur_mm)), np.zeros(white.shape, np.float32)
    for k in range(2):
        seeded = seed_box(camera, volume_mm, per_microlens, rng, electrons_per_pixel=electrons, electrons_spread=0.25)
        if thinned is not None:
            kept = rng.random(len(seeded.electrons)) < thinned(seeded.position_mm)
            seeded = replace(seeded, position_mm=seeded.position_mm[kept], electrons=seeded.electrons[kept])
        image = particle_image(now, seeded, rays=1500, seed=10 * seed + k, diffraction_nm=532.0) + 4.0
        light += digitise(image, camera.sensor, NOISE, rng) - level
    calibrated = camera.with_lattice(find_lattice(white, camera).lattice)
    found = find_drift(light, white - level, calibrated)
    if found is None:
        return {"off_px": None, "moved": False}
    expected = (abs(found.shift_std_px), found.turn_std_deg, found.scale_std)
    return {
        "off_px": off_px(found.drift, drift),
        "measured_off_px": off_px(found.measured, drift),
        "moved": bool(found.drift),
        "std": expected,
        "regions": found.regions,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--drifts", nargs="*", choices=DRIFTS, default=DRIFTS, metavar="NAME", help=", ".join(DRIFTS).replace("%", "%%")
    )
    parser.add_argument(
        "--ways", nargs="*", default=("none", "auto", NEW), metavar="WAY", help=f"none, auto, {NEW}".replace("%", "%%")
    )
    parser.add_argument("--still", action="store_true", help="in other light and seeding, without measuring vectors")
    parser.add_argument("--seeds", nargs="*", type=int, default=(1, 2, 3), metavar="N", help="of --still")
    parser.add_argument("--out", type=Path, default=Path("build/drift"), metavar="DIR")
    parser.add_argument("--again", action="store_true", help="make recordings anew")
    parser.add_argument("--seed", type=int, default=5)
    options = parser.parse_args()
    results = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}

    def record(name, found):
        results[name] = found
        RECORDED.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        print(name, found, flush=True)

    if options.still:
        for name, settings in STILL.items():
            for of_drift, drift in (("still", ArrayDrift()), ("0.5 px", HALF)):
                record(f"{name}: {of_drift}", [still(drift, seed, **settings) for seed in options.seeds])
        return
    for name in options.drifts:
        folder = options.out / f"{name.replace(' ', '_').replace('%', 'percent')}_{options.seed}"
        if options.again or not (folder / "experiment.toml").exists():
            simulate(DRIFTS[name], folder, options.seed)
        for way in options.ways:
            record(f"{name}, {way}", measure(folder, way, DRIFTS[name]))


if __name__ == "__main__":
    main()
