"""MART's fixed point and signs, on data that the projector made and on noise."""

import itertools

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.mart import mart
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.3, 0.3), (-0.25, 0.25), (-1.6, 1.6), (0.044, 0.044, 0.132))
PROJECTORS = {}


def projector_of(kind, rule="exact"):
    if (kind, rule) not in PROJECTORS:
        where = layout(small_camera(kind, pmr=8, offset_mm=(0.011, -0.005)))
        PROJECTORS[kind, rule] = PlenopticProjector(where, GRID, rule)
    return PROJECTORS[kind, rule]


def particles(share, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(GRID, rng.random(GRID.shape) < share)
    return volume.with_values(rng.uniform(5e3, 5e4, volume.column.size).astype(np.float32))


def views_of(projector, volume):
    return np.array([projector.forward(v, volume) for v in range(projector.views)])


@pytest.mark.parametrize("share", [0.01, 0.7], ids=["sparse", "dense"])
@pytest.mark.parametrize("relaxation", [1.0, 0.3])
@pytest.mark.parametrize(("kind", "rule"), [("square", "exact"), ("hexagonal", "exact"), ("square", "9-rays")])
def test_the_true_volume_stays(kind, rule, relaxation, share):
    projector, truth = projector_of(kind, rule), particles(share)
    values = views_of(projector, truth)
    again, residuals = mart(values, projector, truth, iterations=1, relaxation=relaxation, floor=1.0)
    np.testing.assert_array_equal(again.column, truth.column)
    change = np.abs(again.values / truth.values - 1)
    print(f"\n{kind} {rule} {relaxation} {share}: largest relative change {change.max():.1e}")
    assert change.max() <= 1e-5
    assert residuals[0] <= 1e-4 * values.max()


def test_the_given_volume_is_not_touched():
    projector, truth = projector_of("square"), particles(0.01)
    before = truth.values.copy()
    mart(2 * views_of(projector, truth), projector, truth, iterations=1, relaxation=1.0)
    np.testing.assert_array_equal(truth.values, before)


@pytest.mark.parametrize("share", [0.01, 0.7], ids=["sparse", "dense"])
@pytest.mark.parametrize("relaxation", [1.0, 0.3])
def test_voxels_stay_positive_on_noise(relaxation, share):
    projector = projector_of("hexagonal")
    rng = np.random.default_rng(1)
    values = rng.normal(0, 50, projector.layout.seen.shape).astype(np.float32) * projector.layout.seen
    volume, residuals = mart(values, projector, particles(share), iterations=3, relaxation=relaxation, floor=2.0)
    assert np.isfinite(volume.values).all()
    assert (volume.values > 0).all()  # and what reached 0 is no longer listed
    assert np.isfinite(residuals).all()


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_residuals_fall(kind):
    projector, truth = projector_of(kind), particles(0.01)
    values = views_of(projector, truth)
    start = projector.every_voxel()
    start = start.with_values(np.full(GRID.size, truth.values.sum() / GRID.size, np.float32))
    _, residuals = mart(values, projector, start, iterations=4, relaxation=0.5, floor=1.0)
    print(f"\n{kind}: residuals {', '.join(f'{r:.1f}' for r in residuals)} counts")
    assert all(after < before for before, after in itertools.pairwise(residuals))
    assert residuals[-1] < 0.6 * residuals[0]


def test_too_much_light_is_taken_back_and_missing_light_given():
    """One voxel alone: its views ask for half, or twice, its light, and with mu = 1 one view is enough to say so."""
    projector = projector_of("square")
    mask = np.zeros(GRID.shape, bool)
    mask[GRID.shape[0] // 2, 5, 6] = True
    truth = SparseVolume.from_mask(GRID, mask, 2e4)
    values = views_of(projector, truth)
    for factor in (0.5, 2.0):
        volume, _ = mart(factor * values, projector, truth, iterations=2, relaxation=1.0, floor=0.01)
        assert volume.values[0] == pytest.approx(factor * 2e4, rel=0.01)


@pytest.mark.parametrize("share", [0.01, 0.7], ids=["sparse", "dense"])
def test_the_faintest_voxels_are_left_out(share):
    """Those below the share asked for of the mean of what is left, which rises as they go."""
    projector, truth = projector_of("square"), particles(share)
    values = views_of(projector, truth)
    all_of_them, _ = mart(values, projector, truth, iterations=1, relaxation=0.5)
    volume, _ = mart(values, projector, truth, iterations=1, relaxation=0.5, thin=0.8)
    assert all_of_them.column.size == truth.column.size
    assert 0.2 < volume.column.size / truth.column.size < 0.8
    assert volume.values.min() > 0.8 * truth.values.mean()


def test_no_thinning_empties_a_volume():
    projector, truth = projector_of("square"), particles(0.01)
    volume, _ = mart(0 * views_of(projector, truth), projector, truth, iterations=2, relaxation=0.5, thin=0.9)
    assert volume.column.size


def test_the_first_round_takes_twice_the_relaxation():
    """Small powers add up: after two rounds 2 mu + mu, half as much again as after one."""
    projector, truth = projector_of("square"), particles(0.01)
    values = 1.1 * views_of(projector, truth)
    gains = [
        np.log(mart(values, projector, truth, iterations=n, relaxation=1e-3)[0].values / truth.values).mean()
        for n in (1, 2)
    ]
    assert gains[1] / gains[0] == pytest.approx(1.5, rel=0.05)


def test_progress_counts_views():
    projector, truth, seen = projector_of("square"), particles(0.01), []
    mart(
        views_of(projector, truth),
        projector,
        truth,
        iterations=2,
        relaxation=1.0,
        progress=lambda done, total: seen.append((done, total)),
    )
    total = 2 * projector.views
    assert seen == [(k + 1, total) for k in range(total)]


def test_the_same_in_the_memory_of_the_start():
    """The start is as it was, unless it may be overwritten; what comes out is the same to the bit."""
    projector, start = projector_of("square"), particles(0.2)
    values, before = views_of(projector, start), start.values.copy()
    settings = {"iterations": 3, "relaxation": 0.25, "thin": 0.5}
    apart, residuals = mart(values, projector, start, **settings)
    np.testing.assert_array_equal(start.values, before)
    inside, again = mart(values, projector, start, overwrite=True, **settings)
    for one, other in (
        (apart.row_start, inside.row_start),
        (apart.column, inside.column),
        (apart.values, inside.values),
    ):
        np.testing.assert_array_equal(one, other)
    assert residuals == again
    assert 0 < apart.column.size < before.size
