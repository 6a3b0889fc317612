"""Light columns and blocks against slow and obvious references: nearest microlens, stepping, half-plane solvers."""

from itertools import pairwise

import numpy as np
import pytest
from oracles.cameras import small_camera
from scipy.spatial import ConvexHull, HalfspaceIntersection

from plenopiv.accuracy import point_light
from plenopiv.cameras.presets import preset
from plenopiv.design import (
    block_sizes,
    blocks,
    boundary_lines,
    codes,
    corners_mm,
    fan_mm,
    free_shift_mm,
    mean_free_shift,
    places_mm,
    portion_edges_mm,
    resolution_x,
    resolution_y,
    resolution_z,
    xy_plane,
    yz_plane,
)
from plenopiv.design.resolution import gaps_mm
from plenopiv.errors import PlenoPIVError
from plenopiv.lattice import Lattice

PMRS = ("pmr8", "pmr14", "pmr28")
WINDOW = (-1.0, 1.0), (-0.3, 0.3)
CAMERAS = {
    "square": small_camera("square", pmr=6.0),
    "half": small_camera("square", pmr=6.0, magnification=-0.5, offset_mm=(0.004, -0.007)),
    "turned": small_camera("square", pmr=5.0, rotation_rad=0.2),
    "hexagonal": small_camera("hexagonal", pmr=6.0, rotation_rad=-0.1, offset_mm=(0.003, 0.005)),
}


def random_points(n, z=(-1.5, 1.5), seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), rng.uniform(*z, n)])


def naive_codes(camera, points, rays):
    """Eq. by Eq.: through the main lens to the microlens plane, then the nearest of all centres around."""
    lens = camera.main_lens
    j, i = (g.ravel() for g in np.mgrid[-40:41, -40:41])
    centres = np.stack(camera.lattice.centres(i, j), 1)
    out = np.empty((len(points), len(rays), 2), int)
    for n, (x, y, z) in enumerate(points):
        for k, (u, v) in enumerate(rays):
            slope = (np.array([u, v]) - (x, y)) / (lens.object_distance_mm - z)
            refracted = slope - np.array([u, v]) / lens.focal_length_mm
            met = np.array([u, v]) + lens.image_distance_mm * refracted
            nearest = np.argmin(((centres - met) ** 2).sum(1))
            out[n, k] = i[nearest], j[nearest]
    return out


def stepped_shift(camera, point, direction, rays, longest=3.0, step=2e-4):
    """Steps along ``direction`` until the code changes."""
    way = np.arange(0.0, longest, step)
    at = codes(camera, np.asarray(point) + way[:, None] * np.asarray(direction), rays)
    changed = (at != at[0]).any((1, 2))
    return way[np.argmax(changed)] if changed.any() else np.inf


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("rays_of", [fan_mm, corners_mm])
def test_codes_against_the_paper_s_equations(name, rays_of):
    camera = CAMERAS[name]
    rays, points = rays_of(camera), random_points(60)
    np.testing.assert_array_equal(codes(camera, points, rays), naive_codes(camera, points, rays))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.full) if name in ("square", "turned") else name for name in CAMERAS]
)
@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
def test_free_shift_against_steps(name, direction):
    camera, step = CAMERAS[name], 2e-4
    rays, points = corners_mm(camera), random_points(12, seed=3)
    exact = free_shift_mm(camera, points, direction, rays)
    steps = [stepped_shift(camera, p, direction, rays, step=step) for p in points]
    assert np.all(np.array(steps) - exact >= -1e-9)
    assert np.all(np.array(steps) - exact <= step + 1e-9)


def test_portions_share_the_aperture():
    for name, pmr in zip(PMRS, (8, 14, 28), strict=True):
        camera = preset(name)
        edges = portion_edges_mm(camera)
        assert np.diff(edges) == pytest.approx(np.full(pmr, camera.portion_mm))
        assert edges[[0, -1]] == pytest.approx([-camera.matched_aperture_mm / 2, camera.matched_aperture_mm / 2])
        corners = corners_mm(camera)
        assert np.hypot(*corners.T).max() == pytest.approx(edges[-1])
        assert {tuple(c) for c in fan_mm(camera)} <= {tuple(c) for c in corners}
    odd = portion_edges_mm(small_camera(pmr=5.0))  # a pixel on the axis
    assert odd / small_camera(pmr=5.0).portion_mm == pytest.approx([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    stopped_down = portion_edges_mm(small_camera(pmr=6.0, aperture=0.5))
    assert stopped_down / small_camera(pmr=6.0).portion_mm == pytest.approx([-1.5, -1, 0, 1, 1.5])


@pytest.mark.parametrize("name", ["square", "half"])
def test_lines_are_where_columns_change_microlens(name):
    """They are straight, aim at v on the main lens, and their t is where one microlens ends and the next begins."""
    camera = CAMERAS[name]
    z, y = (-1.0, 1.0), (-0.1, 0.1)
    lines = boundary_lines(camera, z, y)
    at = np.linspace(*z, 5)
    height = (lines[:, 1:] - camera.spread(at) * lines[:, :1]) / camera.scale(at)
    assert np.diff(height, 2) == pytest.approx(np.zeros((len(lines), 3)), abs=1e-12)
    slope = (height[:, -1] - height[:, 0]) / (z[1] - z[0])
    at_lens = height[:, 0] + slope * (camera.main_lens.object_distance_mm - z[0])
    assert at_lens == pytest.approx(lines[:, 0], abs=1e-9)
    lattice = camera.lattice
    for side in (-1e-6, 1e-6):  # the line separates two microlenses
        j = lattice.nearest(np.zeros(len(lines)), lines[:, 1] + side)[1]
        assert j * lattice.pitch_mm + lattice.offset_mm[1] - lines[:, 1] == pytest.approx(
            np.full(len(lines), np.sign(side) * lattice.pitch_mm / 2)
        )


def test_no_line_of_the_window_is_missed():
    """Along any path in the window, codes change exactly as often as lines are crossed."""
    camera = CAMERAS["half"]
    z, y = (-0.8, 1.1), (-0.12, 0.1)
    lines = boundary_lines(camera, z, y)
    rng = np.random.default_rng(5)
    for _ in range(10):
        ends = np.column_stack([np.zeros(2), rng.uniform(*y, 2), rng.uniform(*z, 2)])
        depth = ends[:, 2]
        side = (lines[:, 1:] - camera.spread(depth) * lines[:, :1]) / camera.scale(depth) - ends[:, 1]
        crossed = np.count_nonzero(side[:, 0] * side[:, 1] < 0)
        start, end = codes(camera, ends)
        assert crossed == np.abs(end - start).sum()  # each ray passes its microlenses one by one


@pytest.mark.parametrize(
    "name", [pytest.param("square", marks=pytest.mark.full), "half", pytest.param("hexagonal", marks=pytest.mark.full)]
)
@pytest.mark.parametrize("plane", [yz_plane(0.013), xy_plane(0.35), xy_plane(-0.7)], ids=str)
def test_polygons_against_half_plane_intersection(name, plane):
    """Qhull's intersection of the half-planes that stepping finds: bisectors of the code's microlenses' neighbours."""
    camera = CAMERAS[name]
    rays = corners_mm(camera)
    across = (-0.5, 0.5) if plane.across == 2 else (-0.06, 0.06)
    found = blocks(camera, plane, across, (-0.06, 0.06), (40, 40), rays)
    lens = camera.main_lens
    rng = np.random.default_rng(1)
    for up_k, across_k in rng.integers(0, 40, (12, 2)):
        a, b = found.across_mm[across_k], found.up_mm[up_k]
        n = found.label[up_k, across_k]
        assert found.whole[n]
        corners = []
        for ray, (i, j) in zip(rays, codes(camera, plane.points_mm(a, b), rays)[0], strict=True):
            own = np.array(camera.lattice.centres(i, j))
            for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
                other = np.array(camera.lattice.centres(i + di, j + dj))
                normal, middle = other - own, 0.5 * (other + own)

                def over(across, up, ray=ray, normal=normal, middle=middle):
                    x, y, z = plane.points_mm(across, up)[0]
                    s = camera.spread(z) * ray + camera.scale(z) * np.array([x, y])
                    return normal @ (s - middle) * (lens.object_distance_mm - z)

                base = over(0.0, 0.0)
                corners.append((over(1.0, 0.0) - base, over(0.0, 1.0) - base, base))
        planes = np.array([c for c in corners if np.hypot(*c[:2]) > 1e-12])
        planes /= np.hypot(planes[:, :1], planes[:, 1:2])
        hull = ConvexHull(HalfspaceIntersection(planes, np.array([a, b])).intersections)
        assert found.area_mm2[n] == pytest.approx(hull.volume, rel=1e-6, abs=1e-12)
        assert found.extent_mm[n] == pytest.approx(np.ptp(hull.points[hull.vertices], axis=0), rel=1e-6, abs=1e-9)


@pytest.mark.full
def test_raster_and_polygons_agree():
    """Blocks inside the window: cells counted against exact areas; one label a block."""
    camera = preset("pmr8")
    found = blocks(camera, yz_plane(), *WINDOW, (1500, 1500))
    count = np.bincount(found.label.ravel())
    cell = 2.0 * 0.6 / 1500**2
    low, high = found.polygon.min(1), found.polygon.max(1)
    inside = (low > (-1.0, -0.3)).all(1) & (high < (1.0, 0.3)).all(1) & (count > 2000)
    assert inside.sum() > 50
    np.testing.assert_allclose(count[inside] * cell, found.area_mm2[inside], rtol=0.02)
    assert count.sum() * cell == pytest.approx(1.2)
    points = yz_plane().points_mm(found.across_mm[::50].repeat(30), np.tile(found.up_mm[::50], 30))
    same_code = (codes(camera, points)[:, None] == codes(camera, points)).all((2, 3))
    label = found.label[::50, ::50].T.ravel()
    np.testing.assert_array_equal(same_code, label[:, None] == label)


@pytest.mark.parametrize("name", PMRS)
def test_the_block_about_the_focus_is_the_dead_zone(name):
    """The rhombus from z = -0.309 to +0.307 mm and one microlens high: the paper's +-0.308 mm, for every PMR."""
    camera = preset(name)
    found = blocks(camera, yz_plane(), (-0.5, 0.5), (-0.1, 0.1), (41, 41))
    n = found.label[20, 20]
    z, y = found.polygon[n].T
    assert (z.min(), z.max()) == pytest.approx(camera.dead_zone_mm())
    assert (z.min(), z.max()) == pytest.approx((-0.308, 0.308), abs=0.001)
    assert (y.min(), y.max()) == pytest.approx((-camera.lattice.pitch_mm / 2, camera.lattice.pitch_mm / 2))
    assert found.area_mm2[n] == pytest.approx(0.5 * np.ptp(z) * np.ptp(y))


def test_toward_the_camera_blocks_shrink():
    """Columns converge on the main lens: what is at +z is nearer to it, and finer, than what is at -z."""
    for camera in (preset("pmr14"), CAMERAS["half"]):
        near, far = blocks(camera, yz_plane(), (-1.0, 1.0), (-0.2, 0.2), (4, 4)), camera.dead_zone_mm()
        assert far[1] < -far[0]
        assert near.label.shape == (4, 4)
        z = np.array([-40.0, 40.0])
        behind, before = resolution_y(camera, z).mean_mm
        assert before < behind
        sums = [gaps_mm(camera, at).sum() for at in z]
        d = camera.main_lens.object_distance_mm - z
        assert sums == pytest.approx(camera.lattice.pitch_mm * d / camera.main_lens.image_distance_mm)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_axis_has_its_sign(axis):
    """A point just below a boundary on +axis goes far towards -axis and not far towards +axis; x moves i, y moves j."""
    camera, rays = CAMERAS["half"], corners_mm(CAMERAS["half"])
    start = np.array([0.0031, 0.0017, 0.43])
    e = np.eye(3)[axis]
    way = free_shift_mm(camera, start, e, rays)[0]
    point = start + (way - 1e-4) * e
    assert free_shift_mm(camera, point, e, rays)[0] == pytest.approx(1e-4)
    assert free_shift_mm(camera, point, -e, rays)[0] > 9e-4
    before, after = codes(camera, [point, point + 2e-4 * e], rays)
    moved = np.unique(after - before, axis=0)
    if axis < 2:  # the image is inverted: + moves the light to lower numbers
        expected = np.zeros(2, int)
        expected[axis] = -1
        assert {tuple(m) for m in moved} == {(0, 0), tuple(expected)}
    else:  # towards the camera rays spread: the microlens lies further out, on the side of the main lens' portion
        ray = np.any(after != before, axis=1)
        assert (((after - before)[ray] * rays[ray]).sum(1) > 0).all()


@pytest.mark.parametrize("name", ["square", "half"])
def test_resolution_y_against_steps(name):
    camera = CAMERAS[name]
    step = 1e-5
    for z in (-0.9, -0.1, 0.2, 0.613):
        pitch = camera.lattice.pitch_mm / abs(float(camera.scale(z)))
        y = np.arange(0.0, 3 * pitch, step)
        at = codes(camera, np.column_stack([np.zeros_like(y), y, np.full_like(y, z)]))
        changes = np.flatnonzero((at[1:] != at[:-1]).any((1, 2))) + 1
        # each step's way to the next change, over one pitch that starts at a change
        one = np.arange(changes[0], changes[0] + round(pitch / step))
        way = (changes[np.searchsorted(changes, one, side="right")] - one) * step
        found = resolution_y(camera, z)
        assert way.mean() == pytest.approx(found.mean_mm[0], abs=2 * step)
        assert np.diff(changes).max() * step == pytest.approx(found.largest_mm[0], abs=2 * step)
        assert resolution_x(camera, z) == found


def test_general_rule_is_the_closed_form():
    """mean_free_shift by sampling, and along x with the corners in space, is resolution_y on a square lattice."""
    camera = CAMERAS["square"]
    z = np.array([-0.8, -0.2, 0.3])
    exact = resolution_y(camera, z)
    image = np.column_stack([np.zeros(2000), (np.arange(2000) + 0.5) / 2000 * camera.lattice.pitch_mm])
    for direction, places in (((0, 1, 0), image), ((1, 0, 0), image[:, ::-1])):
        sampled = mean_free_shift(camera, z, direction, corners_mm(camera), places)
        assert sampled.mean_mm == pytest.approx(exact.mean_mm, rel=1e-3)
        assert sampled.largest_mm == pytest.approx(exact.largest_mm, rel=1e-9)


@pytest.mark.parametrize("name", PMRS)
def test_resolution_in_focus(name):
    """z = 0: one gap, a microlens wide; in depth half of (1 - |y|/(p/2)) x 0.616 mm, in the mean a quarter of it."""
    camera = preset(name)
    y, z = resolution_y(camera, 0.0), resolution_z(camera, 0.0)
    assert y.mean_mm[0] == pytest.approx(camera.lattice.pitch_mm / 2)
    assert y.largest_mm[0] == pytest.approx(camera.lattice.pitch_mm)
    whole = np.ptp(camera.dead_zone_mm())
    assert z.mean_mm[0] == pytest.approx(whole / 4, rel=1e-3)
    assert z.largest_mm[0] == pytest.approx(whole, rel=2e-3)


def test_small_spread_is_one_wide_gap_and_narrow_ones():
    """|A| P_m < p: PMR gaps of |A| portion/|B| and one that takes the rest."""
    camera = preset("pmr14")
    gaps = np.sort(gaps_mm(camera, 0.1))
    a, b = float(camera.spread(0.1)), abs(float(camera.scale(0.1)))
    assert gaps[:-1] == pytest.approx(np.full(14, a * camera.portion_mm / b))
    assert gaps[-1] == pytest.approx((camera.lattice.pitch_mm - a * camera.matched_aperture_mm) / b)


def test_what_the_paper_says_of_pmr():
    """In-plane resolution falls as PMR grows, about the focus; depth resolution rises, except on the focal plane."""
    near, away = np.linspace(-0.2, 0.2, 41), np.concatenate([np.linspace(-1.0, -0.4, 31), np.linspace(0.4, 1.0, 31)])
    in_plane = [resolution_y(preset(name), near).mean_mm.mean() for name in PMRS]
    in_depth = [resolution_z(preset(name), away, 200).mean_mm.mean() for name in PMRS]
    on_focus = [resolution_z(preset(name), 0.0).mean_mm[0] for name in PMRS]
    assert all(b > 1.5 * a for a, b in pairwise(in_plane))
    assert all(b < 0.75 * a for a, b in pairwise(in_depth))
    assert on_focus == pytest.approx([on_focus[0]] * 3, rel=1e-3)


@pytest.mark.full
def test_area_weighted_sizes_by_points():
    """The mean over a zone is the mean, over points strewn in it, of the block that holds each."""
    camera = preset("pmr8")
    found = blocks(camera, yz_plane(), *WINDOW, (800, 800))
    zone = np.abs(found.across_mm)[None].repeat(800, 0) < 0.3
    sizes = block_sizes(found, zone)
    rng = np.random.default_rng(2)
    points = np.column_stack([np.zeros(600), rng.uniform(-0.3, 0.3, (600, 2))])
    direct = blocks_of(camera, points)
    assert sizes.area_mm2 == pytest.approx(direct.mean(), rel=4 * direct.std() / direct.mean() / np.sqrt(600))
    assert sizes.across_mm > sizes.up_mm


def blocks_of(camera, points):
    """Area of the block of each point: its way out in many directions, as a polygon about the point."""
    angle = np.linspace(0, 2 * np.pi, 721)
    y, z = 0.05 * np.sin(angle), np.cos(angle)  # blocks are about as flat
    radius = np.array([free_shift_mm(camera, points, (0, b, a)) for a, b in zip(z, y, strict=True)])
    radius /= np.hypot(y, z)[:, None]  # in units of the flat ellipse
    turn = 0.05 * np.sin(np.diff(angle))
    return 0.5 * (turn[:, None] * radius[1:] * radius[:-1]).sum(0)


def test_square_blocks_of_an_xy_plane_are_rectangles():
    camera = preset("pmr8")
    found = blocks(camera, xy_plane(0.15), (-0.03, 0.03), (-0.03, 0.03), (60, 60), corners_mm(camera))
    assert found.area_mm2 == pytest.approx(found.extent_mm.prod(1))
    gaps = gaps_mm(camera, 0.15)
    for side in found.extent_mm.ravel():
        assert np.abs(gaps - side).min() < 1e-9
    both = np.concatenate([fan_mm(camera, "x"), fan_mm(camera, "y")])
    by_fans = blocks(camera, xy_plane(0.15), (-0.03, 0.03), (-0.03, 0.03), (60, 60), both)
    assert np.sort(by_fans.area_mm2) == pytest.approx(np.sort(found.area_mm2))


def test_hexagonal_blocks_in_focus_are_the_cells():
    camera = small_camera("hexagonal", pmr=6.0)
    found = blocks(camera, xy_plane(0.0), (-0.05, 0.05), (-0.05, 0.05), (50, 50), corners_mm(camera))
    assert found.area_mm2 == pytest.approx(np.full(len(found.polygon), camera.lattice.cell_area_mm2))
    p = camera.lattice.pitch_mm
    assert found.extent_mm == pytest.approx(np.tile([p, 2 * p / np.sqrt(3)], (len(found.polygon), 1)))


def test_hexagonal_lattices_resolve_no_worse():
    """The same pitch, hexagonal: smaller cells, more boundaries on the way."""
    z = np.array([-0.6, 0.4])
    square, hexagonal = (small_camera(kind, pmr=8.0) for kind in ("square", "hexagonal"))
    for direction in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        a, b = (mean_free_shift(c, z, direction, corners_mm(c)).mean_mm for c in (square, hexagonal))
        assert (b < a).all()


@pytest.mark.parametrize("lattice", [Lattice("square", 0.05, 0.3, (0.01, 0.02)), Lattice("hexagonal", 0.05, 0.2)])
def test_places_cover_a_cell_evenly(lattice):
    """Wrapped about the microlens that holds them, they fill its cell: centred on it, and of its second moment."""
    places = places_mm(lattice, 60)
    about = places - np.stack(lattice.centres(*lattice.nearest(*places.T)), 1)
    assert about.mean(0) == pytest.approx([0.0, 0.0], abs=0.01 * lattice.pitch_mm)
    moment = {"square": 1 / 12, "hexagonal": 5 / 72}[lattice.kind]
    assert np.cov(about.T) == pytest.approx(moment * lattice.pitch_mm**2 * np.eye(2), abs=0.001 * lattice.pitch_mm**2)


def test_in_a_block_the_lit_pixels_stay_and_their_shares_do_not():
    """What "cannot be distinguished" leaves out: a column split between microlenses tells where in the block."""
    camera = preset("pmr14")

    def shares(points):
        light = [point_light(camera, p) for p in points]
        out = np.zeros((len(points), camera.sensor.rows * camera.sensor.columns))
        for row, of in zip(out, light, strict=True):
            row[of.pixel] = of.share
        return out

    def change(a, b):
        assert (codes(camera, [a], corners_mm(camera)) == codes(camera, [b], corners_mm(camera))).all()
        first, second = shares([a, b])
        return 0.5 * np.abs(first - second).sum()

    one_lens = change((0.0, 0.0, 0.02), (0.0, 0.0, 0.2))
    start = np.array([0.004, 0.003, 0.6])
    way = free_shift_mm(camera, start, (0, 0, 1), corners_mm(camera))[0]
    split = change(start, start + np.array([0, 0, 0.9 * way]))
    assert split / (0.9 * way) > 2 * one_lens / 0.18


def test_bad_input_is_named():
    camera = preset("pmr8")
    with pytest.raises(PlenoPIVError, match="below 100 mm"):
        codes(camera, [(0.0, 0.0, 100.0)])
    with pytest.raises(PlenoPIVError, match=r"\(n, 3\)"):
        free_shift_mm(camera, [(0.0, 0.0)], (1, 0, 0))
    with pytest.raises(PlenoPIVError, match="empty"):
        blocks(camera, yz_plane(), (1.0, -1.0), (0.0, 0.1))
    for lattice in (Lattice("hexagonal", 0.044), Lattice("square", 0.044, 0.01)):
        for function in (lambda c: resolution_y(c, 0.0), lambda c: boundary_lines(c, *WINDOW)):
            with pytest.raises(PlenoPIVError, match="square lattice"):
                function(camera.with_lattice(lattice))
