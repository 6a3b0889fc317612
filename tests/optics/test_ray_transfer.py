"""The matrices of Eqs. 1-5, multiplied ray by ray, against the two scalar relations that everything else uses."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv import optics
from plenopiv.cameras.plenoptic import MainLens
from plenopiv.cameras.presets import preset

CAMERA = preset("pmr14")


@pytest.mark.parametrize("magnification", [-1.0, -0.5, -1.4])
def test_matrices_multiplied_out_give_the_scalar_relations(magnification):
    camera = replace(CAMERA, main_lens=MainLens(50.0, 25.0, magnification))
    lens, f_l, e = camera.main_lens, camera.microlens_focal_length_mm, camera.image_scale
    rng = np.random.default_rng(3)
    for _ in range(50):
        x, y, z = rng.uniform([-15, -10, -10], [15, 10, 10])
        slopes = rng.uniform(-0.15, 0.15, 2)
        at_lens = optics.propagation(lens.object_distance_mm - z) @ [x, y, *slopes]  # Eq. 1
        u, v = at_lens[:2]
        refracted = optics.thin_lens(lens.focal_length_mm) @ at_lens  # Eq. 2
        on_array = optics.propagation(lens.image_distance_mm) @ refracted  # Eq. 3
        s, t = on_array[:2]
        a, b = camera.spread(z), camera.scale(z)
        np.testing.assert_allclose([s, t], [a * u + b * x, a * v + b * y], atol=1e-12)

        centre = np.array(camera.lattice.centres(*camera.lattice.nearest(s, t)))
        behind = optics.thin_lens(f_l) @ on_array + optics.microlens_offset(centre, f_l)  # Eq. 4
        hit = optics.propagation(f_l) @ behind  # Eq. 5
        want = centre * (1 + e) + e * (np.array([s, t]) - centre - [u, v])
        np.testing.assert_allclose(hit[:2], want, atol=1e-12)


def test_conjugate_distances_image_the_focal_plane():
    for magnification in (-1.0, -0.5, -0.37, -2.0):
        so, si = optics.conjugate_distances(50.0, magnification)
        assert 1 / so + 1 / si == pytest.approx(1 / 50.0)
        assert optics.magnification(si, so) == pytest.approx(magnification)
        assert optics.spread(0.0, so, si, 50.0) == pytest.approx(0.0, abs=1e-14)
        assert optics.scale(0.0, so, si) == pytest.approx(magnification)
    assert optics.conjugate_distances(50.0, -1.0) == pytest.approx((100.0, 100.0))


def test_signs_of_spread_and_scale():
    """A point nearer to the camera (z > 0) comes to focus behind the microlenses: the rays still lie on u's side."""
    assert CAMERA.spread(2.0) > 0 > CAMERA.spread(-2.0)
    assert CAMERA.scale(2.0) < CAMERA.scale(0.0) < CAMERA.scale(-2.0) < 0


def test_figures_of_the_papers_camera():
    assert CAMERA.image_pitch_px == pytest.approx(14.0 * (1 + 0.308 / 100.0))  # 14.043, not 14
    assert CAMERA.matched_aperture_mm == pytest.approx(25.0)
    assert CAMERA.pixels_per_microlens == pytest.approx(14.0)
    # matched f-numbers: the aperture's images are a microlens pitch wide, a pixel is P_m/PMR of the main lens
    assert 2 * CAMERA.aperture_radius_px == pytest.approx(14.0)
    assert CAMERA.portion_mm == pytest.approx(25.0 / 14.0)


def test_dead_zone_of_the_papers_camera():
    low, high = CAMERA.dead_zone_mm()
    assert low == pytest.approx(-0.308, abs=0.002)
    assert high == pytest.approx(0.308, abs=0.002)
    half = replace(CAMERA, main_lens=MainLens(50.0, 75.0 * 0.077 / 0.308, -0.5)).dead_zone_mm()
    assert half == pytest.approx((-0.308 / 0.25, 0.308 / 0.25), abs=0.02)
    # by definition: where the blur is one pitch wide
    for z in (low, high):
        assert abs(CAMERA.spread(z)) * CAMERA.main_lens.aperture_mm == pytest.approx(0.077)
