"""Noise and thresholds from a frame alone, and what a user reads when nothing can be reconstructed."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.candidates import (
    BRIGHT_SHARE,
    CROWD,
    CROWDED,
    LIT_MULTIPLE,
    LONE,
    faintest_share,
    lit_threshold,
    most_light,
)
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.volume import VoxelGrid

WHERE = layout(small_camera("square", pmr=8))
GRID = VoxelGrid.covering((-0.2, 0.2), (-0.2, 0.2), (-1, 1), (0.044, 0.044, 0.1))


def field(values):
    return LightField(WHERE, np.where(WHERE.seen, values, 0).astype(np.float32))


def test_threshold_stands_above_noise_and_below_light():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 4.0, WHERE.seen.shape)
    dark = field(noise)
    assert lit_threshold(dark, Noise(dark_noise(dark))) == pytest.approx(LIT_MULTIPLE * 4.0, rel=0.05)
    assert np.mean(dark.values[WHERE.seen] > lit_threshold(dark, Noise(dark_noise(dark)))) < 0.003
    bright = field(noise + 2000.0 * (rng.random(WHERE.seen.shape) < 0.2))
    assert lit_threshold(bright, Noise(dark_noise(bright))) == pytest.approx(BRIGHT_SHARE * 2000.0, rel=0.05)


def test_a_dark_frame_has_the_lowest_threshold():
    assert lit_threshold(field(np.zeros(WHERE.seen.shape)), Noise(0.0)) == 1.0


def test_a_saturated_pixel_bounds_nothing():
    sensor = WHERE.camera.sensor
    values = field(np.full(WHERE.seen.shape, sensor.full_scale - sensor.black_level))
    assert np.isinf(most_light(values, Noise(1.0))[WHERE.seen]).all()
    bound = most_light(field(np.full(WHERE.seen.shape, 96.0)), Noise(2.0, 1.0))
    np.testing.assert_allclose(bound[WHERE.seen], 96 + 2 * 10)


def test_fainter_particles_are_looked_for_where_few_pixels_are_lit():
    rng, particle = np.random.default_rng(3), 50.0
    lit = {share: rng.random(WHERE.seen.shape) < share for share in (0.0, 0.5 * CROWD, 2 * CROWD)}
    found = [faintest_share(field(1.1 * LONE * particle * where), particle) for where in lit.values()]
    assert found == [LONE, pytest.approx(0.5 * (LONE + CROWDED), rel=0.05), CROWDED]
    assert faintest_share(field(0.9 * LONE * particle * lit[2 * CROWD]), particle) == LONE  # haze is no particle


def test_a_frame_without_particles():
    projector = PlenopticProjector(WHERE, GRID, "1-ray")
    message = r"^frame_7: no particles.*sensor\.black_level and reconstruction\.threshold"
    with pytest.raises(PlenoPIVError, match=message) as e:
        reconstruct(field(np.zeros(WHERE.seen.shape)).values, projector, ReconstructionSettings(), name="frame_7")
    assert "\n" not in str(e.value)


def test_a_frame_in_which_nothing_fits_together():
    """Single lit pixels are no particle: no voxel is behind lit pixels alone."""
    lit = np.random.default_rng(2).random(WHERE.seen.shape) < 0.01
    projector = PlenopticProjector(WHERE, GRID, "1-ray")
    settings = ReconstructionSettings(candidates="product")
    with pytest.raises(PlenoPIVError, match=r'^frame_7: dense ray tracing leaves no voxel.*threshold.*"mart"'):
        reconstruct(field(100.0 * lit).values, projector, settings, name="frame_7")


def test_a_given_threshold_is_used():
    values = np.where(np.random.default_rng(3).random(WHERE.seen.shape) < 0.5, 10.0, 30.0)
    projector = PlenopticProjector(WHERE, GRID, "1-ray")
    with pytest.raises(PlenoPIVError, match="no particles"):
        reconstruct(field(values).values, projector, ReconstructionSettings(threshold=31.0))
    found = reconstruct(field(values).values, projector, ReconstructionSettings(threshold=5.0, iterations=1))
    assert found.threshold == 5.0
    assert found.candidates == 1.0
