"""White images against areas and brute sampling; counts against the noise model's mean and variance."""

import numpy as np
import pytest

from plenopiv.cameras.presets import preset
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.simulation.white import white_image

TURNED = preset("pmr14").with_lattice(Lattice("hexagonal", 0.077, 0.02, (0.013, -0.027)))


def sampled_white(camera, columns, rows, n=40):
    """Shares of pixels inside any number of aperture images, by n x n points in each."""
    sub = (np.arange(n) + 0.5) / n - 0.5
    column, row = np.meshgrid((columns[:, None] + sub).ravel(), (rows[:, None] + sub).ravel())
    i, j = np.meshgrid(np.arange(-25, 26), np.arange(-25, 26))
    s, t = (c * (1 + camera.image_scale) for c in camera.lattice.centres(i, j))
    centres = np.stack(camera.sensor.pixel_from_plane(s, t), -1).reshape(-1, 2)
    near = np.abs(centres - (columns.mean(), rows.mean())).max(1) < 0.5 * len(columns) + 2 * camera.aperture_radius_px
    lit = np.zeros(column.shape)
    for c, r in centres[near]:
        lit += (column - c) ** 2 + (row - r) ** 2 < camera.aperture_radius_px**2
    return lit.reshape(len(rows), n, len(columns), n).mean((1, 3))


@pytest.mark.parametrize(
    "camera",
    [TURNED, preset("pmr8", aperture="table"), preset("pmr28", aperture="table")],
    ids=["turned hexagonal", "overlapping", "apart"],
)
def test_white_is_the_area_of_the_aperture_images(camera):
    columns, rows = np.arange(60, 80), np.arange(300, 316)
    image = white_image(camera, 1.0)[np.ix_(rows, columns)]
    assert image == pytest.approx(sampled_white(camera, columns, rows), abs=0.02)


def test_mean_is_the_disc_s_share_of_a_cell():
    image = white_image(TURNED, 1000.0)
    cell_px = TURNED.image_pitch_px**2 * np.sqrt(3) / 2
    assert image.mean() == pytest.approx(1000.0 * np.pi * TURNED.aperture_radius_px**2 / cell_px, rel=3e-3)
    assert image.max() == pytest.approx(1000.0)


def test_micro_images_are_centred_on_the_stretched_lattice():
    """Centres at S (1 + e), not at S: at lens (12, -9) that is 0.6 px away."""
    image = white_image(TURNED, 1.0)
    s, t = TURNED.lattice.centres(np.array([0, 12, -8]), np.array([0, -9, 11]))
    scale = 1 + TURNED.image_scale
    for c, r in zip(*TURNED.sensor.pixel_from_plane(s * scale, t * scale), strict=True):
        rows, columns = np.indices(image.shape)
        own = np.hypot(columns - c, rows - r) < 0.5 * TURNED.image_pitch_px + 0.3  # a sliver of neighbours all around
        assert (columns * image)[own].sum() / image[own].sum() == pytest.approx(c, abs=0.06)
        assert (rows * image)[own].sum() / image[own].sum() == pytest.approx(r, abs=0.06)


def test_falloff_darkens_the_corners_alone():
    even, vignetted = white_image(TURNED, 1.0), white_image(TURNED, 1.0, falloff=0.4)
    ratio = vignetted[even > 0] / even[even > 0]
    assert ratio.max() == pytest.approx(1.0, abs=1e-4)
    assert ratio.min() == pytest.approx(0.6, abs=0.01)
    with pytest.raises(PlenoPIVError, match="falloff"):
        white_image(TURNED, 1.0, falloff=1.5)


@pytest.mark.parametrize("nm", [532.0, 3000.0])
def test_diffraction_blurs_a_white_image_and_keeps_its_light(nm):
    sharp, blurred = white_image(TURNED, 1.0), white_image(TURNED, 1.0, diffraction_nm=nm)
    assert blurred.mean() == pytest.approx(sharp.mean(), rel=1e-3)
    assert blurred.std() < sharp.std()


SENSOR = Sensor(400, 300, 0.0055, 12, 60)


@pytest.mark.parametrize("electrons", [0.0, 20.0, 1500.0])
def test_counts_have_the_model_s_mean_and_variance(electrons):
    noise = SensorNoise(gain=0.5, read_noise_electrons=8.0)
    counts = digitise(np.full((300, 400), electrons), SENSOR, noise, np.random.default_rng(0)).astype(float)
    variance = 0.25 * (electrons + 64.0) + 1 / 12
    assert counts.mean() == pytest.approx(60 + 0.5 * electrons, abs=4 * np.sqrt(variance / counts.size))
    assert counts.var() == pytest.approx(variance, rel=0.02)


def test_counts_saturate_and_stop_at_zero():
    noise = SensorNoise(gain=2.0, read_noise_electrons=100.0)
    bright = digitise(np.full((300, 400), 1e5), SENSOR, noise, np.random.default_rng(0))
    dark = digitise(np.zeros((300, 400)), SENSOR, noise, np.random.default_rng(0))
    assert (bright == 4095).all()
    assert dark.min() == 0
    assert dark.dtype == np.uint16


def test_sensor_orientation_is_upright_turned_by_180_degrees():
    light = np.arange(12.0).reshape(3, 4) * 100
    noise = SensorNoise(gain=1.0, read_noise_electrons=0.0, shot=False)
    sensor = Sensor(4, 3, 0.0055, 12, 0)
    stored = digitise(light, sensor, noise, np.random.default_rng(0), "sensor")
    assert np.array_equal(stored, np.rot90(light, 2))


def test_bad_noise_is_named():
    with pytest.raises(PlenoPIVError, match="gain"):
        SensorNoise(gain=0.0)
    with pytest.raises(PlenoPIVError, match="read_noise"):
        SensorNoise(read_noise_electrons=-1.0)
    with pytest.raises(PlenoPIVError, match="20 bits"):
        digitise(np.zeros((2, 2)), Sensor(2, 2, 0.0055, 20, 0), SensorNoise(), np.random.default_rng(0))
