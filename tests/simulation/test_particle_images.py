"""The ray tracer against the closed form of a square lattice, brute quadrature, and signs derived by hand."""

import ast
from dataclasses import replace
from math import erf, sqrt
from pathlib import Path

import numba
import numpy as np
import pytest
from oracles.light import point_image_quadrature, point_image_square

import plenopiv.simulation
from plenopiv.cameras.plenoptic import LensRim, MainLens
from plenopiv.cameras.presets import preset
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice, LatticeMap
from plenopiv.sensor import upright
from plenopiv.simulation.images import diffraction_sigma_mm, particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.simulation.real_camera import RealCamera
from plenopiv.simulation.white import white_image

SQUARE = preset("pmr14")
TURNED = SQUARE.with_lattice(Lattice("hexagonal", 0.077, 0.02, (0.013, -0.027)))


def points(*position_mm, electrons=1.0, diameter_mm=0.0):
    return Particles(np.array(position_mm, float), np.full(len(position_mm), electrons), diameter_mm)


@pytest.mark.parametrize(
    "point",
    [
        (0.013, -0.021, 0.0),
        (-0.5, 0.4, 2.0),
        (0.41, -0.77, -3.1),
        *(pytest.param(p, marks=pytest.mark.full) for p in ((0.0, 0.0, 0.0), (0.3, 0.2, 0.2), (1.15, 0.1, 1.5))),
    ],
)
def test_closed_form_of_a_square_lattice(point):
    exact = point_image_square(SQUARE, point)
    traced = particle_image(SQUARE, points(point), rays=20_000_000)
    assert np.abs(traced - exact).max() <= 1e-3 * exact.max()


def test_closed_form_with_an_offset_and_unmatched_aperture():
    camera = preset("pmr8", aperture="table").with_lattice(Lattice("square", 0.044, 0.0, (0.017, -0.006)))
    exact = point_image_square(camera, (0.2, -0.3, 1.0))
    traced = particle_image(camera, points((0.2, -0.3, 1.0)), rays=20_000_000)
    assert np.abs(traced - exact).max() <= 1e-3 * exact.max()


def test_closed_form_at_another_magnification():
    camera = replace(SQUARE, main_lens=MainLens(50.0, 20.0, -0.5))
    exact = point_image_square(camera, (0.9, -0.4, -2.5))
    traced = particle_image(camera, points((0.9, -0.4, -2.5)), rays=20_000_000)
    assert exact.sum() == pytest.approx(1.0)
    assert np.abs(traced - exact).max() <= 1e-3 * exact.max()


@pytest.mark.full
@pytest.mark.parametrize(
    ("kind", "point"),
    [
        pytest.param("hexagonal", (0.2, 0.1, 0.1), marks=pytest.mark.full),
        pytest.param("hexagonal", (0.41, -0.77, -1.1), marks=pytest.mark.full),
        ("square", (-0.3, 0.6, 3.0)),
    ],
)
def test_quadrature_on_a_turned_and_shifted_lattice(kind, point):
    camera = SQUARE.with_lattice(Lattice(kind, 0.077, 0.02, (0.013, -0.027)))
    exact = point_image_quadrature(camera, point, 3500)
    traced = particle_image(camera, points(point), rays=20_000_000)
    assert np.abs(traced - exact).max() <= 1e-3 * exact.max()


def test_the_two_references_agree():
    exact, summed = (f(SQUARE, (0.3, -0.2, 1.3)) for f in (point_image_square, point_image_quadrature))
    assert exact.sum() == pytest.approx(1.0, abs=1e-7)
    assert np.abs(exact - summed).max() <= 2e-3 * exact.max()


@pytest.mark.parametrize("sampling", ["stratified", "random"])
def test_light_is_conserved_inside_the_field_of_view(sampling):
    rng = np.random.default_rng(0)
    p = Particles(rng.uniform(-0.8, 0.8, (50, 3)), rng.uniform(10, 1000, 50))
    image = particle_image(TURNED, p, rays=7001, sampling=sampling)
    assert image.sum() == pytest.approx(p.electrons.sum(), rel=1e-6)


def test_light_outside_the_sensor_is_lost():
    assert particle_image(SQUARE, points((3.0, 0.0, 0.5))).sum() == 0
    half = particle_image(SQUARE, points((0.0, 448 * 0.0055 / 2, 3.0))).sum()
    assert half == pytest.approx(point_image_square(SQUARE, (0.0, 448 * 0.0055 / 2, 3.0)).sum(), abs=2e-3)
    assert 0.3 < half < 0.7


def rms_error(rays, sampling, seeds):
    point = (0.3, 0.2, 1.2)
    exact = point_image_square(SQUARE, point)
    images = [particle_image(SQUARE, points(point), rays=rays, sampling=sampling, seed=s) for s in range(seeds)]
    return np.sqrt(np.mean((np.array(images) - exact) ** 2))


def test_error_of_random_rays_falls_with_their_square_root_and_stratified_ones_are_better():
    coarse, fine = rms_error(2_000, "random", 20), rms_error(32_000, "random", 20)
    assert coarse / fine == pytest.approx(4.0, rel=0.15)
    assert rms_error(32_000, "stratified", 20) < 0.4 * fine


def test_stratified_rays_are_unbiased():
    """Each particle turns and shifts its rays anew: many in one place average to the exact image."""
    point, n = (0.05, 0.02, 0.7), 4000
    exact = point_image_square(SQUARE, point)
    one = np.sqrt(np.mean([(particle_image(SQUARE, points(point), rays=200, seed=s) - exact) ** 2 for s in range(20)]))
    mean = particle_image(SQUARE, points(*[point] * n, electrons=1 / n), rays=200)
    assert np.sqrt(np.mean((mean - exact) ** 2)) < 1.3 * one / sqrt(n)


def centroid(image):
    rows, columns = np.indices(image.shape)
    return (columns * image).sum() / image.sum(), (rows * image).sum() / image.sum()


def test_signs_upright_and_sensor():
    """M = -1: +x is imaged at -s, which is a larger column upright; +y at -t, a smaller row."""
    c0, r0 = SQUARE.sensor.axis
    image = particle_image(SQUARE, points((0.77, 0.385, 0.0)))
    column, row = centroid(image)
    assert column - c0 == pytest.approx(0.77 / 0.0055, abs=1.0)
    assert row - r0 == pytest.approx(-0.385 / 0.0055, abs=1.0)
    column, row = centroid(upright(image, "sensor"))
    assert column < c0 - 100
    assert row > r0 + 50


@pytest.mark.parametrize(("z", "side"), [(2.0, +1), (-2.0, -1)])
@pytest.mark.parametrize("camera", [SQUARE, TURNED], ids=["square", "hexagonal"])
def test_which_side_of_a_micro_image_is_lit(camera, z, side):
    """A(z) > 0 for z > 0: a microlens on the +u side gets rays of u > 0 and shows them at -e u: on its inner side.

    For z < 0 it gets those of u < 0 and shows them on its outer side, away from the point's image.
    """
    image = particle_image(camera, points((0.1, -0.05, z)))
    i, j = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21))
    s, t = camera.lattice.centres(i, j)
    e = camera.image_scale
    column, row = camera.sensor.pixel_from_plane(s * (1 + e), t * (1 + e))
    middle = camera.sensor.pixel_from_plane(camera.scale(z) * 0.1, camera.scale(z) * -0.05)
    rows, columns = np.indices(image.shape)
    judged = 0
    for c, r in zip(column.ravel(), row.ravel(), strict=True):
        away = np.array([c - middle[0], r - middle[1]])
        if not 15 < np.hypot(*away) < 60:  # the image of the point itself is 46 px in radius
            continue
        micro = np.where(np.hypot(columns - c, rows - r) < 6.5, image, 0.0)
        if micro.sum() < 5e-3:
            continue
        lit = np.array(centroid(micro)) - np.array([c, r])
        assert side * (lit @ away) < 0
        judged += 1
    assert judged >= 8


def test_a_particle_s_size_spreads_it_over_lenses_as_a_gaussian():
    """In focus all light of a place goes to one lens: a lens' share is the Gaussian's integral over its cell."""
    sigma = 0.05
    image = particle_image(SQUARE, points((0.0, 0.0, 0.0), diameter_mm=4 * sigma), rays=1_000_000)
    pitch = SQUARE.lattice.pitch_mm
    for k in range(-2, 3):
        share = 0.5 * (erf((k + 0.5) * pitch / sigma / sqrt(2)) - erf((k - 0.5) * pitch / sigma / sqrt(2)))
        first = round(SQUARE.sensor.axis[0] + (k - 0.5) * SQUARE.image_pitch_px + 0.5)
        assert image[:, first : first + 14].sum() == pytest.approx(share, abs=2e-3)


def test_diffraction_adds_its_variance():
    p = points((0.0, 0.0, 0.0))
    sharp, blurred = (particle_image(SQUARE, p, rays=2_000_000, diffraction_nm=nm) for nm in (None, 6000.0))
    columns = np.arange(448) - SQUARE.sensor.axis[0]
    added = ((blurred - sharp).sum(0) * columns**2).sum()
    assert added == pytest.approx((diffraction_sigma_mm(SQUARE, 6000.0) / 0.0055) ** 2, rel=0.02)
    assert blurred.sum() == pytest.approx(1.0, rel=1e-6)


def test_diffraction_is_that_of_the_microlens():
    # 0.42 * 532 nm * f/4
    assert diffraction_sigma_mm(SQUARE, 532.0) == pytest.approx(0.42 * 532e-6 * 4.0)


@pytest.mark.full
def test_image_depends_on_the_seed_but_not_on_threads():
    rng = np.random.default_rng(3)
    p = Particles(rng.uniform(-1, 1, (40, 3)) * (1, 1, 3), 1.0, 0.02)
    threads = numba.get_num_threads()
    images = []
    for n in (1, threads):
        numba.set_num_threads(n)
        images.append(particle_image(TURNED, p, rays=150_000, seed=5, diffraction_nm=532.0))
    assert np.array_equal(*images)
    assert not np.array_equal(images[0], particle_image(TURNED, p, rays=150_000, seed=6, diffraction_nm=532.0))


def test_progress_reaches_the_total():
    calls = []
    particle_image(SQUARE, points((0, 0, 1), (0.1, 0, 1)), rays=100, progress=lambda d, n: calls.append((d, n)))
    assert calls[-1] == (2, 2)


def test_particles_behind_the_lens_and_unknown_sampling_are_refused():
    with pytest.raises(PlenoPIVError, match="main lens"):
        particle_image(SQUARE, points((0, 0, 120.0)))
    with pytest.raises(PlenoPIVError, match="stratified"):
        particle_image(SQUARE, points((0, 0, 1.0)), sampling="sobol")


RIM = LensRim(4.0, 0.1, (0.0, 0.0))
BENT = LatticeMap(2, 1.0, ((0.02, 0.0), (0.0, 0.02), *((0.0, 0.0),) * 3))


@pytest.mark.parametrize(
    "simulate", [lambda camera: particle_image(camera, points((0, 0, 1.0))), white_image, RealCamera.of]
)
def test_what_is_not_simulated_of_a_camera_is_said(simulate):
    """Images of a camera without it would be taken for its own: layout and reconstruction know both."""
    with pytest.raises(PlenoPIVError, match=r"rim = LensRim\(radius_mm=4\.0.*use replace\(camera, rim=None\)"):
        simulate(replace(SQUARE, rim=RIM))
    with pytest.raises(PlenoPIVError, match=r"lattice\.map, of degree 2, is not simulated; use a regular lattice"):
        simulate(SQUARE.with_lattice(replace(SQUARE.lattice, map=BENT)))


def test_simulation_shares_nothing_with_the_projector():
    """The simulator checks the projector: a common ray kernel would hide a common error."""
    for path in Path(plenopiv.simulation.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                for room in ("projection", "reconstruction", "displacement"):
                    assert not module.startswith(f"plenopiv.{room}"), f"{path.name} imports {module}"
