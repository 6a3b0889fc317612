"""Pixels that are lost, and those that are saturated: what voxels and vectors make of them."""

import numpy as np
import pytest
from oracles.cameras import projected_point, single_voxel, small_camera

from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.chain import Chain
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.mart import mart
from plenopiv.reconstruction.usable import usable_share
from plenopiv.sensor import Sensor, at_full_scale
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.3, 0.3), (-0.25, 0.25), (-1.6, 1.6), (0.044, 0.044, 0.132))
POINTS = [(0.0, 0.0, 0.9), (0.13, -0.07, -1.3), (-0.11, 0.15, 0.35)]


def shares(camera, unusable, grid, volume, weights="exact"):
    projector = PlenopticProjector(layout(camera, unusable), grid, weights)
    return usable_share(projector, projector.whole(), volume)


def random_mask(camera, seed, share=0.3, side=5):
    """Squares of some pixels."""
    rng = np.random.default_rng(seed)
    rows, columns = camera.sensor.rows, camera.sensor.columns
    coarse = rng.random((-(-rows // side), -(-columns // side))) < share
    return np.kron(coarse, np.ones((side, side), bool))[:rows, :columns]


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.full)])
def test_the_share_is_that_of_the_projected_light(kind, point, seed):
    """Against the light of a point, pixel by pixel, in the pixels that are left."""
    camera = small_camera(kind, pmr=8, microlenses=(40, 36))
    unusable = random_mask(camera, seed)
    whole, masked = layout(camera), layout(camera, unusable)
    np.testing.assert_array_equal(masked.offsets, whole.offsets)
    np.testing.assert_array_equal(masked.seen | masked.lost, whole.seen)
    assert not (masked.seen & masked.lost).any()
    light = projected_point(whole, point)
    expected = light[masked.seen].sum() / light.sum()
    assert 0.3 < expected < 0.95
    for weights in ("exact", "polygons"):
        (share,) = shares(camera, unusable, *single_voxel(point), weights)
        assert share == pytest.approx(expected, abs=0.03)


def test_voxels_behind_a_masked_corner_are_those_of_that_corner():
    """The upper left of an upright image shows small x and large y."""
    camera = small_camera("hexagonal", pmr=8, microlenses=(40, 36))
    unusable = np.zeros((camera.sensor.rows, camera.sensor.columns), bool)
    unusable[: camera.sensor.rows // 2, : camera.sensor.columns // 2] = True
    for x, y, expected in ((-0.9, 0.8, 0.0), (0.9, 0.8, 1.0), (-0.9, -0.8, 1.0), (0.9, -0.8, 1.0)):
        (share,) = shares(camera, unusable, *single_voxel((x, y, 0.5)))
        assert share == pytest.approx(expected, abs=1e-6)
    (half,) = shares(camera, unusable, *single_voxel((0.0, 0.8, 0.5)))
    assert half == pytest.approx(0.5, abs=0.1)


def test_of_two_cameras_the_light_of_both_counts():
    """The first camera has lost nothing."""
    camera = small_camera("hexagonal", pmr=8, microlenses=(40, 40))
    grid = VoxelGrid.covering((-0.3, 0.3), (-0.3, 0.3), (-0.3, 0.3), (0.05, 0.05, 0.05))
    unusable = random_mask(camera, 3, share=0.7)
    chain = Chain((camera, camera), grid, poses=(FRONT, SIDE), unusable=(None, unusable))
    voxels = SparseVolume.from_mask(grid, np.ones(grid.shape, bool))
    share = usable_share(chain.projection, chain.projection.whole(), voxels)
    turned = SIDE.grid(grid)
    own = shares(camera, unusable, turned, SparseVolume.from_mask(turned, np.ones(turned.shape, bool)))
    assert own.mean() < 0.5
    assert share.mean() == pytest.approx(0.5 + 0.5 * own.mean(), abs=0.02)
    assert share.min() > 0.4


def test_a_few_hot_pixels_cost_nothing():
    camera = small_camera("hexagonal", pmr=14, microlenses=(20, 18))
    hot = np.zeros((camera.sensor.rows, camera.sensor.columns), bool)
    assert layout(camera).lost_share == 0
    hot[100, ::40] = True
    assert 0 < layout(camera, hot).lost_share < 0.1
    assert Chain((camera,), GRID, unusable=(hot,))._whole is None
    hot[90:130, 90:130] = True
    assert layout(camera, hot).lost_share == 1
    assert Chain((camera,), GRID, unusable=(hot,))._whole is not None


def test_saturation_is_found_with_fractions_of_counts_in_the_black_level():
    for level in (0.0, 60.3, 59.7):
        sensor = Sensor(16, 16, 0.0055, 12, level)
        counts = np.array([4095, 4094], np.float32) - np.float32(level)
        assert at_full_scale(counts, sensor).tolist() == [True, False]


@pytest.fixture(scope="module")
def clipped():
    """A projector, a volume, its views, and which pixels of these saturate where the light is cut at a tenth of the
    brightest."""
    projector = PlenopticProjector(layout(small_camera("square", pmr=8, offset_mm=(0.011, -0.005))), GRID)
    rng = np.random.default_rng(0)
    truth = SparseVolume.from_mask(GRID, rng.random(GRID.shape) < 0.01)
    truth = truth.with_values(rng.uniform(5e3, 5e4, truth.column.size).astype(np.float32))
    values = projector.forward(np.arange(projector.views), truth)
    full = np.float32(0.1 * values.max())
    return projector, truth, np.minimum(values, full), values >= full


def test_saturated_pixels_take_no_light_away(clipped):
    projector, truth, values, saturated = clipped
    assert 0.01 < saturated.mean() < 0.5
    settings = {"iterations": 2, "relaxation": 0.5}
    kept, residuals = mart(values, projector, truth, saturated=saturated, **settings)
    np.testing.assert_allclose(kept.values, truth.values, rtol=1e-4)
    assert residuals[0] < 1e-3 * values.max()
    lost, _ = mart(values, projector, truth, **settings)
    assert lost.values.sum() < 0.8 * truth.values.sum()


def test_saturated_pixels_add_light_where_it_is_missing(clipped):
    projector, truth, values, saturated = clipped
    dim = truth.with_values((0.02 * truth.values).astype(np.float32))
    risen, _ = mart(values, projector, dim, iterations=1, relaxation=0.5, saturated=saturated)
    without, _ = mart(np.where(saturated, 0, values), projector, dim, iterations=1, relaxation=0.5)
    assert risen.values.sum() > 3 * dim.values.sum()
    assert risen.values.sum() > 1.5 * without.values.sum()
