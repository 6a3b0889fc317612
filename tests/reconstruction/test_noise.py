"""Read noise from dark pixels, shot noise from a white image."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.errors import PlenoPIVWarning
from plenopiv.lightfield import LightField, layout
from plenopiv.reconstruction.noise import NO_WHITE_IMAGE, Noise, counts_per_electron, dark_noise

WHERE = layout(small_camera("square", pmr=8))
LARGER = layout(small_camera("hexagonal", pmr=8, microlenses=(40, 34)))


def field(values, where=WHERE):
    return LightField(where, np.where(where.seen, values, 0).astype(np.float32))


@pytest.mark.parametrize("sigma", [0.8, 3.0, 12.0])
@pytest.mark.parametrize("lit_share", [0.0, 0.3])
def test_dark_noise_is_that_of_dark_pixels(sigma, lit_share):
    """Light adds to pixels above the black level, those below stay half a normal distribution."""
    rng = np.random.default_rng(0)
    light = np.where(rng.random(WHERE.seen.shape) < lit_share, 20 * sigma, 0.0)
    assert dark_noise(field(rng.normal(0, sigma, WHERE.seen.shape) + light)) == pytest.approx(sigma, rel=0.05)


@pytest.mark.parametrize("share", [0.001, 0.02])
def test_dead_pixels_are_no_noise(share):
    """They hold 0, far below the black level."""
    rng = np.random.default_rng(0)
    values = rng.normal(0, 5.0, WHERE.seen.shape)
    values[rng.random(values.shape) < share] = -400.0
    assert dark_noise(field(values)) == pytest.approx(5.0, rel=0.08)


def test_whole_counts_bias_the_noise_little():
    values = np.rint(np.random.default_rng(0).normal(0, 2.0, WHERE.seen.shape))
    assert dark_noise(field(values)) == pytest.approx(2.0, rel=0.15)


def test_a_frame_without_noise():
    assert dark_noise(field(np.full(WHERE.seen.shape, 7.0))) == 0.0


def white(gain, between_lenses=0.0, seed=4):
    rng = np.random.default_rng(seed)
    falloff = np.linspace(0.7, 1.0, LARGER.lenses) * (1 + between_lenses * rng.normal(size=LARGER.lenses))
    return field(gain * rng.poisson(2500 / gain * LARGER.fill * falloff), LARGER)


@pytest.mark.parametrize("gain", [0.2, 0.5, 2.0])
def test_counts_per_electron_from_a_white_image(gain):
    """Light that falls off over the sensor does not matter."""
    assert counts_per_electron(white(gain)) == pytest.approx(gain, rel=0.06)


def test_microlenses_that_differ_raise_it():
    assert 0.5 < counts_per_electron(white(0.5, 0.01)) < 1.0


def saturated(gain, light):
    """A white image cut off at full scale, brighter to the right."""
    sensor = LARGER.camera.sensor
    rng = np.random.default_rng(4)
    column = np.arange(LARGER.lenses) % LARGER.ni
    values = gain * rng.poisson(light / gain * LARGER.fill * np.linspace(0.8, 1.1, LARGER.ni)[column])
    return field(np.minimum(values, sensor.full_scale - sensor.black_level), LARGER)


@pytest.mark.parametrize("gain", [0.5, 2.0])
@pytest.mark.parametrize("share", [0.95, 1.0])
def test_saturated_pixels_tell_no_shot_noise(gain, share):
    sensor = LARGER.camera.sensor
    image = saturated(gain, share * (sensor.full_scale - sensor.black_level))
    assert counts_per_electron(image) == pytest.approx(gain, rel=0.12)


def test_where_too_few_are_below_full_scale_it_is_said():
    sensor = LARGER.camera.sensor
    with pytest.warns(PlenoPIVWarning, match=r"^recording\.white: too many of its pixels are at full scale"):
        found = counts_per_electron(saturated(0.5, 1.3 * (sensor.full_scale - sensor.black_level)))
    assert found == NO_WHITE_IMAGE


def test_a_mean_of_several_white_images_tells_no_shot_noise():
    """A sixtieth of the variance of one: as if pixels held half a million electrons."""
    several = replace(white(0.5), values=np.mean([white(0.5, seed=k).values for k in range(60)], 0))
    assert counts_per_electron(several) == NO_WHITE_IMAGE


def test_noise_of_a_pixel():
    np.testing.assert_allclose(Noise(3.0, 0.5).std(np.array([-7.0, 0.0, 32.0], np.float32)), [3.0, 3.0, 5.0])


def test_noise_of_a_pixel_whose_static_light_is_estimated_below_the_black_level():
    behind = np.array([[-40.0, -1.0, 32.0]], np.float32)
    noise = Noise(3.0, 0.5, behind)
    np.testing.assert_allclose(noise.std(np.array([[0.0, 32.0, 0.0]], np.float32)), [[3.0, 5.0, 5.0]])
