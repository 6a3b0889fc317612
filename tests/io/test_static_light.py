"""Dark counts and static light taken off a frame, and the pixels that say nothing."""

import numpy as np
import pytest
import tifffile

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import layout
from plenopiv.reconstruction.noise import Noise, noise_of
from plenopiv.recording import Recording
from plenopiv.recording.static_light import hot_pixels, static_light
from plenopiv.sensor import Sensor

SENSOR = Sensor(200, 150, 0.0055, 12, 60.0)


def scene(seed=0, scale=1.0):
    """Counts of a frame with particles, of its background and dark images, and the light of the particles."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[: SENSOR.rows, : SENSOR.columns]
    static = 30 + 900 * np.exp(-((row - 60) ** 2 + (column - 70) ** 2) / 300.0)
    level = 60 + 3 * np.sin(column / 20)
    particles = np.where(rng.random(static.shape) < 0.05, rng.uniform(50, 300, static.shape), 0.0)
    noise = rng.normal(0, 1.5, static.shape)
    frame = np.rint(level + scale * static + particles + noise).astype(np.uint16)
    return frame, np.rint(level + static).astype(np.uint16), np.rint(level).astype(np.uint16), particles


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.15])
def test_what_is_left_is_the_light_of_particles(scale):
    frame, background, dark, particles = scene(scale=scale)
    found = static_light(SENSOR, dark, (background, background))
    assert found.scale(frame, 0) == pytest.approx(scale, rel=0.01)
    light, static = found.removed(frame, 0)
    left = light - SENSOR.black_level - particles
    assert abs(left.mean()) < 0.6
    assert left.std() < 4.0
    assert static.max() == pytest.approx(scale * 930, rel=0.02)


def test_each_pulse_has_its_own_static_light(tmp_path):
    """The second pulse lights half as much: of walls and of particles."""
    frame, background, dark, particles = scene()
    other, *_ = scene(seed=0, scale=0.5)
    half = np.rint(dark + 0.5 * (background.astype(float) - dark)).astype(np.uint16)
    images = {"a": frame, "b": other, "dark": dark, "bg_a": background, "bg_b": half}
    for name, image in images.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", image)
    path = {name: tmp_path / f"{name}.tif" for name in images}
    frames = (path["a"], path["b"], path["b"], path["a"])
    pulses = path["bg_a"], path["bg_b"]
    recording = Recording(SENSOR, frames, None, 1e-3, "upright", ((0, 1), (3, 2)), path["dark"], pulses)
    assert recording.light(0)[1].max() == pytest.approx(930, rel=0.02)
    assert recording.light(1)[1].max() == pytest.approx(465, rel=0.02)
    for k in range(4):
        left = recording.light(k)[0] - SENSOR.black_level - particles
        assert abs(np.median(left)) < 1.0


def test_two_background_images_are_those_of_pairs(tmp_path):
    """Two frames are a pair; of three, the one in the middle is first and second, and has no pulse."""
    for k, name in enumerate(("a", "b", "c", "bg_a", "bg_b")):
        tifffile.imwrite(tmp_path / f"{name}.tif", scene(seed=k)[0])
    a, b, c, bg_a, bg_b = (tmp_path / f"{name}.tif" for name in ("a", "b", "c", "bg_a", "bg_b"))
    pair = Recording(SENSOR, (a, b), None, 1e-3, "upright", background_paths=(bg_a, bg_b))
    assert not np.array_equal(*pair.static_light.pulses)
    line = (
        r"^recording\.background: two images belong to the two pulses of pairs, and the 3 frames are a sequence; name "
        r"one image, or give the frames as recording\.pairs$"
    )
    with pytest.raises(PlenoPIVError, match=line):
        Recording(SENSOR, (a, b, c), None, 1e-3, "upright", background_paths=(bg_a, bg_b))
    Recording(SENSOR, (a, b, c), None, 1e-3, "upright", background_paths=(bg_a,))


@pytest.mark.parametrize("dark", [0, 60])
def test_a_dark_image_of_even_counts_is_one(tmp_path, dark):
    """A camera that clips at zero gives no other; and a background may be as dark."""
    frame, *_ = scene()
    for name, image in {"a": frame, "b": frame + 1, "dark": np.full_like(frame, dark)}.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", image)
    a, b, even = (tmp_path / f"{name}.tif" for name in ("a", "b", "dark"))
    for pulses in ((), (even,)):
        recording = Recording(SENSOR, (a, b), None, 1e-3, "upright", dark_path=even, background_paths=pulses)
        assert not recording.unusable.any()
        np.testing.assert_array_equal(recording.light(0)[0] - SENSOR.black_level, frame.astype(np.float32) - dark)
    tifffile.imwrite(even, np.full_like(frame, SENSOR.full_scale))
    with pytest.raises(PlenoPIVError, match="the image is blank"):
        _ = Recording(SENSOR, (a, b), None, 1e-3, "upright", dark_path=even).static_light
    with pytest.raises(PlenoPIVError, match="the image is blank"):
        Recording(SENSOR, (even, b), None, 1e-3, "upright").frame(0)


def test_hot_and_dead_pixels_are_no_equations():
    rng = np.random.default_rng(3)
    dark = np.rint(60 + rng.normal(0, 0.6, (SENSOR.rows, SENSOR.columns)))
    hot = rng.random(dark.shape) < 1e-3
    dark[hot] += rng.uniform(15, 2000, np.count_nonzero(hot))
    dark[5, 7] = 0
    hot[5, 7] = True
    np.testing.assert_array_equal(hot_pixels(dark), hot)


def test_static_light_that_saturates_says_nothing():
    frame, background, dark, _ = scene()
    background = background.copy()
    background[60:64, 70:74] = SENSOR.full_scale
    frame = frame.copy()
    frame[100, 100] = SENSOR.full_scale
    found = static_light(SENSOR, dark, (background, background))
    assert found.unusable[60:64, 70:74].all()
    assert found.unusable.sum() == 16
    light, _ = found.removed(frame, 0)
    assert light[100, 100] == SENSOR.full_scale  # still known as saturated


def test_masked_pixels_are_not_among_the_equations():
    from oracles.cameras import small_camera

    camera = small_camera("hexagonal", pmr=8, microlenses=(9, 8))
    whole = layout(camera)
    masked = np.zeros((camera.sensor.rows, camera.sensor.columns), bool)
    masked[20:30, 33] = True
    cut = layout(camera, masked)
    assert cut.offsets.shape == whole.offsets.shape
    column = whole.pixel[None, :, 0] + whole.offsets[:, None, 0]
    row = whole.pixel[None, :, 1] + whole.offsets[:, None, 1]
    there = (column == 33) & (row >= 20) & (row < 30)
    assert (whole.seen & there).any()
    np.testing.assert_array_equal(cut.seen, whole.seen & ~there)


def test_noise_of_static_light_is_in_the_noise():
    rng = np.random.default_rng(4)
    gain, dark, static = 0.5, 1.5, np.full((50, 4000), 250.0, np.float32)
    counts = gain * rng.poisson(static / gain) + rng.normal(0, dark, static.shape) - static
    noise = noise_of(counts.astype(np.float32), np.ones(static.shape, bool), gain, static)
    assert noise.dark == pytest.approx(dark, abs=1.0)
    assert float(noise.std(np.zeros((1, 1), np.float32)).mean()) == pytest.approx(counts.std(), rel=0.05)
    np.testing.assert_allclose(noise.floor(0.5), static + noise.dark)
    assert Noise(2.0).floor(0.5) == 2.0
    assert Noise(0.1).floor(0.5) == 0.5


@pytest.mark.parametrize("common", [0, 25])
def test_particles_that_are_more_in_the_middle_do_not_brighten_the_pulse(common):
    """Static light and seeding both grow toward the middle; ``common``: light that every pixel holds."""
    rng = np.random.default_rng(6)
    row, column = np.mgrid[: SENSOR.rows, : SENSOR.columns]
    away = (row - 75) ** 2 + (column - 100) ** 2
    static, share = 300 * np.exp(-away / 1800.0), 0.2 + 0.4 * np.exp(-away / 4000.0)
    particles = np.where(rng.random(static.shape) < share, rng.exponential(150.0, static.shape), 0.0)
    found = static_light(SENSOR, None, tuple(np.rint(60 + static).astype(np.uint16) for _ in range(2)))
    for scale in (0.6, 1.0):
        light = 60 + common + 0.5 * rng.poisson((scale * static + particles) / 0.5) + rng.normal(0, 1.5, static.shape)
        assert found.scale(np.rint(light).astype(np.uint16), 0) == pytest.approx(scale, rel=0.03)
