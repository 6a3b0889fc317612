"""Sequences: particles carried by a flow, frames equally spaced in time, and the box that is lit."""

import json

import numpy as np
import pytest
import tifffile

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.sensor_noise import SensorNoise
from plenopiv.simulation.sequence import carried, simulate_sequence
from plenopiv.simulation.simulated_recording import Seeding

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(140, 120, 0.0055, 12, 60)
)
VOLUME = ((-0.2, 0.2), (-0.2, 0.2), (-0.8, 0.8))


@pytest.mark.parametrize("frames", [2, 5, 8])
def test_particles_turn_with_the_flow(frames):
    """Rotation about y: all frames at their times, the middle of the sequence being where particles were given."""
    rate, dt_s = 40.0, 1e-3
    middle = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    found = carried(Particles(middle, np.ones(20)), flow("rotation", rate_rad_s=rate), dt_s, frames)
    assert len(found) == frames
    for k, frame in enumerate(found):
        turn = rate * dt_s * (k - 0.5 * (frames - 1))
        x, y, z = middle.T
        exact = np.stack([x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)], -1)
        assert frame.position_mm == pytest.approx(exact, abs=1e-9)


def test_the_folder_is_a_sequence_and_dark_particles_leave_no_light(tmp_path):
    """A particle that leaves the lit box in the second of three frames, by its light in each."""
    at = np.array([[0.15, 0.0, 0.5]])
    moving = tuple(Particles(at + k * np.array([0.04, 0.0, 0.0]), np.array([1e5])) for k in range(3))
    still = SensorNoise(read_noise_electrons=0.0, shot=False)
    made = simulate_sequence(
        tmp_path / "r", CAMERA, flow("uniform", velocity_m_s=(0.04, 0.0, 0.0)), 3, dt_s=1e-3, volume_mm=VOLUME,
        seeding=Seeding(background_electrons=0.0), particles=moving, lit_mm=VOLUME, noise=still,
        windows=((16, 16, 16),), rays=500,
    )  # fmt: skip
    light = [
        tifffile.imread(tmp_path / "r" / f"frame-{k:03d}.tif").astype(float).sum() - 60 * 140 * 120 for k in range(3)
    ]
    assert light[0] > 1e4
    assert light[1] == pytest.approx(light[0], rel=0.02)
    assert light[2] == 0
    recording = Experiment.load(made.directory / "experiment.toml").recording()
    assert recording.is_sequence
    assert len(recording) == 3
    with np.load(tmp_path / "r" / "truth_particles.npz") as truth:
        assert truth["position_mm"] == pytest.approx(np.stack([frame.position_mm for frame in moving]))
    assert json.loads((tmp_path / "r" / "truth.json").read_text())["frames"] == 3


def test_fewer_frames_leave_none_of_those_before(tmp_path):
    def made(frames: int, folder: str = "r", **options):
        still = tuple(Particles(np.zeros((1, 3)), np.array([1e4])) for _ in range(frames))
        simulate_sequence(
            tmp_path / folder, CAMERA, flow("uniform"), frames, dt_s=1e-3, volume_mm=VOLUME, particles=still,
            windows=((16, 16, 16),), rays=10, **options,
        )  # fmt: skip
        return Experiment.load(tmp_path / folder / "experiment.toml").recording()

    assert len(made(4)) == 4
    (tmp_path / "r" / "mine.tif").touch()
    assert len(made(3, overwrite=True)) == 3
    assert (tmp_path / "r" / "mine.tif").exists()
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "frame-001.tif").write_text("taken in the laboratory")
    with pytest.raises(PlenoPIVError, match=r"frame-001\.tif: is there; choose another folder, or pass --overwrite"):
        made(3, "raw")
    assert (tmp_path / "raw" / "frame-001.tif").read_text() == "taken in the laboratory"


def test_one_frame_is_no_sequence(tmp_path):
    with pytest.raises(PlenoPIVError, match="1 frame in a sequence, give at least two"):
        simulate_sequence(tmp_path / "r", CAMERA, flow("uniform"), 1, dt_s=1e-3, volume_mm=VOLUME)
