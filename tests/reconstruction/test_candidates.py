"""Noise and thresholds from a frame alone, and what a user reads when nothing can be reconstructed."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField, layout
from plenopiv.projection.projector import Projector
from plenopiv.reconstruction.candidates import BRIGHT_SHARE, NOISE_MULTIPLE, dark_noise, lit_threshold
from plenopiv.reconstruction.chain import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import VoxelGrid

WHERE = layout(small_camera("square", pmr=8))
GRID = VoxelGrid.covering((-0.2, 0.2), (-0.2, 0.2), (-1, 1), (0.044, 0.044, 0.1))


def field(values):
    return LightField(WHERE, np.where(WHERE.seen, values, 0).astype(np.float32))


@pytest.mark.parametrize("sigma", [0.8, 3.0, 12.0])
@pytest.mark.parametrize("lit_share", [0.0, 0.3])
def test_dark_noise_is_that_of_dark_pixels(sigma, lit_share):
    """Light adds to pixels above the black level, those below stay half a normal distribution."""
    rng = np.random.default_rng(0)
    light = np.where(rng.random(WHERE.seen.shape) < lit_share, 20 * sigma, 0.0)
    assert dark_noise(field(rng.normal(0, sigma, WHERE.seen.shape) + light)) == pytest.approx(sigma, rel=0.05)


def test_whole_counts_bias_the_noise_little():
    values = np.rint(np.random.default_rng(0).normal(0, 2.0, WHERE.seen.shape))
    assert dark_noise(field(values)) == pytest.approx(2.0, rel=0.15)


def test_a_frame_without_noise():
    assert dark_noise(field(np.full(WHERE.seen.shape, 7.0))) == 0.0
    assert lit_threshold(field(np.zeros(WHERE.seen.shape))) == 1.0


def test_threshold_stands_above_noise_and_below_light():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 4.0, WHERE.seen.shape)
    dark = field(noise)
    assert lit_threshold(dark) == pytest.approx(NOISE_MULTIPLE * 4.0, rel=0.05)
    assert np.mean(dark.values[WHERE.seen] > lit_threshold(dark)) < 0.003
    bright = field(noise + 2000.0 * (rng.random(WHERE.seen.shape) < 0.2))
    assert lit_threshold(bright) == pytest.approx(BRIGHT_SHARE * 2000.0, rel=0.05)


def test_a_frame_without_particles():
    projector = Projector(WHERE, GRID, "1-ray")
    message = r"^frame_7: no particles.*sensor\.black_level and reconstruction\.threshold"
    with pytest.raises(PlenoPIVError, match=message) as e:
        reconstruct(field(np.zeros(WHERE.seen.shape)), projector, ReconstructionSettings(), name="frame_7")
    assert "\n" not in str(e.value)


def test_a_frame_in_which_nothing_fits_together():
    """Single lit pixels are no particle: no voxel is behind lit pixels alone."""
    lit = np.random.default_rng(2).random(WHERE.seen.shape) < 0.01
    projector = Projector(WHERE, GRID, "1-ray")
    settings = ReconstructionSettings(tolerance_px=0.0)
    with pytest.raises(PlenoPIVError, match=r'^frame_7: dense ray tracing leaves no voxel.*threshold.*"mart"'):
        reconstruct(field(100.0 * lit), projector, settings, name="frame_7")


def test_a_given_threshold_is_used():
    values = np.where(np.random.default_rng(3).random(WHERE.seen.shape) < 0.5, 10.0, 30.0)
    projector = Projector(WHERE, GRID, "1-ray")
    with pytest.raises(PlenoPIVError, match="no particles"):
        reconstruct(field(values), projector, ReconstructionSettings(threshold=31.0))
    found = reconstruct(field(values), projector, ReconstructionSettings(threshold=5.0, iterations=1))
    assert found.threshold == 5.0
    assert found.candidates == 1.0
