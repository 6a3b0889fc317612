"""The small camera on which recordings are spoilt, and clean recordings of it.

800 x 640 px at PMR 14 and M = -1, rotation about y with a drift along it: 2.9, 2.9 and 0.4 voxels RMS; windows of
48 x 48 x 16 voxels, 32 particles in each.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import Velocity, flow
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import Seeding, simulate_recording

DT_S = 0.0005
CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
    0.308,
    Sensor(800, 640, 0.0055, 12, 60),
)
VOLUME_MM = ((-1.7, 1.7), (-1.3, 1.3), (-2.5, 2.5))
WINDOWS = ((64, 64, 24), (48, 48, 16))
DRIFT_M_S = 0.1
NOISE = SensorNoise()
FIRST_SEED = 5
RAYS = 4000  # of a particle; 20,000 make no other vectors
DARK_FRAMES = 32  # that a dark image is the mean of

Counts = NDArray[np.float64]


def rotation(drift_m_s: float = DRIFT_M_S) -> Velocity:
    """The flow, in m/s at points in mm."""
    return flow("rotation", rate_rad_s=80.0, drift_m_s=(0.0, drift_m_s, 0.0))


@dataclass(frozen=True)
class Clean:
    """A recording of a double-frame camera with nothing wrong: run_01_a.tif, run_01_b.tif, run_02_a.tif ..., white.tif,
    dark.tif (a mean of many), experiment.toml, which names the pairs; truth_01.npz ... hold the particles."""

    folder: Path
    pairs: int

    def truth(self, pair: int) -> tuple[Counts, Counts]:
        """Particles (n, 3) in mm in both frames of a pair, counted from 0."""
        with np.load(self.folder / f"truth_{pair + 1:02d}.npz") as particles:
            return particles["a"], particles["b"]


def dark_image(rng: np.random.Generator) -> NDArray[np.uint16]:
    """Mean of many frames without light."""
    none = np.zeros((CAMERA.sensor.rows, CAMERA.sensor.columns))
    frames = [digitise(none, CAMERA.sensor, NOISE, rng).astype(float) for _ in range(DARK_FRAMES)]
    return np.rint(np.mean(frames, axis=0)).astype(np.uint16)


def clean_recording(
    folder: Path, pairs: int, seeding: Seeding | None = None, noise: SensorNoise = NOISE, drift_m_s: float = DRIFT_M_S
) -> Clean:
    """Simulate it, or go on where that was stopped; pairs differ by their seed."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(pairs):
        if (folder / f"truth_{k + 1:02d}.npz").exists():
            continue
        one = folder / "one"
        simulate_recording(
            one,
            CAMERA,
            rotation(drift_m_s),
            dt_s=DT_S,
            volume_mm=VOLUME_MM,
            windows=WINDOWS,
            seeding=seeding,
            noise=noise,
            seed=FIRST_SEED + k,
            rays=RAYS,
            overwrite=True,
        )
        if k == 0:
            tifffile.imwrite(folder / "dark.tif", dark_image(np.random.default_rng(FIRST_SEED)))
            shutil.move(one / "white.tif", folder / "white.tif")
            text = (one / "experiment.toml").read_text()
            lines = [line for line in text.splitlines() if not line.startswith("frames")]
            lines.insert(lines.index("[recording]") + 1, 'pairs = "run_*_{a,b}.tif"')
            (folder / "experiment.toml").write_text("\n".join(lines) + "\n")
        for pulse in "ab":
            shutil.move(one / f"{pulse}.tif", folder / f"run_{k + 1:02d}_{pulse}.tif")
        shutil.move(one / "truth_particles.npz", folder / f"truth_{k + 1:02d}.npz")
        shutil.rmtree(one)
    return Clean(folder, pairs)
