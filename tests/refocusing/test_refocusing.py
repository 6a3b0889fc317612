"""Pictures of a light field: where and how deep a simulated particle appears, and how much light it keeps."""

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.light import point_image_quadrature

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField, decode, layout
from plenopiv.refocusing import _neighbours, image_axes, refocused, sub_aperture
from plenopiv.simulation.white import white_image

CAMERAS = {
    "square": small_camera("square", microlenses=(23, 19), offset_mm=(0.02, -0.03), black_level=60.0),
    "square-14.04": small_camera("square", pmr=14.04, microlenses=(23, 19), rotation_rad=0.01, magnification=-0.5),
    "hexagonal": small_camera("hexagonal", microlenses=(23, 19), rotation_rad=-0.02),
    "hexagonal-columns": small_camera("hexagonal", pmr=14.04, microlenses=(23, 19), rotation_rad=1.5707),
}
LAYOUTS = {name: layout(camera) for name, camera in CAMERAS.items()}
LATER = ("square", "hexagonal-columns")  # of the full set: both kinds of lattice are there
every_layout = pytest.mark.parametrize(
    "where",
    [pytest.param(where, marks=pytest.mark.full) if name in LATER else where for name, where in LAYOUTS.items()],
    ids=LAYOUTS,
)
LIGHT = 1e5  # counts of a particle


def particle(where, point_mm) -> LightField:
    """The light field of one point, by a quadrature that shares nothing with what is tested."""
    image = LIGHT * point_image_quadrature(where.camera, point_mm, 400)
    return decode(image + where.camera.sensor.black_level, where)


def brightest(image, x, y):
    row, column = np.unravel_index(np.nanargmax(image), image.shape)
    return x[column], y[row]


@every_layout
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_particle_appears_at_its_place(where, axis):
    """On the right side along each axis; in depth, brightest at its own."""
    camera = where.camera
    m = abs(camera.main_lens.magnification)
    step = camera.lattice.pitch_mm / m
    dead = camera.dead_zone_mm()[1]
    point = np.array([0.1 * step, 0.2 * step, 5.0 * dead])
    point[axis] += (4.2 * step, 3.3 * step, 0.0)[axis]
    x, y = image_axes(camera, step / 2)
    for sign in (1, -1):
        place = point.copy()
        place[axis] *= sign
        lf = particle(where, place)
        depths = place[2] + dead * np.array([-10, -4, -2, 0, 2, 4])
        pictures = [refocused(lf, z, x, y) for z in depths]
        peaks = [np.nanmax(picture) for picture in pictures]
        assert np.argmax(peaks) == 3
        assert brightest(pictures[3], x, y) == pytest.approx(tuple(place[:2]), abs=0.75 * step)


@every_layout
def test_views_see_a_particle_out_of_focus_from_their_own_side(where):
    """A nearer point is seen by a view through +u at smaller x: at z = 0 it appears at (A u + B x) / M."""
    camera = where.camera
    x, y = image_axes(camera)
    m, n = where.offsets.T
    for z in (-3.0, 3.0):
        lf = particle(where, (0.0, 0.0, z / camera.main_lens.magnification**2))
        a = float(camera.spread(z / camera.main_lens.magnification**2)) / camera.main_lens.magnification
        for view in np.flatnonzero((np.abs(m) == 4) & (np.abs(n) == 3)):
            seen = np.nan_to_num(sub_aperture(lf, view))
            middle = (seen.sum(0) @ x / seen.sum(), seen.sum(1) @ y / seen.sum())
            expected = a * camera.portion_mm * m[view], -a * camera.portion_mm * n[view]
            assert middle == pytest.approx(expected, abs=0.75 * x[1] - 0.75 * x[0])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_micro_images_off_the_pixels_do_not_move_what_is_refocused(axis, sign):
    """Every micro-image's centre 0.4 px beside a pixel's: the same views then look through other portions of the main
    lens, by 0.4/14 of the aperture. A particle stays at its place, to a twentieth of a microlens; taken for the nominal
    portions, its picture would be off by |z|/z0 0.4/14, a fifth of one."""
    off_px = np.zeros(2)
    off_px[axis] = sign * 0.4
    pitch = 14.0 / 1.00308  # pixels; micro-images are (1 + f_l/S_i) as far apart: 14
    camera = small_camera("square", pmr=pitch, microlenses=(23, 19), offset_mm=tuple(0.0055 / 1.00308 * off_px))
    assert camera.sensor.columns % 2 == camera.sensor.rows % 2 == 1  # the axis is in the middle of a pixel
    where = layout(camera)
    expected = np.zeros(2)
    expected[axis] = sign * (-0.4, 0.4)[axis]  # columns grow with -s, rows with +t
    np.testing.assert_allclose(where.phase, np.broadcast_to(expected, where.phase.shape), atol=1e-3)
    step = camera.lattice.pitch_mm
    x, y = image_axes(camera, step / 2)
    for z in 7.0 * camera.dead_zone_mm()[1] * np.array([-1.0, 1.0]):
        place = np.array([0.3 * step, -0.2 * step])
        picture = np.nan_to_num(refocused(particle(where, (*place, z)), z, x, y))
        picture[picture < 0.2 * picture.max()] = 0.0
        centre = np.array([picture.sum(0) @ x, picture.sum(1) @ y]) / picture.sum()
        assert (centre - place) / step == pytest.approx([0.0, 0.0], abs=0.05)


@every_layout
@pytest.mark.parametrize("z_mm", [-2.0, 0.0, 1.5])
def test_light_is_kept(where, z_mm):
    """Picture times area, in microlenses, times pixels per micro-image: the counts of all views."""
    camera = where.camera
    lf = particle(where, (0.11, -0.07, 0.8))
    x, y = image_axes(camera, camera.lattice.pitch_mm / abs(camera.main_lens.magnification) / 3)
    cells = (x[1] - x[0]) ** 2 * float(camera.scale(z_mm)) ** 2 / camera.lattice.cell_area_mm2
    pixels = (where.fill * where.seen).sum(0)
    whole = pixels[pixels > 0.85 * pixels.max()].mean()  # of microlenses that the sensor's edge does not cut
    total = np.nansum(refocused(lf, z_mm, x, y)) * cells * whole
    assert total == pytest.approx(lf.values.sum(), rel=0.06)  # microlenses differ in the rim's pixels that are seen
    assert lf.values.sum() == pytest.approx(LIGHT, rel=0.15)  # what the layout leaves out is at the rims


@every_layout
def test_even_light_makes_even_pictures(where):
    lf = decode(white_image(where.camera, 1000.0) + where.camera.sensor.black_level, where)
    for z_mm in (-1.0, 0.0, 1.0):
        picture = refocused(lf, z_mm)
        middle = picture[3:-3, 3:-3]
        assert np.nanmax(np.abs(middle - 1000.0)) < 15.0
    view = int(np.argmin(np.hypot(*where.offsets.T)))
    assert np.nanmax(np.abs(sub_aperture(lf, view)[2:-2, 2:-2] - 1000.0)) < 1.0


@every_layout
def test_interpolation_is_linear(where):
    """Weights are positive, add to 1, and give back the place itself."""
    lattice = where.camera.lattice
    s, t = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 400))
    corners = _neighbours(lattice, s, t)
    weights = np.array([weight for _, _, weight in corners])
    assert weights.min() > -1e-9
    np.testing.assert_allclose(weights.sum(0), 1.0)
    centres = np.array([lattice.centres(i, j) for i, j, _ in corners])
    np.testing.assert_allclose((weights[:, None] * centres).sum(0), [s, t], atol=1e-12)
    reach = np.hypot(*(centres - [s, t]).transpose(1, 0, 2)) / lattice.pitch_mm
    assert reach.max() < (1.42 if lattice.kind == "square" else 1.001)


def test_rows_fall_and_columns_rise():
    camera = CAMERAS["square"]
    x, y = image_axes(camera)
    assert (x[0], y[-1]) == (pytest.approx(-x[-1]), pytest.approx(-y[0]))
    assert (np.diff(x) > 0).all()
    assert (np.diff(y) < 0).all()
    assert len(x) > len(y)


def test_what_cannot_be_looked_at():
    lf = LightField(LAYOUTS["square"], np.zeros((LAYOUTS["square"].views, LAYOUTS["square"].lenses), np.float32))
    with pytest.raises(PlenoPIVError, match="views 0 to"):
        sub_aperture(lf, LAYOUTS["square"].views)
    with pytest.raises(PlenoPIVError, match="not in front of the main lens"):
        refocused(lf, 100.0)


@pytest.mark.parametrize("view", [500, -1])
def test_a_view_that_there_is_not_is_refused(view):
    where = LAYOUTS["square"]
    field = decode(np.zeros((where.camera.sensor.rows, where.camera.sensor.columns)), where)
    for look in (lambda: refocused(field, 0.5, views=[view]), lambda: sub_aperture(field, view)):
        with pytest.raises(PlenoPIVError, match=f"view {view}: this camera has views 0 to {where.views - 1}"):
            look()


@pytest.mark.parametrize("step_mm", [0.0, -0.1, np.nan])
def test_a_picture_of_no_pixels_is_refused(step_mm):
    with pytest.raises(PlenoPIVError, match="give a positive number of mm"):
        image_axes(small_camera(), step_mm)
