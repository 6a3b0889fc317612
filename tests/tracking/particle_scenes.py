"""A small camera, and images of particles before it."""

import numpy as np

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles, seed_box
from plenopiv.simulation.sensor_noise import SensorNoise, digitise
from plenopiv.tracking.pixels import Pixels

CAMERA = PlenopticCamera(
    MainLens(50.0, 25.0, -1.0),
    Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)),
    0.308,
    Sensor(220, 220, 0.0055, 12, 60),
)
VOXEL_MM = np.array([0.017, 0.017, 0.077])
GAIN = SensorNoise().gain
LIMITS = ((-0.35, 0.35), (-0.35, 0.35), (-2.5, 2.5))


def seeded(ppm=1.0, seed=3, limits=LIMITS):
    """Particles at random."""
    rng = np.random.default_rng(seed)
    return seed_box(CAMERA, limits, ppm, rng, electrons_per_pixel=400.0, electrons_spread=0.25)


def noisy(position_mm, electrons, seed=3, background=4.0):
    """Counts of an image of particles."""
    light = particle_image(CAMERA, Particles(position_mm, electrons), rays=80_000, diffraction_nm=532.0, seed=seed)
    return digitise(light + background, CAMERA.sensor, SensorNoise(), np.random.default_rng(seed + 100))


def pixels_of(counts):
    """The same as the fit takes them."""
    return Pixels.of_image(counts, 60.0, 4095, 1.5, GAIN)


def nearest(truth_mm, found_mm):
    """Of each true particle the found one within a voxel in the plane and two in depth, -1 for none, one to one."""
    from scipy.optimize import linear_sum_assignment

    off = (found_mm[None] - truth_mm[:, None]) / VOXEL_MM
    near = (np.hypot(off[..., 0], off[..., 1]) <= 1) & (np.abs(off[..., 2]) <= 2)
    cost = np.where(near, (off**2).sum(2), 1e3)
    out = np.full(len(truth_mm), -1)
    for t, f in zip(*linear_sum_assignment(cost), strict=True):
        if near[t, f]:
            out[t] = f
    return out
