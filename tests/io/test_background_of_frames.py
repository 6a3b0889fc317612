"""Static light estimated from the frames themselves, against scenes whose static light is known."""

import numpy as np
import pytest

from plenopiv.errors import PlenoPIVError
from plenopiv.recording.background import static_light_of_frames
from plenopiv.recording.pixel_light import pixel_light
from plenopiv.sensor import Sensor

SENSOR = Sensor(240, 200, 0.0055, 12, 60.0)
GAIN, DARK_NOISE = 0.5, 1.6
ROW, COLUMN = np.mgrid[: SENSOR.rows, : SENSOR.columns]
GLOW = 250 * np.exp(-((ROW - 70) ** 2 + (COLUMN - 90) ** 2) / (2 * 25.0**2))
EVERYWHERE = np.ones(GLOW.shape, bool)


def frames(pairs, lit=0.6, second=0.6, seed=0, glow=GLOW):
    """Counts of first and second frames in turn; each pixel is lit with the probability ``lit``, static light of the
    second pulse is weaker and, as the light of each pulse, varies by 3 per cent."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(2 * pairs):
        pulse = second if k % 2 else 1.0
        particles = np.where(rng.random(GLOW.shape) < lit, rng.exponential(120.0, GLOW.shape), 0.0)
        light = pulse * (particles + glow * (1 + 0.03 * rng.standard_normal()))
        counts = 60 + GAIN * rng.poisson(light / GAIN) + rng.normal(0, DARK_NOISE, GLOW.shape)
        out.append(np.clip(np.rint(counts), 0, 4095).astype(np.uint16))
    return out


def estimated(images, unusable=~EVERYWHERE):
    numbers = range(len(images))
    dark = np.full(GLOW.shape, 60, np.float32)
    return static_light_of_frames(
        images.__getitem__, [numbers[::2], numbers[1::2]], SENSOR, dark, GAIN, unusable, EVERYWHERE
    )


def test_static_light_of_both_pulses_is_found_though_particles_light_most_pixels():
    found, (a, b) = estimated(frames(20))
    for one, light in zip(found.pulses, (GLOW, 0.6 * GLOW), strict=True):
        off = one - light
        noise = np.sqrt(GAIN * light + DARK_NOISE**2)
        assert abs(np.median(off)) < 0.4
        assert np.sqrt(np.mean((off / noise) ** 2)) < 0.7  # less than a frame's own noise
    assert a.left_counts < 2.0
    assert b.left_counts < 2.0
    assert b.error_counts == pytest.approx(0.6 * a.error_counts, rel=0.1)  # both were found from both


def test_the_stated_error_is_that_of_pixels_without_static_light():
    images = frames(12)
    found, (a, _) = estimated(images)
    alone = GLOW < 1
    off = found.pulses[0][alone] - GLOW[alone]
    assert np.percentile(np.abs(off - np.median(off)), 68.3) == pytest.approx(a.error_counts, rel=0.5)


def test_it_is_nearer_than_the_minimum_itself():
    images = frames(12)
    found, _ = estimated(images)
    least = np.minimum.reduce(images[::2]) - 60.0
    bright = GLOW > 100
    assert np.std((found.pulses[0] - GLOW)[bright]) < 0.8 * np.std((least - GLOW)[bright])
    assert abs(np.mean((found.pulses[0] - GLOW)[bright])) < 0.4 * abs(np.mean((least - GLOW)[bright]))


def test_too_few_frames_for_their_seeding_are_refused():
    with pytest.raises(PlenoPIVError, match=r"minimum.* frames are too few"):
        estimated(frames(3, lit=0.9))


def test_frames_that_cannot_be_read_are_left_out():
    images = frames(12)

    class Damaged(list):
        def __getitem__(self, k):
            if k == 5:
                raise PlenoPIVError("p2_b.tif: is truncated")
            return super().__getitem__(k)

    _, (a, _) = estimated(Damaged(images))
    assert a.frames == 23


def test_hot_pixels_are_no_equations():
    images = frames(20)
    for image in images:
        image[150, 200] = 900
        image[20, 30] = SENSOR.full_scale
    found, _ = estimated(images)
    assert found.unusable[150, 200]
    assert found.unusable[20, 30]
    assert found.unusable.sum() == 2


def test_static_light_of_another_shape_in_the_second_pulse_stays_apart():
    images, moved = frames(20), np.roll(GLOW, 60, 1) - GLOW
    images[1::2] = [np.clip(image + np.rint(0.6 * moved), 0, 4095).astype(np.uint16) for image in images[1::2]]
    found, _ = estimated(images)
    assert np.median((found.pulses[1] / 0.6 - np.roll(GLOW, 60, 1))[np.roll(GLOW, 60, 1) > 100]) == pytest.approx(
        0, abs=12
    )
    assert np.median((found.pulses[0] - GLOW)[GLOW > 100]) == pytest.approx(0, abs=6)


def test_light_of_the_first_pulse_alone_is_no_measure_of_the_second():
    spot = np.zeros(GLOW.shape)
    spot[100:120, 150:170] = 120.0
    images = frames(20, glow=0 * GLOW)
    rng = np.random.default_rng(1)
    images[::2] = [(image + np.rint(GAIN * rng.poisson(spot / GAIN))).astype(np.uint16) for image in images[::2]]
    found, _ = estimated(images)
    for one, light in zip(found.pulses, (spot, 0 * spot), strict=True):
        assert np.median((one - light)[spot > 0]) == pytest.approx(0, abs=3)
        assert np.sqrt(np.mean((one - light) ** 2)) < 3


def test_scores_are_the_slope_of_the_logarithm_of_the_density():
    """Noise alone: the score of a normal distribution is its argument, and the information 1."""
    rng = np.random.default_rng(1)
    light = pixel_light(rng.normal(0, 4.0, 1_000_000).astype(np.float32), 0.0, 0.0)
    assert light.noise == pytest.approx(4.0, rel=0.01)
    at = np.array([-6.0, -2.0, 0.0, 3.0, 7.0], np.float32)
    np.testing.assert_allclose(light.scores(at, light.level(np.full(5, 4.0, np.float32))), at / 4.0, atol=0.15)
    assert light.information[0] == pytest.approx(1.0, rel=0.1)
    assert light.lowest(60)[0] == pytest.approx(-2.32 * 4.0, rel=0.05)  # of 60 normal values


def test_pulses_of_other_brightness():
    rng = np.random.default_rng(2)
    static = rng.uniform(50, 400, 20_000).astype(np.float32)
    lit = np.where(rng.random(static.shape) < 0.7, rng.exponential(80, static.shape), 0)
    dark = np.where(rng.random(100_000) < 0.7, rng.exponential(80, 100_000), 0) + rng.normal(0, 2, 100_000)
    light = pixel_light(dark.astype(np.float32), GAIN, 400.0)
    level = light.level(np.sqrt(GAIN * static + 4.0).astype(np.float32))
    for scale in (0.7, 1.0, 1.3):
        counts = GAIN * rng.poisson((scale * static + lit) / GAIN) + rng.normal(0, 2, static.shape)
        found, error = light.brightness(counts.astype(np.float32), static, level)
        assert found == pytest.approx(scale, rel=0.015)
        assert error < 0.001
