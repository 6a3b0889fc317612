"""Noise of the vectors of several passes against white noise that goes through them, step by step."""

import numpy as np
import pytest

from plenopiv.displacement.noise_amplification import noise_amplification
from plenopiv.displacement.overlap import fade
from plenopiv.displacement.predictor import fit_spline, smooth_predictor
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import PassVectors
from plenopiv.displacement.windows import window_grid

SIZE, SHAPE = 12, (120, 126, 132)


def under_windows(values, windows, taper):
    """Means (3, nz, ny, nx) of ``values`` (3, z, y, x) under the squares of tapered windows."""
    for axis, (size, total, starts) in enumerate(zip(windows.size, SHAPE, windows.starts, strict=True), 1):
        weight, seen = fade(size, taper) ** 2, np.zeros((len(starts), total))
        for n, start in enumerate(starts):
            seen[n, start : start + size] = weight / weight.sum()
        values = np.moveaxis(np.tensordot(seen, values, (1, axis)), 0, axis)
    return values


def through(settings, seed, parts=(), margin=3):
    """White noise under the windows of the last pass, and what all passes make of it: (3, nz, ny, nx) each, but for
    ``margin`` vectors at the faces. ``parts``: of a displacement that the passes find, one each; 1 for all of it."""
    noise, predictor = np.random.default_rng(seed).normal(size=(3, *SHAPE)), None
    everywhere = [np.arange(n) for n in SHAPE]
    for one, part in zip(settings.passes, parts or (1,) * len(settings.passes), strict=True):
        windows = window_grid(SHAPE, *one)
        left, moved = noise, 0.0
        if predictor is not None:
            left, moved = noise - predictor.at(*everywhere), predictor.at(*windows.centres)
        vectors = moved + part * under_windows(left, windows, settings.taper_voxels)
        predictor = fit_spline(smooth_predictor(vectors, one.overlap), windows.centres, SHAPE)
    inside = (slice(None), *(slice(margin, -margin),) * 3)
    return part * under_windows(noise, windows, settings.taper_voxels)[inside], vectors[inside]


def neighbours_of(vectors):
    """Mean over the axes of the correlation of neighbours."""
    apart = []
    for axis in range(3):
        ahead = np.moveaxis(vectors, axis + 1, 1)
        apart.append(np.mean(ahead[:, 1:] * ahead[:, :-1]) / np.mean(vectors**2))
    return np.mean(apart)


def computed_neighbours(amplification):
    middle = np.array(amplification.covariance.shape) // 2
    return np.mean([amplification.covariance[tuple(middle + (np.arange(3) == axis))] for axis in range(3)])


@pytest.mark.parametrize("overlap", [0.5, 0.6, 0.7, 0.75])
@pytest.mark.parametrize("passes", [2, 3])
def test_white_noise_grows_as_computed(overlap, passes):
    settings = CorrelationSettings(
        windows=((2 * SIZE,) * 3,), inner_window=(SIZE,) * 3, inner_overlap=overlap, fine_passes=passes
    )
    once, found = (np.concatenate(v) for v in zip(*(through(settings, seed) for seed in range(5)), strict=True))
    computed = noise_amplification(window_grid(SHAPE, *settings.passes[-1]), settings)
    assert computed.gain == pytest.approx(np.mean(found**2) / np.mean(once**2), rel=0.04)
    assert computed_neighbours(computed) == pytest.approx(neighbours_of(found), abs=0.03)


@pytest.mark.parametrize(("response", "longer"), [(0.8, 1.0), (0.4, 1.0), (0.2, 8 / 13)])
def test_noise_of_larger_windows_stays_where_passes_find_little(response, longer):
    """``longer``: what windows twice as long find of a displacement, 2/(1 + (2/r - 1)/4) and 1 at the most."""
    settings = CorrelationSettings(windows=((2 * SIZE,) * 3,), inner_window=(SIZE,) * 3)
    assert len(settings.passes) == 3
    parts = longer, response, response
    each = zip(*(through(settings, seed, parts, 7) for seed in range(8)), strict=True)
    once, found = (np.concatenate(v) for v in each)
    grid = window_grid(SHAPE, *settings.passes[-1])
    computed, usual = noise_amplification(grid, settings, response), noise_amplification(grid, settings)
    assert computed.gain == pytest.approx(np.mean(found**2) / np.mean(once**2), rel=0.06)
    assert computed_neighbours(computed) == pytest.approx(neighbours_of(found), abs=0.03)
    assert computed_neighbours(computed) > computed_neighbours(usual)


@pytest.mark.parametrize(("count", "expected"), [(1, [0]), (2, [0, 1]), (5, [0, 2, 4]), (6, [0, 2, 4, 5])])
def test_variance_is_estimated_in_every_second_layer_of_sub_windows(count, expected):
    settings = CorrelationSettings(windows=((24,) * 3,), inner_window=(12, 12, 12))
    windows = window_grid((12 + 5 * (count - 1), 40, 40), settings.sub_window, settings.inner_overlap)
    vectors = PassVectors(windows, True, settings)
    assert np.flatnonzero(vectors.scattered).tolist() == expected
    vectors.variance[expected] = np.random.default_rng(count).random((len(expected), *vectors.variance.shape[1:]))
    whole = vectors.result(None).variance
    layers = np.arange(count)
    for place in np.ndindex(3, *windows.shape[1:]):
        one = whole[place[0], :, place[1], place[2]]
        np.testing.assert_allclose(one, np.interp(layers, expected, one[expected]))


def test_variance_is_estimated_in_all_layers_of_single_windows_and_of_those_that_share_less_than_half():
    shape = (60, 40, 40)
    for settings in (
        CorrelationSettings(((12,) * 3,), 0.6, (12,) * 3),
        CorrelationSettings(((24,) * 3,), 0.5, (12,) * 3, 0.5),
    ):
        windows = window_grid(shape, *settings.passes[-1])
        assert PassVectors(windows, True, settings).scattered.all()
        assert PassVectors(windows, False, settings).result(None).variance is None
