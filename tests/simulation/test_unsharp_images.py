"""Images through a main lens that is not sharp against integrals over the aperture."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.unsharp_light import unsharp_point_image

from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.real_images import real_particle_image
from plenopiv.simulation.white import white_image

POINTS = ((0.003, 0.002, -0.4), (0.11, -0.07, 0.0), (0.05, -0.03, 1.0))
RAYS = 1_000_000


def unsharp(blur_mm):
    return replace(small_camera(offset_mm=(0.013, -0.027)), blur_mm=blur_mm)


def traced_thin(camera, particle):
    return particle_image(camera, particle, rays=RAYS)


def traced_real(camera, particle):
    return real_particle_image(RealCamera.of(camera), particle, rays=RAYS)


@pytest.mark.parametrize("traced", [traced_thin, traced_real])
@pytest.mark.parametrize("blur_mm", [0.02, 0.04])
def test_rays_are_the_light(blur_mm, traced):
    """No further off than the number of rays that hit a pixel by chance."""
    camera = unsharp(blur_mm)
    for point in POINTS:
        want = unsharp_point_image(camera, point)
        image = traced(camera, Particles(np.array([point]), np.ones(1), 0.0))
        lit = want * RAYS > 100
        chance = (image - want)[lit] / np.sqrt(want[lit] / RAYS)
        assert lit.sum() > 500
        assert image.sum() == pytest.approx(want.sum(), abs=1e-3)
        assert np.sqrt(np.mean(chance**2)) < 1.1


def test_another_blur_is_told_apart():
    want = unsharp_point_image(unsharp(0.021), POINTS[2])
    image = traced_thin(unsharp(0.02), Particles(np.array([POINTS[2]]), np.ones(1), 0.0))
    lit = want * RAYS > 100
    assert np.sqrt(np.mean((image - want)[lit] ** 2 / want[lit] * RAYS)) > 1.3


def test_the_white_image_stays_as_it_is():
    np.testing.assert_array_equal(white_image(unsharp(0.0)), white_image(unsharp(0.04)))
