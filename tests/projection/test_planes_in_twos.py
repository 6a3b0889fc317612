"""Planes far from focus, where maps are wide, are read off one map in twos when several views are asked at once."""

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import SparseVolume, VoxelGrid

X_MM, Y_MM, VOXEL_MM = (-0.41, 0.39), (-0.3, 0.33), 0.0085


def projector_of(z_mm, step_mm, kind="hexagonal"):
    grid = VoxelGrid.covering(X_MM, Y_MM, z_mm, (VOXEL_MM, VOXEL_MM, step_mm))
    return PlenopticProjector(layout(small_camera(kind, pmr=8, rotation_rad=0.002)), grid)


def some_light(projector, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(projector.grid, rng.random(projector.grid.shape) < 0.01)
    return volume.with_values(rng.random(volume.column.size).astype(np.float32) * 1000)


def counts(projector):
    return [np.diff(read.first) for read in projector.images.pairs]


@pytest.mark.parametrize("side", [-1, 1])
def test_planes_far_from_focus_are_joined_both_ways(side):
    projector = projector_of(tuple(sorted((9.5 * side, 10.2 * side))), 0.05)
    even, odd = counts(projector)
    assert even.sum() == odd.sum() == projector.grid.shape[0] == 14
    assert list(even) == [2] * 7
    assert list(odd) == [1] + [2] * 6 + [1]
    read = projector.images.pairs[0]
    np.testing.assert_allclose(
        read.table, (projector.camera.planes[::2] + projector.camera.planes[1::2]) / 2, rtol=1e-6
    )


@pytest.mark.parametrize(("z_mm", "step_mm"), [((-0.7, 0.7), 0.05), ((-9.0, 9.0), 1.5)])
def test_planes_near_focus_or_far_apart_are_not(z_mm, step_mm):
    for count in counts(projector_of(z_mm, step_mm)):
        assert (count == 1).all()


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_light_is_off_by_little_and_to_either_side(kind):
    """One view after the other has planes to themselves; with the other neighbour light is off the other way."""
    projector = projector_of((9.0, 9.7), 0.05, kind)
    volume, by_distance = some_light(projector), np.argsort(np.hypot(*projector.layout.offsets.T))
    view = by_distance[projector.views // 2]
    even, odd = (next(v for v in range(projector.views) if v % 2 == n and v != view) for n in (0, 1))
    alone = projector.forward(view, volume)
    one, other = (projector.forward([first, view], volume)[1] for first in (even, odd))
    assert 0 < np.std(one - alone) < 0.05 * np.std(alone)
    assert 0 < np.std(other - alone) < 0.05 * np.std(alone)
    assert np.std((one + other) / 2 - alone) < 0.5 * np.std(one - alone)
    assert one.sum() == pytest.approx(alone.sum(), rel=5e-3)


@pytest.mark.parametrize("first", [0, 1])
def test_forward_and_back_are_transposes(first):
    projector = projector_of((-9.7, -9.0), 0.05)
    volume, views = some_light(projector), [first, 20, 21]
    images = np.random.default_rng(1).normal(size=(3, projector.layout.lenses)).astype(np.float32)
    light = projector.light_of_planes()[np.repeat(np.arange(14), np.diff(volume.row_start[:: projector.grid.shape[1]]))]
    ahead = float(np.sum(projector.forward(views, volume).astype(np.float64) * images))
    back = float(np.sum(projector.gather(views, images, volume).astype(np.float64) * volume.values * light))
    assert ahead == pytest.approx(back, rel=2e-3)
