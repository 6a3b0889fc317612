"""Tiles: which pixels are equations of one, and that together they are the whole."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import LightField, layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.reconstruct import reconstruct
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.3, 0.3), (-0.6, 0.6), (-1.2, 1.2), (0.02, 0.02, 0.1))
SETTINGS = ReconstructionSettings(method="drt-mart", iterations=4)


@pytest.fixture(scope="module")
def projector():
    where = layout(small_camera("hexagonal", pmr=8, microlenses=(15, 23), offset_mm=(0.011, -0.005)))
    return PlenopticProjector(where, GRID, "exact")


def particles(rows, count=20, seed=0):
    """A few in these rows, each three voxels deep."""
    rng, values = np.random.default_rng(seed), np.zeros(GRID.shape, np.float32)
    nz, _, nx = GRID.shape
    for k, j, i in zip(
        rng.integers(1, nz - 1, count), rng.integers(*rows, count), rng.integers(5, nx - 5, count), strict=True
    ):
        values[k - 1 : k + 2, j, i] = (1e4, 2e4, 1e4)
    volume = SparseVolume.from_mask(GRID, values > 0)
    return volume.with_values(values[values > 0])


def image_of(projector, volume):
    light = np.array([projector.forward(v, volume) for v in range(projector.views)])
    return LightField(projector.layout, light.astype(np.float32))


def test_tiles_cover_each_row_once_with_a_margin():
    tiles = cut(101, 3, 14)
    assert [j for t in tiles for j in range(t.first, t.end)] == list(range(101))
    assert [(t.low, t.high) for t in tiles] == [(0, 40), (26, 74), (60, 101)]
    assert cut(101, 1, 14) == [(0, 101, 0, 101)]


def test_equations_of_a_tile_get_no_light_from_outside(projector):
    low, high = 20, 42
    outside = np.ones(GRID.shape, bool)
    outside[:, low:high] = False
    light = image_of(projector, SparseVolume.from_mask(GRID, outside)).values
    kept = projector.tile(low, high).seen
    assert 0.02 < kept.mean() < 0.5
    assert light[kept].max() == 0
    assert light[projector.seen & ~kept].max() > 0


def test_a_row_is_seen_by_equations_within_its_passage(projector):
    row, reach = 30, projector.passage
    here = np.zeros(GRID.shape, bool)
    here[:, row] = True
    light = image_of(projector, SparseVolume.from_mask(GRID, here)).values
    assert projector.tile(row - reach, row + reach + 1).seen[light > 0].all()
    assert not projector.tile(row - reach // 3, row + reach // 3 + 1).seen[light > 0].all()


@pytest.mark.parametrize("count", [2, 3])
def test_tiles_together_are_the_whole(projector, count):
    truth = particles((3, GRID.shape[1] - 3))
    frame = image_of(projector, truth)
    whole = reconstruct(frame.values, projector, SETTINGS)
    steps = []
    tiles = cut(GRID.shape[1], count, projector.passage)
    found = reconstruct(frame.values, projector, SETTINGS, tiles=tiles, progress=lambda *step: steps.append(step))
    assert found.volume.grid == GRID
    assert steps == sorted(steps)
    assert steps[-1][0] == steps[-1][1]
    assert found.candidates == pytest.approx(whole.candidates, rel=0.1)
    assert found.threshold == pytest.approx(whole.threshold, rel=0.2)
    assert len(found.residuals) == SETTINGS.iterations

    def quality(volume):
        a, b = truth.dense().values, volume.dense().values
        return float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()))

    print(f"\nQ of the whole {quality(whole.volume):.3f}, of {count} tiles {quality(found.volume):.3f}")
    assert quality(found.volume) > quality(whole.volume) - 0.02


def test_one_tile_is_the_whole(projector):
    frame = image_of(projector, particles((3, 57)))
    whole = reconstruct(frame.values, projector, SETTINGS)
    found = reconstruct(frame.values, projector, SETTINGS, tiles=cut(GRID.shape[1], 1, 9))
    np.testing.assert_array_equal(found.volume.values, whole.volume.values)


def test_a_tile_may_hold_nothing_but_not_all_of_them(projector):
    frame, tiles = image_of(projector, particles((4, 12))), cut(GRID.shape[1], 3, projector.passage)
    found = reconstruct(frame.values, projector, SETTINGS, tiles=tiles).volume
    assert found.y_range(0, 20).column.size > 0
    assert found.y_range(40, 60).column.size == 0
    with pytest.raises(PlenoPIVError, match="no particles"):
        reconstruct(np.zeros_like(frame.values), projector, SETTINGS, tiles=tiles)
