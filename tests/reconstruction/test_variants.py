"""When one view at a time is the paper's MART, one pixel at a time; and what the benchmark's variants rest on."""

import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.reconstruction.mart import mart
from plenopiv.reconstruction.thinning import keeping
from plenopiv.volume import SparseVolume, VoxelGrid

SCRIPTS = Path(__file__).parents[2] / "benchmarks" / "reconstruction"
sys.path.insert(0, str(SCRIPTS))
from pixel_sequential import light_of_a_pixel, pixel_sequential, shares  # noqa: E402
from resampling import covariance_factor, resampled, variance_factor  # noqa: E402
from variants import (  # noqa: E402
    candidates,
    golden_order,
    random_order,
    residual,
    rim_first,
    simultaneous,
    view_sequential,
)

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("one_thread")]

WHERE = layout(small_camera("hexagonal", pmr=8, microlenses=(11, 9), offset_mm=(0.011, -0.005)))
GRID = VoxelGrid.covering((-0.12, 0.12), (-0.1, 0.1), (-1.6, 1.6), (0.022, 0.022, 0.132))
FLOOR = 1.0


def whole_views(projector, k):
    """The views whose pixels the aperture fills, in a random order."""
    whole = (projector.layout.fill == 1).all(1)
    return np.random.default_rng(k).permutation(np.flatnonzero(whole))


def particles(projector, share=0.2, seed=0):
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(GRID, rng.random(GRID.shape) < share)
    return volume.with_values(rng.uniform(5e2, 5e3, volume.values.size).astype(np.float32))


def noisy_views(projector, volume, seed=1):
    light = np.array([projector.forward(v, volume) for v in range(projector.views)])
    noise = np.random.default_rng(seed).normal(0, 0.1 * light.std(), light.shape)
    return ((light + noise) * projector.layout.seen).astype(np.float32)


def meeting_one_lens_a_view(projector, volume):
    """The voxels that light at most one pixel of every view. With one ray a view that is so but between two microlenses
    of different phase, where both rays may meet a voxel, or none."""
    pixels = np.max([np.diff(m.tocsr().indptr) for m in shares(projector, volume)], axis=0)
    return keeping(volume, pixels <= 1)


def started(values, volume):
    return volume.with_values(np.full(volume.values.size, values.sum() / volume.values.size, np.float32))


def largest_difference(a, b):
    """Over the brightest voxel."""
    return np.abs(a.values - b.values).max() / b.values.max()


@pytest.fixture(scope="module")
def one_ray_case():
    projector = PlenopticProjector(WHERE, GRID, "1-ray")
    every = particles(projector)
    truth = meeting_one_lens_a_view(projector, every)
    assert 0.3 * every.values.size < truth.values.size < every.values.size  # of 50 views, not one meets it twice
    values = noisy_views(projector, truth)
    return projector, values, started(values, truth)


@pytest.mark.parametrize("relaxation", [1.0, 0.3])
def test_a_round_of_views_is_a_round_of_pixels_where_each_voxel_meets_one_lens(one_ray_case, relaxation):
    """Whole pixels have the share 1, for which the sum is the product: the library's step is the paper's equation."""
    projector, values, start = one_ray_case
    settings = {"relaxation": (relaxation,), "floor": FLOOR, "order": whole_views}
    of_views = list(islice(view_sequential(values, projector, start, **settings), 3))
    of_pixels = list(islice(pixel_sequential(values, projector, start, **settings), 3))
    differences = [largest_difference(a, b) for a, b in zip(of_views, of_pixels, strict=True)]
    print(f"\nmu {relaxation}: {', '.join(f'{d:.1e}' for d in differences)}")
    assert max(differences) < 2e-5
    assert largest_difference(of_pixels[0], start) > 0.1


@pytest.mark.parametrize("relaxation", [1.0, 0.3])
def test_as_powers_it_is_so_for_pixels_of_any_share(one_ray_case, relaxation):
    """Rim pixels, lit in part, as well."""
    projector, values, start = one_ray_case
    settings = {"relaxation": (relaxation,), "floor": FLOOR}
    of_views = next(view_sequential(values, projector, start, form="powers", order=random_order(3), **settings))
    of_pixels = next(pixel_sequential(values, projector, start, order=random_order(3), **settings))
    sums = next(view_sequential(values, projector, start, order=random_order(3), **settings))
    assert largest_difference(of_views, of_pixels) < 2e-5
    assert 1e-4 < largest_difference(sums, of_pixels) < 0.1


@pytest.mark.parametrize("form", ["sums", "powers"])
def test_split_light_makes_them_close_and_not_equal(form):
    projector = PlenopticProjector(WHERE, GRID, "exact")
    truth = particles(projector)
    values = noisy_views(projector, truth)
    start = started(values, truth)
    settings = {"relaxation": (0.3,), "floor": FLOOR}
    of_views = next(view_sequential(values, projector, start, form=form, order=random_order(3), **settings))
    of_pixels = next(pixel_sequential(values, projector, start, order=random_order(3), **settings))
    moved = np.sqrt(np.mean((of_pixels.values - start.values) ** 2))
    apart = np.sqrt(np.mean((of_views.values - of_pixels.values) ** 2)) / moved
    print(f"\n{form}: apart by {apart:.1e} of what a round changes")
    assert 1e-4 < apart < 0.1


def test_the_benchmark_s_rounds_are_the_library_s():
    """Its first round takes twice the relaxation; three views at once are what 0.6 allows, six what 0.3 does."""
    projector = PlenopticProjector(WHERE, GRID, "exact")
    truth = particles(projector)
    values = noisy_views(projector, truth)
    ours, order = started(values, truth), random_order(5)
    start = started(values, truth)
    for mu, together in ((0.6, 3), (0.3, 6)):
        rounds = view_sequential(values, projector, ours, relaxation=(mu,), floor=FLOOR, order=order, together=together)
        ours = next(rounds)
    theirs, _ = mart(values, projector, start, iterations=2, relaxation=0.3, floor=FLOOR, seed=5)
    np.testing.assert_array_equal(ours.column, theirs.column)
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-4, atol=1e-4 * theirs.values.max())


@pytest.mark.parametrize("rule", ["1-ray", "9-rays", "exact"])
def test_stored_shares_project_as_the_projector_does(rule):
    projector = PlenopticProjector(WHERE, GRID, rule)
    volume = particles(projector)
    light = light_of_a_pixel(projector, volume) * volume.values
    for view, share in enumerate(shares(projector, volume)):
        expected = projector.forward(view, volume)
        found = np.where(WHERE.seen[view], share.T @ light, 0.0)
        np.testing.assert_allclose(found, expected, atol=2e-5 * expected.max())


@pytest.mark.parametrize("form", ["sums", "powers"])
def test_simultaneous_rounds_leave_the_true_volume_and_lessen_the_residual(form):
    projector = PlenopticProjector(WHERE, GRID, "exact")
    truth = particles(projector)
    values = np.array([projector.forward(v, truth) for v in range(projector.views)])
    again = next(simultaneous(values, projector, truth, form=form, floor=FLOOR))
    np.testing.assert_allclose(again.values, truth.values, rtol=1e-4)
    start = started(values, truth)
    left = [residual(values, projector, v) for v in islice(simultaneous(values, projector, start, form=form), 3)]
    assert residual(values, projector, start) > left[0] > left[1] > left[2] > 0


def test_orders_name_every_view_once():
    projector = PlenopticProjector(WHERE, GRID, "1-ray")
    for order in (random_order(), rim_first, golden_order):
        assert sorted(order(projector, 1)) == list(range(projector.views))


def test_candidates_are_counted_by_their_light_on_dark_pixels():
    projector = PlenopticProjector(WHERE, GRID, "exact")
    values = np.where(np.random.default_rng(0).random(WHERE.seen.shape) < 0.05, 0.0, 10.0).astype(np.float32)
    every = projector.every_voxel()
    dark = sum(share @ np.where(v > 5, 0.0, 1.0) for share, v in zip(shares(projector, every), values, strict=True))
    kept = candidates(values, projector, 5.0, 3.0)
    kept = kept.with_values(np.ones_like(kept.values)).dense().values.ravel() > 0
    assert 0.05 < kept.mean() < 0.95
    assert (np.abs(dark[kept != (dark <= 3.0)] - 3.0) < 1e-4).all()


def test_interpolation_keeps_an_even_slope():
    """Bilinear interpolation is exact for what is linear: the value is that of the place, not of the nearest pixel."""
    sensor = WHERE.camera.sensor
    row, column = np.mgrid[: sensor.rows, : sensor.columns]
    field = resampled(100.0 + 2.0 * column - 3.0 * row, WHERE)
    centre = WHERE.pixel + WHERE.phase
    for view, (m, n) in enumerate(field.layout.offsets):
        lens = np.flatnonzero(field.layout.seen[view])
        expected = 100.0 + 2.0 * (centre[lens, 0] + m) - 3.0 * (centre[lens, 1] + n)
        np.testing.assert_allclose(field.values[view, lens], expected, atol=1e-3)
    assert 0.5 * WHERE.seen.sum() < field.layout.seen.sum() < WHERE.seen.sum()


def test_interpolation_lessens_and_correlates_the_noise_as_stated():
    where = layout(small_camera("hexagonal", pmr=14, microlenses=(31, 29), rotation_rad=0.017))
    sensor = where.camera.sensor
    field = resampled(np.random.default_rng(0).normal(0, 10, (sensor.rows, sensor.columns)), where)
    seen, values, offsets = field.layout.seen, field.values / 10.0, field.layout.offsets.tolist()
    beside = [(v, offsets.index([m + 1, n])) for v, (m, n) in enumerate(offsets) if [m + 1, n] in offsets]
    variance = np.mean(values[seen] ** 2)
    covariance = np.mean(np.concatenate([(values[a] * values[b])[seen[a] & seen[b]] for a, b in beside]))
    stated = [np.mean(np.broadcast_to(f(where.phase), seen.shape)[seen]) for f in (variance_factor, covariance_factor)]
    print(f"\nvariance {variance:.3f}, stated {stated[0]:.3f}; covariance {covariance:.3f}, stated {stated[1]:.3f}")
    assert [variance, covariance] == pytest.approx(stated, rel=0.03)
    assert stated == pytest.approx([4 / 9, 1 / 9], rel=0.05)
