"""Exit pupil and stop from the outlines of micro-images."""

import numpy as np
import pytest

from plenopiv.calibration.target.pupil import Outline, outline, pupil_and_stop
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import real_white_image

CAMERA = PlenopticCamera(
    MainLens(50.0, 22.0, -1.0), Lattice("hexagonal", 0.077, 0.005, (0.02, -0.01)), 0.308, Sensor(1000, 800, 0.0055, 12)
)
PUPIL = 12 * 50 / 38  # the stop's image, from the lens


def test_closed_form_of_a_stop_before_a_thin_lens():
    """A stop 12 mm before a lens of 50 mm is imaged 15.79 mm before it, 1.316 times as large."""
    exact = np.array([0.308 / 100.0, 0.308 / (100.0 + PUPIL)])
    seen = Outline(exact, np.zeros(2), np.array([12.3, 11 * PUPIL / 12]) * exact / 0.0055, np.zeros(2))
    covariance = np.diag([0.3, 0.6, 0.002]) ** 2
    for order in (slice(None), slice(None, None, -1)):
        same = Outline(seen.growth[order], seen.growth_std, seen.radius_px[order], seen.radius_std)
        values, std = pupil_and_stop(same, CAMERA, np.array([50.0, 100.0, 0.308]), covariance)
        assert values == pytest.approx(
            {
                "exit_pupil_mm": 100 + PUPIL,
                "exit_pupil_radius_mm": 11 * PUPIL / 12,
                "stop_mm": 12.0,
                "stop_radius_mm": 11.0,
                "rim_radius_mm": 12.3,
            }
        )
        assert std["exit_pupil_mm"] == pytest.approx(0.002 / 0.308 * (100 + PUPIL), rel=0.1)


@pytest.mark.parametrize("stop_mm", [-10.0, -30.0])
def test_a_stop_behind_the_lens_is_its_own_exit_pupil(stop_mm):
    exact = np.array([0.308 / (100.0 + stop_mm), 0.308 / 100.0])
    seen = Outline(exact, np.zeros(2), np.array([10.0, 12.3]) * exact / 0.0055, np.zeros(2))
    values, _ = pupil_and_stop(seen, CAMERA, np.array([50.0, 100.0, 0.308]), np.diag([1e-6] * 3))
    assert values["stop_mm"] == pytest.approx(stop_mm)
    assert values["stop_radius_mm"] == values["exit_pupil_radius_mm"] == pytest.approx(10.0)
    assert values["exit_pupil_mm"] == pytest.approx(100.0 + stop_mm)
    assert values["rim_radius_mm"] == pytest.approx(12.3)


@pytest.mark.full
def test_a_rim_that_clips_shows_the_stop():
    camera = RealCamera.of(CAMERA, stop_mm=12.0, rim_radius_mm=12.32)
    rng = np.random.default_rng(1)
    electrons = rng.poisson(real_white_image(camera, 6000.0))
    counts = np.rint(electrons / 2.5 + rng.normal(0, 2, electrons.shape)).clip(0)
    seen = outline(counts, CAMERA)
    assert seen is not None
    values, _ = pupil_and_stop(seen, CAMERA, np.array([50.0, 100.0, 0.308]), np.diag([1e-3, 1e-3, 1e-6]) ** 2)
    for name, true in (("exit_pupil_mm", 100 + PUPIL), ("stop_radius_mm", 11.0), ("rim_radius_mm", 12.32)):
        assert values[name] == pytest.approx(true, rel=0.02)


@pytest.mark.full
def test_without_a_rim_there_is_one_disc():
    electrons = np.random.default_rng(2).poisson(real_white_image(RealCamera.of(CAMERA), 6000.0))
    assert outline(electrons / 2.5, CAMERA) is None
