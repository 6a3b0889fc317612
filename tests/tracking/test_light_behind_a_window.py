"""Light of particles behind water and a window, where rays fall beside a thin lens': against the simulation's rays.

The lens of lens space is at the exit pupil; the simulated camera has its stop in front of the lens. No calibration
comes between: the rays' model has the simulated camera's numbers.
"""

import numpy as np
import pytest

from plenopiv.cameras.lens_space import space_map
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import real_particle_image
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.light import PointLights
from plenopiv.tracking.pixels import Pixels
from plenopiv.tracking.refine import Prior, refine

SENSOR = Sensor(400, 400, 0.0055, 12, 60)
LATTICE = Lattice("hexagonal", 0.077, 0.0053, (0.0237, 0.0012))
WATER = Medium(1.333, 41.0, 10.0, 1.52)
REAL = RealCamera(50.0, 100.0, 11.0, LATTICE, 0.308, SENSOR, stop_mm=12.0, medium=WATER)
WIDE = 2.0 * REAL.micro_image_radius_mm * REAL.exit_pupil_mm / 0.308
CAMERA = PlenopticCamera(MainLens(REAL.exit_pupil_mm / 2.0, WIDE, -1.0), LATTICE, 0.308, SENSOR)
VOXEL_MM = np.array([0.017, 0.017, 0.107])
ELECTRONS, READ_NOISE = 6e4, 3.0


@pytest.fixture(scope="module")
def space():
    corner = 0.5 * SENSOR.pixel_pitch_mm * float(np.hypot(SENSOR.columns, SENSOR.rows))
    model = RayModel(50.0, 100.0, REAL.air_mm, WATER, REAL.exit_pupil_mm, corner)
    return space_map(model, CAMERA, ((-1.1, 1.1), (-1.1, 1.1), (-5.8, 5.8)))


def full(*places):
    return [pytest.param(place, marks=pytest.mark.full) for place in places]


@pytest.mark.parametrize(
    "place",
    [(0.1, 0.05, -0.9), (-0.2, 0.15, 1.2), *full((0.3, 0.4, 0.9), (0.05, -0.1, 3.1), (-0.1, 0.2, -4.9), (0, 0.3, -2))],
)
def test_light_and_place_are_those_of_rays(space, place):
    """Pixels differ by far less than their noise, and the place fitted to light without noise is the true one: to 0.005
    voxel in the plane, and to 0.04 in depth, where noise leaves 0.02 and more."""
    image = real_particle_image(
        REAL, Particles(np.array([place], float), np.ones(1)), rays=300_000, diffraction_nm=532.0, seed=1
    )
    of_points = PointLights(CAMERA, left=space.left)
    pixels = Pixels(ELECTRONS * image.ravel(), np.ones(image.size, bool), READ_NOISE**2, 1.0)
    start = space.to_lens(np.array([place], float))
    fit = refine(of_points, pixels, start, np.array([ELECTRONS]), Prior(start, np.full(3, 1e3)), 0)
    lit = np.unique(fit.lights.pixel)
    assert np.mean(fit.residual[lit] ** 2 / fit.variance[lit]) < 0.2
    fit = refine(of_points, pixels, start, np.array([ELECTRONS]), Prior(start, np.full(3, 1e3)), 6)
    error = np.abs(space.to_laboratory(fit.position_mm)[0] - place) / VOXEL_MM
    assert (error < (0.005, 0.005, 0.04)).all()
    assert fit.light[0] == pytest.approx(ELECTRONS, rel=1e-3)


@pytest.mark.parametrize("place", [(0.1, 0.05, -0.9), (-0.2, 0.15, 1.2), (0.05, -0.1, 3.1)])
@pytest.mark.parametrize("axis", range(3))
def test_gradients_are_differences_of_shares(space, place, axis):
    of_points = PointLights(CAMERA, left=space.left)
    at = space.to_lens(np.array(place, float))
    move = np.eye(3)[axis] * (1e-4, 1e-4, 5e-4)[axis]
    pixels = SENSOR.columns * SENSOR.rows

    def image(lights, values):
        return np.bincount(lights.pixel, values, pixels)

    ahead, behind, here = of_points([at + move]), of_points([at - move]), of_points([at])
    difference = (image(ahead, ahead.share) - image(behind, behind.share)) / (2.0 * move[axis])
    missed = np.linalg.norm(image(here, here.gradient[:, axis]) - difference)
    assert missed < 0.015 * np.linalg.norm(difference)


def test_all_light_is_somewhere(space):
    """In focus too, where rays of a point cross."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (600, 2)), rng.uniform(-0.6, 0.6, 600)])
    light = PointLights(CAMERA, left=space.left)(points).whole()
    assert light == pytest.approx(np.ones(600), abs=1e-3)


@pytest.mark.full
def test_particles_behind_a_window(space):
    """Found from errors as those of MART's peaks, the shot noise stated ten times too large; error bars cover."""
    rng = np.random.default_rng(6)
    count, gain = 260, 0.5
    place = rng.uniform((-0.8, -0.8, -5.0), (0.8, 0.8, 5.0), (count, 3))
    particles = Particles(place, rng.uniform(4e4, 8e4, count))
    light = real_particle_image(REAL, particles, rays=80_000, diffraction_nm=532.0, seed=3) + 4.0
    counts = digitise(light, SENSOR, SensorNoise(gain=gain, read_noise_electrons=READ_NOISE), rng)
    pixels = Pixels.of_image(counts, 60.0, 4095, 1.0, 10.0 * gain)
    known = rng.random(count) > 0.08
    start = space.to_lens(place[known] + rng.normal(0.0, (0.15, 0.15, 0.25), (known.sum(), 3)) * VOXEL_MM)
    limits = ((-0.85, 0.85), (-0.85, 0.85), (-4.2, 4.2))
    of_points = PointLights(CAMERA, left=space.left)
    found = particles_of_frame(of_points, pixels, start, np.full(len(start), 3e4), limits)
    at = space.to_laboratory(found.position_mm)
    off = (at[:, None] - place) / VOXEL_MM
    near = (np.hypot(off[..., 0], off[..., 1]) < 1) & (np.abs(off[..., 2]) < 2)
    beyond = np.abs(space.to_lens(place)[:, 2]) > 0.46
    whole = of_points(space.to_lens(place)).whole() > 0.999
    assert near.any(0)[beyond & whole].mean() >= 0.95
    assert (~near.any(1) & (np.abs(found.position_mm[:, 2]) > 0.46)).sum() <= 0.02 * count
    first, second = np.nonzero(near & (beyond & whole))
    error = off[first, second]
    turned = space.to_laboratory.jacobian(found.position_mm)
    covariance = turned @ found.covariance[:, :3, :3] @ np.swapaxes(turned, 1, 2)
    std = np.sqrt(np.einsum("nii->ni", covariance))[first] / VOXEL_MM
    assert (np.median(np.abs(error), 0) < (0.02, 0.02, 0.05)).all()
    within = (np.abs(error) < std).mean(0), (np.abs(error) < 2 * std).mean(0)
    assert ((within[0] > 0.55) & (within[0] < 0.85)).all()
    assert (within[1] > 0.86).all()
