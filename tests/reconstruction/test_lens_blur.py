"""The main lens' blur from particles: found within 20 %, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import LightField, decode, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.lens_blur import FARTHEST, Lag, LensBlur, lags_of, lens_blur, model, parts_of
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.volume import VoxelGrid

RNG = np.random.default_rng(5)
VOLUME_MM = ((-1.7, 1.7), (-1.3, 1.3), (-2.5, 2.5))


def camera_of(kind):
    return small_camera(kind, microlenses=(57, 46), rotation_rad=0.002, offset_mm=(0.02, -0.01))


def frame_and_projector(blur_mm, kind="hexagonal", lit_mm=VOLUME_MM, seed=0, ppm=1.0, brighter=()):
    """A frame of particles in ``lit_mm`` through a camera of a blur, and a projector that takes it as sharp.
    ``brighter``: which share of the particles has how many times the light of the others."""
    camera, rng = camera_of(kind), np.random.default_rng(seed)
    light = {"electrons": None, "electrons_per_pixel": 400.0, "electrons_spread": 0.25}
    particles = seed_box(camera, lit_mm, ppm, rng, **light)
    if brighter:
        share, times = brighter
        few = np.random.default_rng(seed + 9).random(len(particles.electrons)) < share
        particles = replace(particles, electrons=np.where(few, times, 1.0) * particles.electrons)
    image = particle_image(replace(camera, blur_mm=blur_mm), particles, rays=1000, seed=seed)
    frame = digitise(image + 4.0, camera.sensor, SensorNoise(), rng)
    where, grid = layout(camera), VoxelGrid.covering(*VOLUME_MM, (0.017, 0.017, 0.077))
    return decode(frame, where), PlenopticProjector(where, grid, "1-ray")


@pytest.mark.parametrize(
    ("blur_mm", "kind"),
    [
        (0.02, "hexagonal"),
        pytest.param(0.04, "square", marks=pytest.mark.full),
        pytest.param(0.04, "hexagonal", marks=pytest.mark.full),
        pytest.param(0.02, "square", marks=pytest.mark.full),
    ],
)
def test_blur_is_found(blur_mm, kind):
    found = lens_blur(*frame_and_projector(blur_mm, kind))
    assert found.beyond_doubt(0.077) == found.blur_mm == pytest.approx(blur_mm, rel=0.2)
    assert 0.0 < found.std_mm < 0.005
    assert found.left < 0.3


@pytest.mark.parametrize(
    ("kind", "seed"), [("hexagonal", 1), pytest.param("hexagonal", 0, marks=pytest.mark.full), ("square", 0)]
)
def test_no_blur_is_found_where_there_is_none(kind, seed):
    found = lens_blur(*frame_and_projector(0.0, kind, seed=seed))
    assert found.beyond_doubt(0.077) == 0.0
    assert found.blur_mm < 0.01


@pytest.mark.parametrize(
    "blur_mm", [0.02, pytest.param(0.0, marks=pytest.mark.full), pytest.param(0.04, marks=pytest.mark.full)]
)
def test_saturated_particles_do_not_look_like_blur(blur_mm):
    """28 um of 20 were found, and 47 of 40."""
    frame, projector = frame_and_projector(blur_mm, brighter=(0.003, 100.0))
    sensor = frame.layout.camera.sensor
    assert np.count_nonzero(frame.values >= sensor.full_scale - sensor.black_level) > 100
    found = lens_blur(frame, projector)
    assert found.beyond_doubt(0.077) == pytest.approx(blur_mm, rel=0.1)


def test_light_that_saturates_many_alike_hides_no_blur():
    """Without their microlenses, half of all, 14 um of 20 are found."""
    frame, projector = frame_and_projector(0.02, brighter=(1.0, 5.0))
    assert lens_blur(frame, projector).beyond_doubt(0.077) == pytest.approx(0.02, rel=0.1)


@pytest.mark.full
@pytest.mark.parametrize("lit_z_mm", [(-0.5, 0.5), (1.0, 2.5)])
def test_how_particles_are_spread_over_depth_need_not_be_known(lit_z_mm):
    found = lens_blur(*frame_and_projector(0.03, lit_mm=(*VOLUME_MM[:2], lit_z_mm)))
    assert found.blur_mm == pytest.approx(0.03, rel=0.2)


@pytest.mark.parametrize(
    ("blur_mm", "half_x_mm", "half_y_mm", "ppm", "kind"),
    [
        (0.0, 0.85, 1.3, 3.0, "hexagonal"),  # 26 um were found where microlenses at edges were not left out
        (0.02, 0.85, 1.3, 3.0, "hexagonal"),  # 53 um were
        pytest.param(0.0, 0.85, 0.65, 1.0, "square", marks=pytest.mark.full),
        pytest.param(0.03, 0.5, 1.3, 1.0, "square", marks=pytest.mark.full),
    ],
)
def test_particles_may_fill_a_part_of_the_volume(blur_mm, half_x_mm, half_y_mm, ppm, kind):
    """As a laser sheet that is narrower than the field."""
    lit_mm = (-half_x_mm, half_x_mm), (-half_y_mm, half_y_mm), VOLUME_MM[2]
    found = lens_blur(*frame_and_projector(blur_mm, kind, lit_mm, ppm=ppm))
    assert found.beyond_doubt(0.077) == pytest.approx(blur_mm, rel=0.2)


@pytest.mark.parametrize(
    ("low_mm", "high_mm", "blur_mm"),
    [(0.2, 0.65, 0.02), pytest.param(-0.45, 0.45, 0.03, marks=pytest.mark.full)],
)
def test_particles_may_lie_in_a_few_rows(low_mm, high_mm, blur_mm):
    """A quarter of the rows, beside the middle, and a third in it: parts whose scatter gives the error are of what is
    lit. So few are told too wide."""
    found = lens_blur(*frame_and_projector(blur_mm, lit_mm=(VOLUME_MM[0], (low_mm, high_mm), VOLUME_MM[2])))
    assert found.blur_mm == found.beyond_doubt(0.077) == pytest.approx(blur_mm, rel=0.5)
    assert 0 < found.std_mm < 0.006


def test_parts_have_as_many_microlenses_each():
    microlenses = np.array([0, 0, 1, 4, 4, 4, 4, 0, 4, 4, 3, 0])
    parts = parts_of(microlenses)
    assert [microlenses[rows].sum() for rows in parts] == [5, 8, 8, 7]
    assert np.concatenate(parts).tolist() == [2, 3, 4, 5, 6, 7, 8, 9, 10, 11]


@pytest.mark.full
def test_what_the_camera_states_makes_no_difference():
    field, projector = frame_and_projector(0.03)
    stated = layout(replace(field.layout.camera, blur_mm=0.05))
    other = PlenopticProjector(stated, projector.grid, "1-ray")
    assert lens_blur(LightField(stated, field.values), other) == lens_blur(field, projector)


def test_a_narrow_sensor_tells_nothing():
    camera = small_camera("hexagonal", microlenses=(5, 100))
    x, y = 0.077 * 5 / 2, 0.077 * 100 / 2
    where, grid = layout(camera), VoxelGrid.covering((-x, x), (-y, y), (-0.5, 0.5), (0.017, 0.017, 0.077))
    frame = digitise(np.full((camera.sensor.rows, camera.sensor.columns), 9.0), camera.sensor, SensorNoise(), RNG)
    assert lens_blur(decode(frame, where), PlenopticProjector(where, grid, "1-ray")) is None


def test_a_small_volume_tells_nothing():
    field, projector = frame_and_projector(0.03)
    grid = VoxelGrid.covering((-0.2, 0.2), (-0.2, 0.2), (-2.5, 2.5), projector.grid.voxel_mm)
    assert lens_blur(field, PlenopticProjector(field.layout, grid, "1-ray")) is None


def with_microlenses(pixels, blur_pitches=0.0):
    """A camera with microlenses of so many pixels across, and a main lens that blurs by so many pitches."""
    camera = camera_of("hexagonal")
    pitch_mm = pixels * camera.sensor.pixel_pitch_mm
    return replace(camera, lattice=replace(camera.lattice, pitch_mm=pitch_mm), blur_mm=blur_pitches * pitch_mm)


@pytest.mark.parametrize(("blur_pitches", "iterations"), [(0.0, 5), (0.13, 10), (0.26, 15), (0.52, 25)])
def test_a_blur_takes_more_iterations(blur_pitches, iterations):
    assert ReconstructionSettings().through(with_microlenses(14.0, blur_pitches)).iterations == iterations


@pytest.mark.parametrize(
    ("pixels", "iterations"), [(28.0, 5), (14.0, 5), (13.5, 5), (12.0, 10), (10.0, 20), (8.0, 45), (6.0, 45)]
)
def test_few_views_take_more_iterations(pixels, iterations):
    assert ReconstructionSettings().through(with_microlenses(pixels)).iterations == iterations
    blurred = with_microlenses(pixels, 0.26)
    assert ReconstructionSettings(iterations=2).through(blurred).iterations == 2 * 3 * iterations // 5


def test_doubt():
    assert LensBlur(0.02, 0.001, 0.1).beyond_doubt(0.077) == 0.02
    assert LensBlur(0.02, 0.007, 0.1).beyond_doubt(0.077) == 0.0
    assert LensBlur(0.009, 0.001, 0.1).beyond_doubt(0.077) == 0.0
    assert LensBlur(0.016, 0.001, 0.4).beyond_doubt(0.077) == 0.0
    assert LensBlur(0.016, 0.001, 0.2).beyond_doubt(0.077) == 0.016


@pytest.mark.parametrize("z_mm", [2.5, 10.0])
def test_planes_of_a_deep_volume_lie_as_close_as_those_of_a_thin_one(z_mm):
    """Light of particles between planes further apart than a dead zone looks blurred."""
    camera = camera_of("hexagonal")
    near, far = camera.dead_zone_mm()
    grid = VoxelGrid.covering((-1, 1), (-1, 1), (-z_mm, z_mm), (0.1, 0.1, 0.1))
    deep = model(layout(camera), grid, [(7, 0)], lags_of(camera)[:1], np.zeros(1))
    assert 1.4 * 2 * z_mm / deep.shape[2] < 0.65 * (far - near)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_lags_lead_from_microlens_to_microlens(kind):
    """Each lag from a row of each kind to the microlens that is as far away as it says."""
    camera = camera_of(kind)
    lattice = replace(camera, lattice=replace(camera.lattice, rotation_rad=0.0)).lattice
    lags = lags_of(camera)
    assert len(set(lags)) == len(lags)
    assert Lag(0, 0) in lags
    for lag in lags:
        for j in (0, 1):
            to = lag.columns(j if kind == "hexagonal" else 0), j + lag.across
            (s0, t0), (s1, t1) = lattice.centres(0, j), lattice.centres(*to)
            away = np.array([s1 - s0, t1 - t0]) / lattice.pitch_mm
            np.testing.assert_allclose(away, (lag.along, lag.across * lattice.row_spacing), atol=1e-9)
            assert np.hypot(*away) <= FARTHEST
