"""The gallery's recordings, simulated and measured, with their reports: build/gallery, a folder for each.

    python docs/site/make_gallery.py

What is there already is kept: remove build/gallery to make it anew. A minute of one core for each recording.
"""

import json
import shutil
import sys
from pathlib import Path

import plenopiv
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_recording import simulate_real_recording

GALLERY = Path(__file__).parents[2] / "build" / "gallery"
DT_S = 5e-4
WINDOWS = ((64, 64, 24), (48, 48, 16))
LENS = MainLens(50.0, 25.0, -1.0)  # mm

RECORDINGS = {  # name: flow, lattice, sensor's columns and rows, volume in mm, pairs
    "vortex-ring": (
        flow("vortex-ring", circulation_mm2_s=600.0, radius_mm=1.2, core_radius_mm=0.7, axis="x"),
        Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
        (800, 760),
        ((-1.8, 1.8), (-1.7, 1.7), (-2.4, 2.4)),
        1,
    ),
    "vortex-in-depth": (
        flow("lamb-oseen", circulation_mm2_s=3000.0, core_radius_mm=1.2, axis="y"),
        Lattice("square", 0.077, 0.003, (0.01, 0.02)),
        (700, 560),
        ((-1.5, 1.5), (-1.1, 1.1), (-2.4, 2.4)),
        1,
    ),
    "shear-series": (
        flow("shear", rate_per_s=60.0, component="x", along="z", drift_m_s=(0.0, 0.05, 0.1)),
        Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
        (480, 400),
        ((-0.9, 0.9), (-0.7, 0.7), (-1.5, 1.5)),
        3,
    ),
}


def make(name: str) -> None:
    """Simulate and measure one recording; its folder has report.html, velocity.nc and facts.json, and appears whole."""
    velocity, lattice, (columns, rows), volume_mm, pairs = RECORDINGS[name]
    aside = GALLERY / f".{name}"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    camera = PlenopticCamera(LENS, lattice, 0.308, Sensor(columns, rows, 0.0055, bit_depth=12, black_level=60))
    simulate_real_recording(
        aside / "recording", RealCamera.of(camera), velocity, dt_s=DT_S, volume_mm=volume_mm, pairs=pairs,
        windows=WINDOWS, rays=8000, seed=1,
    )  # fmt: skip
    result = plenopiv.process(Experiment.load(aside / "recording" / "experiment.toml"))
    for file in ("report.html", "velocity.nc"):
        shutil.copy(result.directory / file, aside)
    facts = {"vectors": int(result.velocity.valid.size), "replaced_share": result.summary["replaced_share"]}
    (aside / "facts.json").write_text(json.dumps(facts))
    shutil.rmtree(aside / "recording")
    aside.rename(GALLERY / name)


def main() -> int:
    """Make what is missing."""
    for name in RECORDINGS:
        if not (GALLERY / name / "report.html").exists():
            make(name)
            print(GALLERY / name / "report.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
