"""Rays through fluid, window and lens: closed forms, limits, and the sign of each axis."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.lens_space import images_of, sample, space_map
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.ray_model import RayModel, on_disc, rotation
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor

CAMERA = PlenopticCamera(MainLens(50.0, 22.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(1200, 960, 0.0055))
AIR = RayModel(50.0, 100.0, 100.0, Medium(), 100.0, 4.2)
WATER = Medium(1.333, 60.0, 10.0, 1.52)
IN_WATER = RayModel(50.0, 100.0, WATER.gap_mm(100.0), WATER, 100.0, 4.2)
BOX = (-3.0, 3.0), (-2.0, 2.0), (-5.0, 5.0)


def test_in_air_lens_space_is_the_laboratory():
    points = sample(BOX)
    found = images_of(points, AIR, CAMERA)
    np.testing.assert_allclose(found.place_mm, points, atol=1e-10)
    assert np.abs(found.left_mm).max() < 1e-12


def test_a_ray_obeys_snell_s_law_at_both_faces():
    """Traced the other way, by the vector form of the law, a ray comes back to where it started."""
    model = replace(IN_WATER, medium=replace(WATER, window_tilt_deg=(2.0, -1.5)))
    points, lens = np.array([[1.2, -0.7, 3.0], [-2.0, 1.0, -4.0]]), np.array([[9.0, -3.0], [-5.0, 8.0]])
    s, _ = model.trace(points, lens)
    normal = rotation(np.radians(2.0), np.radians(-1.5), 0.0)[:, 2]
    inner = np.array([0.0, 0.0, 60.0])
    lens_z = 60.0 + WATER.window_mm / np.cos(np.radians(2.5)) + model.gap_mm

    def refracted(d, n):
        """Direction d, of length 1 in units of index 1, after the face into index n."""
        cosine = d @ normal
        into = n[0] / n[1]
        return into * d + (np.sign(cosine) * np.sqrt(1 - into**2 * (1 - cosine**2)) - into * cosine) * normal

    def onto(at, d, face):
        return at + d * ((face - at) @ normal) / (d @ normal)

    for k in range(2):
        for m in range(2):
            slope = (s[k, m] - lens[m]) / 100.0 + lens[m] / 50.0
            direction = -np.array([*slope, 1.0]) / np.hypot(1.0, np.hypot(*slope))
            at = np.array([*lens[m], lens_z])
            at = onto(at, direction, inner + normal * WATER.window_mm)
            glass = refracted(direction, (1.0, 1.52))
            at = onto(at, glass, inner)
            water = refracted(glass, (1.52, 1.333))
            at = at + water * (points[k, 2] - at[2]) / water[2]
            np.testing.assert_allclose(at, points[k], atol=1e-6)


def test_near_the_axis_depth_shrinks_by_the_index():
    points = np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, 1.0], [0.01, 0, 0]])
    narrow = replace(CAMERA, main_lens=replace(CAMERA.main_lens, aperture_mm=0.1))
    z = images_of(points, IN_WATER, narrow).place_mm
    np.testing.assert_allclose(z[:3, 2], np.array([-1, 0, 1]) / 1.333, atol=1e-5)
    np.testing.assert_allclose(z[3, 0], 0.01, rtol=1e-5)


def test_a_wide_aperture_sees_spherical_aberration():
    """Seidel's: behind a fluid of depth w marginal rays cross w u^2 (n^2 - 1) / (2 n^3) off, in air before the lens."""
    found = images_of(
        np.zeros((1, 3)), replace(IN_WATER, gap_mm=100 - 60 / 1.333, medium=Medium(1.333, 60.0)), CAMERA, 961
    )
    s, u = found.s_mm[0], found.u_mm[0]
    r = np.hypot(*u.T)
    lateral = (s * u).sum(1) / r
    slope = r / 100
    longitudinal = 60 * slope**2 * (1.333**2 - 1) / (2 * 1.333**3)  # in air, before the lens
    np.testing.assert_allclose(np.abs(lateral[r > 5]), (slope * longitudinal)[r > 5], rtol=0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_images_are_inverted_and_higher_points_nearer_to_the_lens_larger(axis):
    point = np.zeros((2, 3))
    point[:, axis], point[1, 2] = 1.0, 2.0
    s, _ = IN_WATER.trace(point, np.zeros((1, 2)))
    assert s[0, 0, axis] == pytest.approx(-1.0, abs=2e-3)
    assert s[1, 0, axis] < s[0, 0, axis]


def test_a_view_counts_a_ray_where_it_crosses_the_reference_plane():
    model = replace(AIR, reference_mm=115.0)
    s, u = model.trace(np.array([[0.3, 0.0, 0.0]]), np.array([[5.0, 0.0]]))
    slope = (s[0, 0, 0] - 5.0) / 100.0
    assert u[0, 0, 0] == pytest.approx(s[0, 0, 0] - 115.0 * slope)


def test_pose_distortion_and_tilt_have_the_signs_of_their_names():
    turned = replace(AIR, turn_rad=(0.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(turned.camera_frame([1.0, 0, 0]), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(replace(AIR, shift_mm=(0.5, -0.2)).camera_frame([0, 0, 1.0]), [0.5, -0.2, 1.0])
    far = replace(AIR, distortion=0.01).trace(np.array([[-4.2, 0, 0]]), np.zeros((1, 2)))[0]
    assert far[0, 0, 0] == pytest.approx(4.2 * 1.01)
    tilted = replace(AIR, gap_tilt=(0.02, 0.0)).trace(np.array([[-4.2, 0, 0]]), np.array([[3.0, 0]]))[1]
    plain = AIR.trace(np.array([[-4.2, 0, 0]]), np.array([[3.0, 0]]))[1]
    np.testing.assert_allclose(tilted, plain * 1.02)


def test_the_map_carries_points_of_the_volume():
    found = space_map(IN_WATER, CAMERA, BOX)
    points = np.random.default_rng(1).uniform(*np.array(BOX).T, (200, 3))
    lens = found.to_lens(points)
    assert np.abs(found.to_laboratory(lens) - points).max() < 4e-5
    nearest = images_of(points, IN_WATER, CAMERA).place_mm  # what they leave is no ray's own: some um off in depth
    assert np.abs(lens - nearest).max(0) == pytest.approx([0, 0, 0], abs=0.02)


def test_a_fluid_longer_than_the_object_distance_is_refused():
    with pytest.raises(PlenoPIVError, match="correct \\[medium\\]"):
        Medium(1.333, 140.0).gap_mm(100.0)


def test_places_on_a_disc_are_even():
    places = on_disc(2.0, 400)
    assert np.hypot(*places.T).max() < 2.0
    np.testing.assert_allclose((places**2).mean(0), 1.0, rtol=0.02)  # R^2 / 4
