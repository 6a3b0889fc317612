"""The projector against light: a point at a voxel's centre, by depth, off axis, on both lattices, turned and shifted.

The reference is the point's image (closed form of a square lattice along the axes, else quadrature over the aperture),
decoded like a recording. Run with ``pytest -s`` for the table by depth.
"""

from functools import cache

import numpy as np
import pytest
from oracles.cameras import projected_point, small_camera
from oracles.light import point_image_quadrature, point_image_square
from oracles.naive_projection import exact_light

from plenopiv.lightfield import decode, layout

pytestmark = pytest.mark.usefixtures("one_thread")

LATTICES = {
    "square": ("square", 0.0, (0.0, 0.0)),
    "square, shifted": ("square", 0.0, (0.017, -0.006)),
    "square, 0.1 deg": ("square", 0.1, (0.017, -0.006)),
    "square, 1 deg": ("square", 1.0, (0.017, -0.006)),
    "hexagonal": ("hexagonal", 0.0, (0.0, 0.0)),
    "hexagonal, 0.1 deg": ("hexagonal", 0.1, (0.013, -0.027)),
    "hexagonal, 1 deg": ("hexagonal", 1.0, (0.013, -0.027)),
    "hexagonal, rows along y": ("hexagonal", 29.5, (0.013, -0.027)),
}
DEPTHS_MM = (-8.0, -4.0, -2.0, -1.0, -0.2, 0.0, 0.2, 1.0, 2.0, 4.0, 8.0)
PLACES_MM = ((0.003, 0.002), (0.11, -0.07))
LIMIT = 1e-2
LATER = ("square, 0.1 deg", "square, 1 deg", "hexagonal", "hexagonal, 0.1 deg", "hexagonal, rows along y")  # full set
every_lattice = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.full) if name in LATER else name for name in LATTICES]
)


@cache
def layout_of(name):
    kind, degrees, offset = LATTICES[name]
    return layout(small_camera(kind, rotation_rad=np.deg2rad(degrees), offset_mm=offset))


@cache
def decoded_light(name, point):
    """What every pixel gets; by quadrature to 0.003 of the brightest (0.005 at -8 mm), a third of LIMIT."""
    where = layout_of(name)
    camera = where.camera
    separable = camera.lattice.kind == "square" and camera.lattice.rotation_rad == 0.0
    image = point_image_square(camera, point) if separable else point_image_quadrature(camera, point, 1000)
    return decode(image, where).values.astype(float)


@cache
def own_light(name, point):
    """What every pixel gets through its own microlens."""
    return exact_light(layout_of(name), point)


def check(name, worst):
    print(f"\n{name:19}", *(f"{z:+.1f} mm {error:.4f} " for z, error in worst.items()))
    for z, error in worst.items():
        assert error <= LIMIT, f"z = {z} mm"


@every_lattice
def test_exact_weights_are_the_light(name):
    """Largest error of a pixel over the brightest pixel, at any depth."""
    where, worst = layout_of(name), {}
    for z in DEPTHS_MM:
        errors = []
        for place in PLACES_MM:
            want = decoded_light(name, (*place, z))
            errors.append(np.abs(projected_point(where, (*place, z)) - want).max() / want.max())
        worst[z] = max(errors)
    check(name, worst)


@every_lattice
def test_exact_weights_are_the_light_through_their_own_lens(name):
    """As above but for the light that a neighbouring microlens sends to a pixel, which no view can describe."""
    where, worst = layout_of(name), {}
    for z in DEPTHS_MM:
        want = own_light(name, (*PLACES_MM[1], z))
        worst[z] = np.abs(projected_point(where, (*PLACES_MM[1], z)) - want).max() / want.max()
    check(name, worst)


@every_lattice
def test_pixels_away_from_the_rim_are_exact(name):
    """Where the aperture cuts no pixel there is no approximation but the lattice's angle.

    The pixel's square is taken parallel to the rows. Its footprint is f microlenses wide; turned, its sides move by
    up to f/2 times the angle over the length f that they share with the cells.
    """
    where = layout_of(name)
    inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= where.camera.aperture_radius_px
    assert inner.sum() > 80
    for z in (-4.0, -1.0, 0.0, 2.0, 8.0):
        want = own_light(name, (*PLACES_MM[1], z))
        error = np.abs(projected_point(where, (*PLACES_MM[1], z)) - want)[inner].max() / want.max()
        a = float(where.camera.spread(z))
        footprint = abs(a / (1 - a)) * where.camera.portion_mm / where.camera.lattice.pitch_mm
        assert error <= 2e-5 + 0.16 * abs(where.camera.lattice.rotation_rad) * max(1.0, footprint**2)


def test_the_naive_projection_is_the_light():
    """Its own check: with what neighbouring lenses add left out, never more than the closed form and often equal."""
    for z in (-4.0, -0.2, 0.0, 1.0, 8.0):
        want = decoded_light("square, shifted", (*PLACES_MM[1], z))
        own = own_light("square, shifted", (*PLACES_MM[1], z))
        assert (want - own).min() > -2e-7 * want.max()  # decode is float32
        assert np.median(np.abs(want - own)[want > 0]) < 1e-7 * want.max()
    point = (0.11, -0.07, 4.0)
    want, own = decoded_light("hexagonal, 1 deg", point), own_light("hexagonal, 1 deg", point)
    assert own.sum() == pytest.approx(want.sum(), rel=1e-2)
    assert np.median(np.abs(want - own)[want > 0]) < 1e-3 * want.max()


@pytest.mark.parametrize("name", ["square, shifted", "hexagonal, 1 deg"])
def test_more_rays_come_nearer_to_the_light(name):
    """Misplaced light, sum |error| over the sum, by depth: exact < 9 rays < 1 ray, and rays get worse with depth."""
    where = layout_of(name)
    misplaced = {}
    for z in (-4.0, -1.0, 1.0, 4.0, 8.0):
        want = own_light(name, (*PLACES_MM[1], z))
        misplaced[z] = [
            np.abs(projected_point(where, (*PLACES_MM[1], z), rule) - want).sum() / want.sum()
            for rule in ("polygons", "9-rays", "1-ray")
        ]
    for z, (exact, nine, one) in misplaced.items():
        print(f"\n{name:19} {z:+.1f} mm: exact {exact:.4f}  9 rays {nine:.4f}  1 ray {one:.4f}", end="")
        assert exact < 0.01
        assert exact < nine < one
    nine, one = ({z: m[k] for z, m in misplaced.items()} for k in (1, 2))
    assert nine[1.0] < nine[4.0] < nine[8.0]
    assert one[1.0] < one[4.0] < one[8.0]
    assert nine[1.0] < 0.1
    assert one[1.0] < 0.4


@pytest.mark.full
@pytest.mark.parametrize("name", ["square, shifted", "hexagonal, 1 deg"])
def test_maps_misplace_less_light_than_nine_rays(name):
    """They interpolate, with many points hardly, and a pixel at the rim has the footprint of a whole one. Mean over
    places within a microlens."""
    where, rng, voxel = layout_of(name), np.random.default_rng(0), 0.017
    for z in (-8.0, -4.0, -1.0, 1.0, 4.0, 8.0):
        misplaced = []
        for x, y in rng.uniform(-0.06, 0.06, (4, 2)):
            want = exact_light(where, (x, y, z))
            got = (
                projected_point(where, (x, y, z), "exact", voxel, across=40.0),
                projected_point(where, (x, y, z), "exact", voxel),
                projected_point(where, (x, y, z), "9-rays", voxel),
            )
            misplaced.append([np.abs(g - want).sum() / want.sum() for g in got])
            assert got[0].sum() == pytest.approx(want.sum(), rel=1e-2)
            assert got[1].sum() == pytest.approx(want.sum(), rel=0.1)
        fine, usual, nine = np.mean(misplaced, 0)
        print(f"\n{name:19} {z:+.1f} mm: 40 points {fine:.4f}  7 points {usual:.4f}  9 rays {nine:.4f}", end="")
        assert fine < 0.03
        assert fine < usual < min(nine, 0.13)
