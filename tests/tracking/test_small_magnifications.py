"""Particles before cameras that make large fields small: how far light moves goes with M across, with M^2 in depth."""

import numpy as np
import pytest
from particle_scenes import GAIN

from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.tracking.frame import particles_of_frame
from plenopiv.tracking.light import UNIT_MM, PointLights, unit_mm
from plenopiv.tracking.pixels import Pixels

F_MM, LIGHT = 50.0, 60_000.0


def camera_of(magnification):
    behind = F_MM * (1 - magnification)
    lens = MainLens(F_MM, behind * 0.077 / 0.308, magnification)
    return PlenopticCamera(
        lens, Lattice("hexagonal", 0.077, 0.002, (0.02, -0.01)), 0.308, Sensor(220, 220, 0.0055, 12, 60)
    )


@pytest.mark.parametrize("magnification", [-1.0, -0.1])
def test_particles_are_found_alike(magnification):
    """One for each that is there, within its error bars, from half a voxel across and one in depth away."""
    camera, rng, n = camera_of(magnification), np.random.default_rng(0), 40
    size = np.array([1 / abs(magnification), 1 / abs(magnification), 1 / magnification**2])
    of_points, voxel = PointLights(camera), [0.017, 0.017, 0.077] * size
    np.testing.assert_allclose(of_points.unit_mm, UNIT_MM * size)
    z = size[2] * rng.uniform(1.0, 2.5, n) * rng.choice([-1, 1], n)
    lens = camera.main_lens
    aside = (lens.object_distance_mm - z[:, None]) / lens.image_distance_mm  # of a place on the microlens plane
    true = np.column_stack([rng.uniform(-0.35, 0.35, (n, 2)) * aside, z])
    image = np.zeros(220 * 220)
    of_points(true).add_to(image, np.full(n, LIGHT))
    counts = GAIN * rng.poisson((image + 4.0) / GAIN) + 60 + rng.normal(0, 1.5, image.size)
    guess = true + rng.uniform([-0.5, -0.5, -1], [0.5, 0.5, 1], (n, 3)) * voxel
    limits = tuple((-edge * s, edge * s) for edge, s in zip((0.6, 0.6, 3.0), size, strict=True))
    pixels = Pixels.of_image(counts.reshape(220, 220), 60.0, 65535, 1.5, GAIN)
    found = particles_of_frame(of_points, pixels, guess, LIGHT * rng.uniform(0.7, 1.3, n), limits)
    assert (found.light > 0.01 * LIGHT).sum() == n
    assert len(found.light) < 1.1 * n  # faint ones at the sensor's rim
    nearest = np.abs((found.position_mm[None] - true[:, None]) / voxel).max(2).argmin(1)
    std = np.sqrt(np.einsum("nii->ni", found.covariance[nearest]))[:, :3]
    assert (np.abs(found.position_mm[nearest] - true) < 2 * std).mean(0) == pytest.approx(0.95, abs=0.1)
    assert np.median(found.misfit) == pytest.approx(1.0, abs=0.15)


def test_units_follow_the_magnification():
    np.testing.assert_array_equal(unit_mm(camera_of(-1.0)), UNIT_MM)
    np.testing.assert_allclose(unit_mm(camera_of(-0.5)), UNIT_MM * [2.0, 2.0, 4.0])
