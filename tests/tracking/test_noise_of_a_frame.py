"""Noise measured on a frame: dark noise, stray light and shot noise, static light or none, few particles not known."""

import numpy as np
import pytest

from plenopiv.tracking.pixels import Pixels

SIDE, GAIN, DARK, STRAY = 400, 0.5, 2.5, 3.0
RNG = np.random.default_rng(5)
COLUMN = np.arange(SIDE * SIDE) % SIDE
LIT = COLUMN >= SIDE // 2  # the right half of the image
LIGHT = np.where(LIT, 40.0 + 0.8 * COLUMN, 0.0)
GLOW = 0.2 * COLUMN  # static light, taken off


def frame(known_gain, static=None, not_found=0.0):
    """Pixels of a frame of which ``not_found`` of the lit ones hold as much light again as is known."""
    light = LIGHT * np.where(RNG.random(len(LIGHT)) < not_found, 2.0, 1.0)
    behind = np.zeros_like(LIGHT) if static is None else static
    counts = GAIN * RNG.poisson((light + STRAY + behind) / GAIN) + RNG.normal(0.0, DARK, len(LIGHT)) - behind
    image = counts.reshape(SIDE, SIDE) + 60.0
    of = None if static is None else static.reshape(SIDE, SIDE)
    return Pixels.of_image(image, 60.0, 1e6, 1.0, known_gain, None, of)


@pytest.mark.parametrize("static", [None, GLOW], ids=["none", "static"])
@pytest.mark.parametrize("not_found", [0.0, 0.05])
def test_noise_is_measured(static, not_found):
    pixels = frame(8.0, static, not_found).with_measured_noise(~LIT, LIGHT)
    assert pixels.background == pytest.approx(STRAY, abs=0.1)
    assert pixels.noise**0.5 == pytest.approx(DARK, rel=0.05 + not_found)
    assert pixels.counts_per_electron == pytest.approx(GAIN, rel=0.04 + 2.5 * not_found)


def test_shot_noise_is_at_most_what_was_known():
    """Light that the fit does not hold is not taken for noise."""
    pixels = frame(GAIN).with_measured_noise(~LIT, 0.8 * LIGHT)
    assert pixels.counts_per_electron == GAIN


def test_too_few_pixels_tell_nothing():
    pixels = frame(8.0)
    assert pixels.with_measured_noise(np.zeros(len(LIT), bool), LIGHT) is pixels
    few = np.zeros(len(LIT))
    few[:1000] = 200.0
    assert pixels.with_measured_noise(~LIT, few).counts_per_electron == 8.0


def test_pixels_that_are_not_finite_are_not_used():
    image = 60.0 + LIGHT.reshape(SIDE, SIDE)
    image[0, :3] = np.nan, np.inf, -np.inf
    pixels = Pixels.of_image(image, 60.0, 1e6, 1.0, GAIN)
    assert np.flatnonzero(~pixels.usable).tolist() == [0, 1, 2]
    assert np.isfinite(pixels.counts).all()
    measured = pixels.with_measured_noise(~LIT, LIGHT)
    assert np.isfinite([measured.background, measured.noise, measured.counts_per_electron]).all()
