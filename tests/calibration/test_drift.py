"""Drift of the microlenses from simulated frames, and from shifts by hand."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from plenopiv.calibration.drift import SURE, find_drift, first_guess, light_of, moved_by, similarity
from plenopiv.calibration.micro_images import Disc
from plenopiv.cameras.drift import ArrayDrift
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.experiment import Experiment
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.flows import flow
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.simulated_recording import simulate_recording
from plenopiv.simulation.white import white_image

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.004, (0.011, -0.023)),
    0.308,
    Sensor(560, 504, 0.0055, 12, 60),
)
VOLUME_MM = ((-1.0, 1.0), (-0.9, 0.9), (-1.6, 1.6))


@lru_cache(maxsize=3)
def white(camera=CAMERA):
    """Above the black level."""
    return digitise(white_image(camera), camera.sensor, SensorNoise(), np.random.default_rng(1)) - np.float32(60)


def frame(drift=None, camera=CAMERA, volume_mm=VOLUME_MM, electrons=400.0, seed=2):
    """Light of a frame, above the black level."""
    rng = np.random.default_rng(seed)
    particles = seed_box(camera, volume_mm, 1.0, rng, electrons_per_pixel=electrons)
    image = particle_image((drift or ArrayDrift()).of(camera), particles, rays=1000, seed=seed)
    return digitise(image + 4.0, camera.sensor, SensorNoise(), rng) - np.float32(60)


@pytest.mark.parametrize(
    "drift",
    [
        ArrayDrift((0.5, 0.0)),
        ArrayDrift((0.0, -0.5)),
        ArrayDrift((-1.2, 1.6), 0.05),
        ArrayDrift((3.0, 4.0), -0.05),
        ArrayDrift(turn_deg=0.1),
        ArrayDrift(scale=2e-3),
        ArrayDrift(scale=-2e-3),
    ],
)
def test_a_drift_is_found_along_each_axis_and_no_other_beside_it(drift):
    found = find_drift(frame(drift), white(), CAMERA)
    np.testing.assert_allclose(found.measured.shift_px, drift.shift_px, atol=0.04)
    assert found.measured.turn_deg == pytest.approx(drift.turn_deg, abs=0.02)
    assert found.measured.scale == pytest.approx(drift.scale, abs=3e-4)
    assert found.drift
    assert bool(found.drift.turn_deg) == bool(drift.turn_deg)
    assert bool(found.drift.scale) == bool(drift.scale)


@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.full) for seed in (4, 5))])
@pytest.mark.parametrize(
    "light",
    [
        {},
        {"electrons": 40.0},
        {"volume_mm": (VOLUME_MM[0], VOLUME_MM[1], (0.8, 3.2))},
        {"volume_mm": ((-1.4, 0.2), *VOLUME_MM[1:])},
    ],
)
def test_none_is_found_where_there_is_none(light, seed):
    found = find_drift(frame(seed=seed, **light), white(), CAMERA)
    assert not found.drift
    assert np.hypot(*found.measured.shift_px) < SURE * 2 * found.shift_std_px


def test_another_camera_and_noise_have_no_drift():
    other = replace(CAMERA, lattice=replace(CAMERA.lattice, rotation_rad=0.03))
    assert find_drift(frame(camera=other), white(), CAMERA) is None
    noise = np.random.default_rng(3).poisson(50.0, white().shape).astype(np.float32)
    assert find_drift(noise, white(), CAMERA) is None


def test_pixels_that_are_no_measurements_are_left_out():
    drift, spoilt = ArrayDrift((0.5, -0.5)), np.zeros(white().shape, bool)
    spoilt[200:260, ::9] = True
    light = np.where(spoilt, np.float32(4000), frame(drift))
    found = find_drift(light, white(), CAMERA, spoilt)
    np.testing.assert_allclose(found.drift.shift_px, drift.shift_px, atol=0.04)
    with_them = find_drift(light, white(), CAMERA)
    assert with_them is None or with_them.shift_std_px > 5 * found.shift_std_px


@pytest.mark.parametrize("free", [[0, 1], [0, 1, 2], [0, 1, 3], [0, 1, 2, 3]])
def test_a_similarity_is_fitted_to_shifts_and_an_outlier_counts_little(free):
    rng = np.random.default_rng(4)
    places = 300 * (rng.normal(size=60) + 1j * rng.normal(size=60))
    truth = np.where(np.isin(range(4), free), [0.5, -0.3, 2e-4, -1e-4], 0.0)
    shift = moved_by(truth, places)
    fitted, _ = similarity(places, shift, np.full(60, 1e-4), free)
    np.testing.assert_allclose(fitted, truth, atol=1e-6)
    shift[7] += 3.0
    fitted, _ = similarity(places, shift, np.full(60, 1e-4), free)
    np.testing.assert_allclose(fitted[:2], truth[:2], atol=2e-3)


def test_its_standard_deviations_are_the_scatter_of_fits():
    rng, places = np.random.default_rng(5), 300 * np.exp(1j * np.arange(24)) * np.linspace(0.3, 1, 24)
    sigma, fits = np.linspace(0.01, 0.05, 24), []
    for _ in range(300):
        noise = sigma * (rng.normal(size=24) + 1j * rng.normal(size=24))
        fits.append(similarity(places, noise, sigma**2, [0, 1, 2, 3])[0])
    _, covariance = similarity(places, np.zeros(24, complex), sigma**2, [0, 1, 2, 3])
    np.testing.assert_allclose(np.std(fits, 0), np.sqrt(np.diag(covariance)), rtol=0.2)


@pytest.mark.parametrize("shift", [0j, 4 + 0j, 3j, -3 - 4j])
def test_the_first_guess_is_the_shift_in_whole_pixels(shift):
    disc = Disc("square", 14.0 + 0j, 6.5, 0.3)
    places = np.array([14.0 * complex(i, j) for i in range(-8, 9) for j in range(-8, 9)])
    t, s = np.mgrid[-130:131, -130:131]
    image = sum((np.hypot(s - at.real, t - at.imag) < 6.5).astype(float) for at in places + shift)
    assert first_guess(image, places, disc) == shift


def test_light_of_frames_is_their_sum_above_the_black_level(tmp_path):
    drift, velocity = ArrayDrift((1.0, -0.5), 0.1), flow("uniform", velocity_m_s=(0.1, 0.0, 0.0))
    settings = {"dt_s": 1e-3, "volume_mm": VOLUME_MM, "windows": ((32, 32, 16),), "rays": 100, "diffraction": False}
    made = simulate_recording(tmp_path / "r", CAMERA, velocity, drift=drift, **settings)
    experiment = Experiment.load(tmp_path / "r" / "experiment.toml")
    expected = made.images["a"].astype(float) + made.images["b"] - 120
    np.testing.assert_allclose(light_of(experiment.recording(), (0, 1)), expected, atol=0.01)
    assert '"turn_deg": 0.1' in (tmp_path / "r" / "truth.json").read_text()
    image = particle_image(drift.of(CAMERA), made.a, rays=100, seed=0)
    correlation = np.corrcoef(image.ravel(), made.images["a"].ravel())[0, 1]
    still = np.corrcoef(particle_image(CAMERA, made.a, rays=100, seed=0).ravel(), made.images["a"].ravel())[0, 1]
    assert correlation > 0.98 > still + 0.05
