"""What a map of space leaves: light of each view that falls beside that of a thin lens."""

import pickle

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.cameras.lens_space import behind_window, images_of, sample, space_map
from plenopiv.cameras.medium import Medium
from plenopiv.cameras.plenoptic import MainLens, PlenopticCamera
from plenopiv.cameras.space_map import PLACE_POWERS, ViewShift
from plenopiv.chain import Chain
from plenopiv.lattice import Lattice
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.geometry import CameraOnGrid
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.sensor import Sensor
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-0.4, 0.4), (-0.3, 0.3), (0.9, 1.1), (0.02, 0.02, 0.2))
CAMERA = PlenopticCamera(MainLens(50.0, 22.0, -1.0), Lattice("hexagonal", 0.077), 0.308, Sensor(1200, 960, 0.0055))
WATER = Medium(1.333, 100.0, 10.0, 1.52)
BOX = (-2.5, 2.5), (-2.0, 2.0), (-5.0, 5.0)


def volume(seed=1, move=(0, 0)):
    rng = np.random.default_rng(seed)
    dense = np.zeros(GRID.shape, np.float32)
    dense[:, 8:-8, 10:-10] = np.where(rng.random(dense[:, 8:-8, 10:-10].shape) > 0.97, 100.0, 0.0)
    dense = np.roll(dense, move, (1, 2))
    listed = SparseVolume.from_mask(GRID, dense > 0)
    return listed.with_values(dense[listed.mask()])


@pytest.fixture(scope="module", params=["hexagonal", "square"])
def where(request):
    return layout(small_camera(request.param, pmr=8, microlenses=(16, 12), offset_mm=(0.01, -0.02)))


@pytest.fixture(scope="module")
def behind_water():
    return space_map(behind_window(CAMERA, WATER), CAMERA, BOX)


def even(where, ds, dt):
    """The same shift in all views and places."""
    shifts = np.zeros((where.views, len(PLACE_POWERS), 2), np.float32)
    shifts[:, 0] = ds, dt
    return shifts


@pytest.mark.parametrize("weights", ["exact", "polygons"])
@pytest.mark.parametrize(("axis", "move"), [(0, (0, 1)), (1, (1, 0))])
def test_light_that_falls_a_voxel_aside_is_that_of_the_next_voxel(where, weights, axis, move):
    scale = float(where.camera.scale(GRID.axes()[2][0]))
    shift = np.zeros(2)
    shift[axis] = scale * GRID.voxel_mm[axis]
    moved = PlenopticProjector(where, GRID, weights, shifts=even(where, *shift))
    plain = PlenopticProjector(where, GRID, weights)
    views = np.flatnonzero(np.hypot(*where.offsets.T) < 3)
    expected = plain.forward(views, volume(move=move))
    np.testing.assert_allclose(moved.forward(views, volume()), expected, atol=2e-3 * expected.max())
    assert np.abs(plain.forward(views, volume()) - expected).max() > 0.05 * expected.max()


def test_places_of_lenses_are_moved_by_the_polynomial_of_each_view(where):
    shifts = np.random.default_rng(4).normal(0, 1e-2, (where.views, len(PLACE_POWERS), 2)).astype(np.float32)
    moved = CameraOnGrid(where, GRID, shifts)
    for view in (0, where.views // 2):
        for (s, t), place in zip(moved.lens_mm[::7], moved.places_mm(view)[::7], strict=True):
            beside = sum(shifts[view, k] * s**p * t**q for k, (p, q) in enumerate(PLACE_POWERS))
            np.testing.assert_allclose(place, np.array([s, t]) - beside, atol=1e-6)


def test_forward_and_back_stay_transposes(where):
    rng = np.random.default_rng(2)
    shifts = rng.normal(0, 2e-3, (where.views, len(PLACE_POWERS), 2)).astype(np.float32)
    shifts[:, 1:] *= 0.3
    projector = PlenopticProjector(where, GRID, shifts=shifts)
    views, listed = np.arange(where.views), volume()
    images = np.where(where.seen, rng.random(where.seen.shape), 0).astype(np.float32)
    light = GRID.shape, projector.light_of_planes()[0]
    there = float((projector.forward(views, listed) / light[1] * images).sum(dtype=np.float64))
    back = float((projector.gather(views, images, listed) * listed.values).sum(dtype=np.float64))
    assert there == pytest.approx(back, rel=1e-5)


def test_maps_and_polygons_agree_with_shifts(where):
    shifts = np.random.default_rng(3).normal(0, 4e-3, (where.views, len(PLACE_POWERS), 2)).astype(np.float32)
    views = np.flatnonzero(np.hypot(*where.offsets.T) < 2.5)
    with_shifts, without = (
        [PlenopticProjector(where, GRID, w, shifts=s).forward(views, volume()) for w in ("exact", "polygons")]
        for s in (shifts, None)
    )
    apart, apart_without = (np.abs(a - b).mean() / b.mean() for a, b in (with_shifts, without))
    assert apart < 1.2 * apart_without < 0.07
    assert np.abs(with_shifts[1] - without[1]).mean() > 5 * np.abs(with_shifts[0] - with_shifts[1]).mean()


def test_candidates_are_where_the_light_says(where):
    """A particle alone: with the shifts that its image was made with its voxel stays, without them it is ruled out."""
    scale = float(where.camera.scale(GRID.axes()[2][0]))
    shifts = even(where, 3 * scale * GRID.voxel_mm[0], 0.0)
    mask = np.zeros(GRID.shape, bool)
    mask[0, 15, 20] = True
    particle = SparseVolume.from_mask(GRID, mask, 3000.0)
    projector = PlenopticProjector(where, GRID, shifts=shifts)
    most = np.where(where.seen, projector.forward(np.arange(where.views), particle) * 1.3 + 2.0, np.inf)
    assert projector.candidates(most.astype(np.float32), 3000.0).mask()[0, 15, 20]
    assert not PlenopticProjector(where, GRID).candidates(most.astype(np.float32), 3000.0).mask()[0, 15, 20]


def test_what_water_leaves_is_held(behind_water):
    """Rays of points anywhere in the volume fall where the map and what it leaves say; depth is that of the rays."""
    points = np.random.default_rng(4).uniform(*np.array(BOX).T, (60, 3))
    images = images_of(points, behind_window(CAMERA, WATER), CAMERA)
    place, (s, u) = behind_water.to_lens(points), (images.s_mm, images.u_mm)
    a, b = (np.array([f(z) for z in place[:, 2]])[:, None, None] for f in (CAMERA.spread, CAMERA.scale))
    beside = s - a * u - b * place[:, None, :2]
    left = beside - behind_water.left(u.reshape(-1, 2), s.reshape(-1, 2)).reshape(s.shape)
    on_sensor = (np.abs(s) < [3.3, 2.64]).all(-1)
    before, after = (np.sqrt((v[on_sensor] ** 2).sum(-1).mean()) for v in (images.left_mm, left))
    assert before > 4e-3
    assert after < 0.06 * before
    whole = on_sensor.all(1)
    by_depth = (left * u).sum((1, 2)) / (u**2).sum((1, 2))  # change of A(z) that the rays ask for
    step = float(CAMERA.spread(0.5) - CAMERA.spread(-0.5))
    assert whole.sum() > 30
    assert np.abs(by_depth[whole] / step).max() < 1.5e-3  # mm; 0.01 where images are sought once


def test_sums_of_a_view_are_its_polynomial(behind_water):
    left = behind_water.left
    views, s = np.array([[9.0, 2.0], [-4.0, -8.0]]), np.random.default_rng(5).uniform(-2, 2, (50, 2))
    for view, sums in zip(views, left.of_views(views), strict=True):
        terms = np.stack([s[:, 0] ** p * s[:, 1] ** q for p, q in PLACE_POWERS], 1)
        expected = left(np.tile(view, (50, 1)), s)
        assert np.abs(terms @ sums - expected).max() < 0.008 * CAMERA.lattice.pitch_mm
        assert np.abs(expected).max() > 0.05 * CAMERA.lattice.pitch_mm


def test_a_polynomial_is_found_exactly():
    rng = np.random.default_rng(6)
    u, s = rng.uniform(-12, 12, (500, 2)), rng.uniform(-3, 3, (500, 2))
    left = np.stack([1e-6 * u[:, 0] ** 3 + 1e-4 * s[:, 1] * u[:, 1], 2e-6 * u[:, 1] * (u**2).sum(1)], 1)
    np.testing.assert_allclose(ViewShift.fitted(u, s, left, 3)(u, s), left, atol=1e-12)


def test_in_air_nothing_is_left():
    assert space_map(behind_window(CAMERA, Medium()), CAMERA, BOX).left is None


def test_a_chain_in_water_has_shifts_and_pickles(behind_water):
    camera = small_camera("hexagonal", pmr=8, microlenses=(16, 12))
    chain = Chain(
        (camera,), VoxelGrid.covering((-0.3, 0.3), (-0.3, 0.3), (0.9, 1.3), (0.02, 0.02, 0.2)), space=behind_water
    )
    again = pickle.loads(pickle.dumps(chain))
    shifts = chain.projection.camera.shifts
    assert shifts.shape == (chain.layout.views, len(PLACE_POWERS), 2)
    assert shifts.tobytes() == again.projection.camera.shifts.tobytes()
    outer = np.hypot(*chain.layout.offsets.T) > 3
    assert np.abs(shifts[outer, 0]).max() > 1e-3
    assert len(sample(BOX)) == 9 * 9 * 13
