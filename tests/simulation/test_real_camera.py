"""A real camera's optics against the thin lens, rays followed by hand, paraxial limits, and signs."""

from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice
from plenopiv.sensor import Sensor
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import Pose, RealCamera
from plenopiv.simulation.real_images import real_particle_image, sight_lines, traced

AIR = PlenopticCamera(
    MainLens(50.0, 25.0, -0.8), Lattice("hexagonal", 0.077, 0.005, (0.02, -0.01)), 0.308, Sensor(300, 240, 0.0055, 12)
)
THIN = RealCamera.of(AIR)
WATER = Medium(1.333, 40.0, 10.0, 1.52)
TANK = replace(THIN, stop_mm=12.0, stop_radius_mm=11.0, medium=WATER)


def pupil(n=40, radius=10.0):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def test_a_thin_lens_in_air_is_that_of_the_other_tracer():
    rng = np.random.default_rng(0)
    particles = Particles(rng.uniform((-0.6, -0.5, -3), (0.6, 0.5, 3), (20, 3)), 1000.0)
    real = real_particle_image(THIN, particles, rays=5000, seed=3)
    assert np.abs(real - particle_image(AIR, particles, rays=5000, seed=3)).max() <= 1e-9 * real.max()


def test_rays_of_a_thin_lens_follow_the_two_relations():
    point, stop = np.array([0.4, -0.3, 2.0]), pupil()
    rays = traced(THIN, point, stop)
    st = AIR.spread(2.0) * stop + AIR.scale(2.0) * point[:2]
    assert rays.st_mm == pytest.approx(st, abs=1e-12)
    i, j = AIR.lattice.nearest(*st.T)
    lens = np.stack(AIR.lattice.centres(i, j), -1)
    e = AIR.image_scale
    assert rays.sensor_mm == pytest.approx(lens * (1 + e) + e * ((st - lens) - stop), abs=1e-12)


def refracted(direction, normal, n_from, n_to):
    """Snell's law for vectors."""
    sine = np.cross(normal, direction) * (n_from / n_to)
    return np.cross(sine, normal) + normal * np.sqrt(1 - sine @ sine)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (2.0, 0.0), (-1.5, 3.0)])
@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.08, -0.11), (-0.2, 0.05)])
def test_a_ray_followed_through_the_window_by_hand(tilt, slopes):
    camera = replace(TANK, medium=replace(WATER, window_tilt_deg=tilt), stop_radius_mm=40.0)
    a, b = np.radians(tilt)
    normal = np.array([np.sin(b) * np.cos(a), -np.sin(a), np.cos(b) * np.cos(a)])
    start = np.array([0.3, -0.5, -2.0])
    point, direction = start, np.array([*slopes, 1.0]) / np.hypot(1.0, np.hypot(*slopes))
    for distance, n_from, n_to in ((0.0, 1.333, 1.52), (10.0, 1.52, 1.0)):
        face = np.array([0.0, 0.0, 40.0 + distance / normal[2]])
        point = point + direction * ((face - point) @ normal) / (direction @ normal)
        direction = refracted(direction, normal, n_from, n_to)
    slope = direction[:2] / direction[2]
    at_stop = point[:2] + slope * (camera.lens_z_mm - 12.0 - point[2])
    u = at_stop + 12.0 * slope
    rays = traced(camera, start, at_stop)
    assert rays.slopes[0] == pytest.approx(slope - u / 50.0, abs=1e-12)
    assert rays.st_mm[0] == pytest.approx(u + camera.image_distance_mm * (slope - u / 50.0), abs=1e-10)


def blur_per_pupil(camera, z):
    """Paraxial ds/dq of a point on the axis."""
    return traced(camera, (0.0, 0.0, z), (0.01, 0.0)).st_mm[0, 0] / 0.01


def test_a_fluid_shrinks_depth_by_its_index():
    dry = replace(TANK, medium=None)
    assert abs(blur_per_pupil(TANK, 0.0)) < 1e-8
    for z in (-4.0, 3.0):
        assert blur_per_pupil(TANK, z) == pytest.approx(blur_per_pupil(dry, z / 1.333), rel=1e-6)
    assert abs(blur_per_pupil(TANK, 3.0)) > 0.01


def test_a_window_bends_rays_at_the_rim_beyond_focus():
    """Spherical aberration of a plane window: marginal rays cross the axis farther from the camera in object space,
    (n^2 - 1)/(2 n^3) w tan^2 for a fluid alone."""
    camera = replace(TANK, medium=Medium(1.333, 60.0))
    q = 11.0
    slope = q / (camera.object_distance_mm - 12.0)
    s = traced(camera, (0.0, 0.0, 0.0), (q, 0.0)).st_mm[0, 0]
    longitudinal = (1.333**2 - 1) / (2 * 1.333**3) * 60.0 * slope**2  # in air, of focus toward the camera
    assert s == pytest.approx(longitudinal * slope * camera.image_distance_mm / camera.object_distance_mm, rel=0.02)


def test_signs_of_the_axes():
    """M < 0: +x is imaged at -s, a larger column upright; +y at -t, a smaller row. +z, nearer: rays of +u at +s."""
    for camera in (THIN, TANK):
        s, t = traced(camera, (0.5, 0.3, 0.0), (0.0, 0.0)).st_mm[0]
        assert s == pytest.approx(-0.4, rel=0.01)
        assert t == pytest.approx(-0.24, rel=0.01)
        assert traced(camera, (0.0, 0.0, 1.0), (5.0, 0.0)).st_mm[0, 0] > 0.02


def test_a_turned_window_moves_points_to_its_thin_side():
    """About +y the window's side at +x sinks into the fluid: a wedge of less water there. Light of the axis' point
    leaves the wedge bent to -x of where it would go, so the point seems to lie at +x: its image is at -s."""
    turned = replace(TANK, medium=replace(WATER, window_tilt_deg=(0.0, 2.0)))
    straight, moved = (traced(c, (0.0, 0.0, 0.0), (0.0, 0.0)).st_mm[0] for c in (TANK, turned))
    assert straight == pytest.approx([0, 0], abs=1e-12)
    # the wedge bends by (n - 1) tilt about 30 mm of air-equivalent; the plate of glass moves by t tilt (1 - 1/n)
    tilt = np.radians(2.0)
    expected = 40 * tilt * (1 - 1 / 1.333) + 10.0 * tilt * (1 - 1 / 1.52)
    assert moved[0] == pytest.approx(-0.8 * expected, rel=0.1)
    assert moved[1] == pytest.approx(0, abs=1e-12)
    up = replace(TANK, medium=replace(WATER, window_tilt_deg=(2.0, 0.0)))
    assert traced(up, (0.0, 0.0, 0.0), (0.0, 0.0)).st_mm[0, 1] == pytest.approx(-moved[0], rel=1e-9)


def test_signs_of_the_pose():
    camera = replace(THIN, pose=Pose(90.0, (0.1, 0.2, -0.5)))
    # the laboratory's x is the camera's y
    assert camera.pose.to_camera((1.0, 0.0, 0.0)) == pytest.approx([0.1, 1.2, -0.5])
    same = traced(THIN, (0.1, 0.7, 0.5), (3.0, 1.0)).st_mm
    assert traced(camera, (0.5, 0.0, 1.0), (3.0, 1.0)).st_mm == pytest.approx(same, abs=1e-12)
    tilted = Pose(0.0, (0.0, 0.0, 0.0), (0.0, 2.0))  # about +y: z turns towards x, x away from the camera
    assert tilted.to_camera((1.0, 0.0, 0.0))[2] < -0.03
    points = np.random.default_rng(1).normal(size=(5, 3))
    pose = Pose(20.0, (1.0, 2.0, 3.0), (3.0, -4.0))
    assert pose.to_laboratory(pose.to_camera(points)) == pytest.approx(points)


@pytest.mark.parametrize("stop_mm", [12.0, -9.0])
def test_rays_leave_the_exit_pupil(stop_mm):
    """Rays through one place of the stop leave one place of the exit pupil, whatever point they come from."""
    camera = RealCamera.of(AIR, stop_mm=stop_mm)
    distance = camera.exit_pupil_mm
    expected = 90.0 + 12.0 / (1 - 12.0 / 50.0) if stop_mm > 0 else 81.0
    assert distance == pytest.approx(expected)
    points = np.array([[0.5, 0.2, 1.0], [-0.4, 0.1, -2.0], [0.0, 0.0, 0.5]])
    rays = traced(camera, points, (4.0, -2.0))
    left = rays.st_mm - distance * rays.slopes
    magnified = 1 / (1 - 12.0 / 50.0) if stop_mm > 0 else 1.0
    assert left == pytest.approx(np.broadcast_to(np.array([4.0, -2.0]) * magnified, (3, 2)), abs=1e-10)
    assert camera.entrance_pupil_mm[1] == pytest.approx(12.5)


def test_a_telecentric_stop_has_parallel_chief_rays():
    camera = RealCamera.of(AIR, stop_mm=50.0)
    assert camera.exit_pupil_mm == np.inf
    assert traced(camera, (0.5, 0.3, 1.0), (0.0, 0.0)).slopes[0] == pytest.approx([0, 0], abs=1e-12)


def test_distortion_moves_the_corner_by_its_share():
    camera = replace(THIN, distortion=0.01)
    corner = np.array([150, 120]) * 0.0055
    for share in (1.0, 0.5):
        point = (*(-share * corner / 0.8), 0.0)
        straight, moved = (traced(c, point, (0.0, 0.0)).st_mm[0] for c in (THIN, camera))
        assert moved == pytest.approx(straight * (1 + 0.01 * share**2), rel=1e-9)


def test_a_tilted_gap_grows_along_its_direction():
    """Half a gap more at the end of the diagonal: the stop's image under the lens is so much larger."""
    camera = replace(THIN, gap_tilt=1.0, gap_tilt_direction_deg=90.0, lattice=Lattice("square", 0.077))
    diagonal = np.hypot(300, 240) * 0.0055
    t = round(0.5 / 0.077) * 0.077  # a lens' centre
    point = (0.0, -t / 0.8, 0.0)
    a, b = traced(camera, point, [(5.0, 0.0), (-5.0, 0.0)]).sensor_mm
    assert b[0] - a[0] == pytest.approx(10.0 * AIR.image_scale * (1 + t / diagonal), rel=1e-6)


def test_aspect_moves_rows_apart():
    camera = replace(THIN, aspect=0.01, lattice=Lattice("square", 0.077))
    centre = np.array([0.0, 7 * 0.077 * 1.01])
    rays = traced(camera, (0.0, -centre[1] / 0.8, 0.0), (0.0, 0.0))
    assert rays.sensor_mm[0] == pytest.approx(
        centre * (1 + AIR.image_scale), abs=1e-12
    )  # straight on: the lens' middle


def test_light_is_what_stop_and_rim_let_through():
    rng = np.random.default_rng(2)
    particles = Particles(rng.uniform((-0.5, -0.4, -2), (0.5, 0.4, 2), (30, 3)), 1000.0)
    free = real_particle_image(replace(TANK, distortion=0.01, gap_tilt=0.02, aspect=0.002), particles, rays=4000)
    assert free.sum() == pytest.approx(30_000, rel=1e-9)
    clipped = replace(TANK, rim_radius_mm=9.0)
    share = real_particle_image(clipped, Particles([[0.0, 0.0, 0.0]], 1.0), rays=20_000).sum()
    # on the axis the rim is a circle in the stop too: 1 - stop/S_o of it
    lens = traced(TANK, (0.0, 0.0, 0.0), (9.0, 0.0))
    at_lens = (lens.st_mm - TANK.image_distance_mm * lens.slopes)[0, 0]
    assert share == pytest.approx((9.0 / at_lens * 9.0 / 11.0) ** 2, abs=2e-3)


def test_lines_of_sight_are_rays_the_other_way():
    camera = replace(
        TANK,
        distortion=0.02,
        medium=replace(WATER, window_tilt_deg=(2.0, -3.0)),
        pose=Pose(3.0, (0.2, 0.1, 0.5), (1.0, 2.0)),
    )
    for at in (camera, replace(camera, stop_mm=-8.0), replace(camera, medium=None)):
        point, direction = sight_lines(at, (0.3, -0.4), pupil(radius=8.0))
        met = point + direction * ((1.5 - point[:, 2]) / direction[:, 2])[:, None]
        assert traced(at, met, pupil(radius=8.0)).st_mm == pytest.approx(np.tile([0.3, -0.4], (40, 1)), abs=1e-11)


def test_what_no_camera_is():
    with pytest.raises(PlenoPIVError, match=r"take 106\.579 mm of the 112\.5 mm .* reduce fluid_mm"):
        replace(TANK, medium=Medium(1.333, 133.3, 10.0, 1.52))
    with pytest.raises(PlenoPIVError, match="not in front of the window"):
        traced(TANK, (0.0, 0.0, 41.0), (0.0, 0.0))
    with pytest.raises(PlenoPIVError, match="not in front of the camera"):
        traced(THIN, (0.0, 0.0, 113.0), (0.0, 0.0))
    with pytest.raises(PlenoPIVError, match="no fluid behind a window"):
        replace(THIN, medium=Medium(0.9, 10.0))
    with pytest.raises(PlenoPIVError, match="behind the lens"):
        replace(THIN, stop_mm=-60.0)
