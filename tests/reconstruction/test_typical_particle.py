"""The light of a typical particle and how widely particles differ, from one frame alone."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import LightField, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction import typical_particle as of_typical
from plenopiv.reconstruction.noise import Noise, dark_noise
from plenopiv.reconstruction.typical_particle import (
    BLOCKS,
    FEWEST,
    LOWEST,
    Differences,
    Moments,
    differences,
    exponent,
    moments,
    of_all_pixels,
    relative_spread,
    typical_particle,
)
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import SparseVolume, VoxelGrid

NOISE = Noise(2.0, 0.4)


def frame_of_particles(rng, share, brightness):
    """A frame of particles in a ``share`` of the voxels, ``brightness(n)`` counts each, with noise; its projector, and
    the particles' light."""
    where = layout(small_camera("hexagonal", pmr=8, microlenses=(40, 34)))
    grid = VoxelGrid.covering((-0.8, 0.8), (-0.7, 0.7), (-2, 2), (0.022, 0.022, 0.1))
    projector = PlenopticProjector(where, grid, "exact")
    volume = SparseVolume.from_mask(grid, rng.random(grid.shape) < share)
    light = brightness(volume.column.size)
    volume = volume.with_values(light.astype(np.float32))
    values = np.array([projector.forward(view, volume) for view in range(projector.views)])
    values = 0.4 * rng.poisson(values / 0.4) + rng.normal(0, 2.0, values.shape)
    return LightField(where, np.where(where.seen, values, 0).astype(np.float32)), projector, light


def log_normal(rng, spread, mean=4000.0):
    """The light of n particles."""
    sigma = np.sqrt(np.log(1.0 + spread**2))
    return lambda n: mean * np.exp(sigma * rng.standard_normal(n) - 0.5 * sigma**2)


def recording(lit, ppm, spread=0.25, stray=0.0):
    """A frame of particles of 400 electrons in a pixel in focus, in the share ``lit`` of a volume along x and y, and
    its projector."""
    camera, limits = small_camera("hexagonal", microlenses=(57, 46)), ((-1.7, 1.7), (-1.3, 1.3), (-2.5, 2.5))
    rng, shares = np.random.default_rng(1), (*lit, 1.0)
    seeded = tuple((share * lo, share * hi) for share, (lo, hi) in zip(shares, limits, strict=True))
    particles = seed_box(camera, seeded, ppm, rng, electrons_per_pixel=400.0, electrons_spread=spread)
    image = particle_image(camera, particles, rays=500, seed=1) + stray
    where, grid = layout(camera), VoxelGrid.covering(*limits, (0.017, 0.017, 0.077))
    lightfield = decode(digitise(image, camera.sensor, SensorNoise(0.4, 5.0), rng), where)
    return lightfield, PlenopticProjector(where, grid, "1-ray")


@pytest.mark.parametrize("spread", [0.0, 0.5])
@pytest.mark.parametrize("share", [0.002, 0.01])
def test_brightness_of_a_typical_particle(share, spread):
    """<E^2>/<E> from the pixels alone, whatever the density, shot and read noise taken out."""
    rng = np.random.default_rng(0)
    lightfield, projector, light = frame_of_particles(
        rng, share, lambda n: 20_000.0 * (1 + spread * rng.uniform(-1.0, 1.0, n))
    )
    want = np.mean(light**2) / np.mean(light)
    assert typical_particle(lightfield, projector, NOISE) == moments(lightfield, projector, NOISE).light
    assert typical_particle(lightfield, projector, NOISE) == pytest.approx(want, rel=0.1)


@pytest.mark.parametrize("spread", [1.0, 2.0])
def test_where_particles_differ_widely_the_mean_is_typical(spread):
    """<E^2>/<E> is 2 to 5 times the mean."""
    rng = np.random.default_rng(1)
    lightfield, projector, light = frame_of_particles(rng, 0.01, log_normal(rng, spread))
    assert np.mean(light**2) / np.mean(light) ** 2 > 1.8
    assert typical_particle(lightfield, projector, NOISE) == pytest.approx(np.mean(light), rel=0.25)


@pytest.mark.parametrize("spread", [0.0, 0.5, 1.0, 2.0])
def test_the_spread_is_found(spread):
    rng = np.random.default_rng(2)
    lightfield, projector, _ = frame_of_particles(rng, 0.004, log_normal(rng, spread))
    between = differences(lightfield, projector)
    found = relative_spread(between, projector, NOISE, moments(lightfield, projector, NOISE))
    assert found == pytest.approx(spread, rel=0.25, abs=0.5 if spread == 0 else 0.0)


@pytest.mark.parametrize(("share", "few", "brighter"), [(0.003, 0.01, 30.0), (0.01, 0.01, 30.0), (0.003, 0.003, 100.0)])
def test_a_few_particles_far_brighter_are_not_typical(share, few, brighter):
    """With them <E^2>/<E> is 7 to 27 times the light of all others."""
    rng = np.random.default_rng(0)
    lightfield, projector, light = frame_of_particles(
        rng, share, lambda n: 2000.0 * np.where(rng.random(n) < few, brighter, 1.0)
    )
    assert np.mean(light**2) / np.mean(light) > 6 * 2000.0
    assert typical_particle(lightfield, projector, NOISE) == pytest.approx(2000.0, rel=0.1)


def test_no_typical_particle_where_no_pixel_sees_the_volume_alone():
    where = layout(small_camera("square", pmr=8))
    grid = VoxelGrid.covering((-0.05, 0.05), (-0.05, 0.05), (-3, 3), (0.022, 0.022, 0.1))
    lightfield = LightField(where, np.where(where.seen, 1.0, 0.0).astype(np.float32))
    assert typical_particle(lightfield, PlenopticProjector(where, grid), Noise(0.0)) == 0.0


@pytest.mark.parametrize("spread", [0.0, 1.5])
def test_characteristic_function_of_pixels_that_particles_light_at_random(spread):
    """Two planes, 3 and 1 particles in a pixel, whose weights are .02 and .1."""
    rng, n, turn = np.random.default_rng(3), 400_000, 0.02
    density, weight = np.array([3.0, 1.0]), np.array([0.02, 0.1])
    pixel = np.zeros((2, n))
    for k in range(2):
        number = rng.poisson(density[k], (2, n))
        owner = np.repeat(np.arange(2 * n), number.ravel())
        light = rng.poisson(log_normal(rng, spread, 600.0)(owner.size) * weight[k] / 0.5) * 0.5
        pixel += np.bincount(owner, light, 2 * n).reshape(2, n)
    measured = exponent(Differences(pixel[0] - pixel[1], pixel[1], np.zeros(n, int)), turn)
    expected = density @ of_typical._turned(turn, 600.0, spread, weight, 0.5)
    assert measured == pytest.approx(expected, rel=0.02)


def test_a_small_turn_tells_the_second_moment_and_equal_light_its_cosine():
    weight = np.array([0.01, 0.2])
    small = of_typical._turned(1e-5, 300.0, 1.0, weight, 0.5)
    np.testing.assert_allclose(small, 0.5e-10 * (300.0**2 * 2.0 * weight**2 + 0.5 * 300.0 * weight), rtol=1e-3)
    np.testing.assert_allclose(of_typical._turned(0.05, 300.0, 0.0, weight, 0.0), 1 - np.cos(15.0 * weight))


def test_blocks_of_different_density_count_by_their_mean():
    rng, n = np.random.default_rng(4), 200_000
    dense, thin = rng.normal(0, 2.0, n), rng.normal(0, 1.0, n)
    between = Differences(np.concatenate([dense, thin]), np.zeros(2 * n), np.repeat([0, 7], n))
    assert exponent(between, 0.5) == pytest.approx(0.5 * 0.5**2 * (4.0 + 1.0) / 2 / 2, rel=0.02)


@pytest.mark.parametrize(
    ("lit", "ppm"), [((1.0, 0.25), 4.0), ((1.0, 0.33), 4.0), ((0.25, 1.0), 1.0), ((1.0, 0.7), 4.0)]
)
def test_a_sheet_narrower_than_the_field_does_not_make_particles_differ(lit, ppm):
    lightfield, projector = recording(lit, ppm)
    assert not differences(lightfield, projector).even
    assert typical_particle(lightfield, projector, NOISE) == moments(lightfield, projector, NOISE).light


@pytest.mark.parametrize("stray", [0.0, 8.0, 32.0])
def test_stray_light_does_not_make_particles_differ(stray):
    lightfield, projector = recording((1.0, 1.0), 1.0, stray=stray)
    assert differences(lightfield, projector).even
    assert typical_particle(lightfield, projector, NOISE) == moments(lightfield, projector, NOISE).light


@pytest.mark.parametrize("stray", [0.0, 32.0])
def test_stray_light_is_no_light_of_particles_that_differ_widely(stray):
    """Its mean is twice the particles'."""
    lightfield, projector = recording((1.0, 1.0), 1.0, spread=1.0, stray=stray)
    light = typical_particle(lightfield, projector, NOISE) * projector.light_in_focus
    assert light == pytest.approx(0.4 * 400.0, rel=0.2)


@pytest.mark.parametrize(("ppm", "spread"), [(0.1, 0.0), (0.1, 0.5), (0.25, 0.25), (0.25, 0.5)])
def test_nor_does_stray_light_in_thin_seeding(ppm, spread):
    """No pixel is dark enough to tell the noise of a dark one."""
    lightfield, projector = recording((1.0, 1.0), ppm, spread, stray=64.0)
    noise = Noise(dark_noise(lightfield), 0.4)
    assert differences(lightfield, projector).even
    assert typical_particle(lightfield, projector, noise) == moments(lightfield, projector, noise).light


@pytest.mark.parametrize("stray", [0.0, 1.0, 30.0, 400.0])
@pytest.mark.parametrize("noise", [Noise(0.3, 0.4), Noise(2.0, 0.4), Noise(2.0, 0.0)])
def test_counts_that_all_pixels_have(stray, noise):
    std = np.hypot(noise.dark, np.sqrt(noise.counts_per_electron * stray))
    lowest = np.percentile(np.random.default_rng(5).normal(stray, std, 400_000), LOWEST)
    assert of_all_pixels(lowest, noise) == pytest.approx(stray, abs=0.03 * std + 1.2 * noise.counts_per_electron)
    assert of_all_pixels(-30.0, noise) == 0.0


def test_stray_light_that_is_taken_off_leaves_its_noise():
    assert Moments(10.0, 300.0, 4.0).without(5.0, 0.4) == (5.0, 600.0, 6.0)


def test_few_differences_and_dark_blocks_are_not_asked():
    block, level = np.arange(FEWEST) % BLOCKS**2, np.ones(FEWEST)
    assert Differences(np.zeros(FEWEST), level, block).even
    assert not Differences(np.zeros(FEWEST - 1), level[1:], block[1:]).even
    assert not Differences(np.zeros(FEWEST), np.where(block < 5, 0.3, 1.0), block).even
    assert Differences(np.zeros(FEWEST), np.where(block < 3, 0.3, 1.0), block).even
    assert not Differences(np.zeros(FEWEST), np.where(block < 30, 0.3, 1.0), block).even
