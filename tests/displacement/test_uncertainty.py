"""Stated standard deviations against true errors, closed forms and a slow jackknife."""

import warnings
from dataclasses import replace
from itertools import pairwise

import numba
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from plenopiv.displacement.multigrid import correlation_pass, measure
from plenopiv.displacement.noise_amplification import noise_amplification
from plenopiv.displacement.peaks import gaussian_offset
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.uncertainty import (
    ScatterCorrelator,
    averaging_bias,
    jackknife_variance,
    standard_deviation,
)
from plenopiv.displacement.windows import WindowBatch, window_grid
from plenopiv.volume import DenseVolume, VoxelGrid

CUBES = CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32), fine_passes=3)
SMALL = CorrelationSettings(windows=((24, 24, 24),), inner_window=(24, 24, 24), fine_passes=3)
SIZE = (16, 16, 24)


def noisy_windows(seed=0, count=2):
    """Two windows of blobs that agree up to noise, the second one voxel further along x, two along y."""
    rng = np.random.default_rng(seed)
    a = gaussian_filter(rng.random((count, *SIZE)) ** 8, (0, 1, 1, 1), mode="wrap").astype(np.float32)
    noise = 0.02 * rng.standard_normal((count, *SIZE)) * a.max()
    b = (np.roll(a, (2, 1), (2, 3)) + gaussian_filter(noise, (0, 1, 1, 1))).astype(np.float32)
    return a, b


@pytest.mark.parametrize("whitening", [0.0, 0.5, 0.3])
def test_filtered_windows_multiply_to_the_correlation(whitening):
    """The plain products of the two filtered windows are exactly what the correlation sums."""
    correlator = ScatterCorrelator(SIZE, (2, 3, 2), variance=(0.4, 0.4, 0.4), whitening=whitening, taper=2.0)
    a, b = noisy_windows()
    spectra = correlator.spectra(WindowBatch.of(a), WindowBatch.of(b))
    expected = correlator.correlation(spectra)
    fa, fb = np.moveaxis(correlator.filtered(spectra), 1, 0)[..., : SIZE[1], : SIZE[2]]
    for k, j, i in [(0, 0, 0), (1, -2, 1), (-2, 3, 0)]:
        product = (fa * np.roll(fb, (-k, -j, -i), (1, 2, 3))).sum((1, 2, 3))
        np.testing.assert_allclose(product, expected[:, k + 3, j + 4, i + 3], rtol=1e-3, atol=1e-5 * expected.max())


@pytest.mark.parametrize("part", [1.0, 0.5, 1e-3])
def test_variance_is_the_jackknife_of_the_peak_fit(part):
    """Against blocks cut out, or counting less, and peaks fitted one by one, in plain Python; the second window is cut
    at the volume."""
    correlator = ScatterCorrelator(SIZE, (2, 3, 2), variance=(0.4, 0.4, 0.4), whitening=0.5, taper=2.0)
    a, b = noisy_windows(1)
    cuts = np.zeros((2, 3, 2))
    cuts[1, 2] = 3.0, 1.2
    spectra = correlator.spectra(WindowBatch.of(a), WindowBatch.of(b), cuts)
    slanted = np.array([[1.3, 0.2, -0.4], [0.1, 1.1, 0.0], [-0.5, 0.3, 1.7]])
    power = np.array([1.4, 0.7, 2.1])
    got = correlator.variance(spectra, np.array([[1, 2, 0]] * 2), np.array([slanted] * 2), np.array([power] * 2), part)
    fa, fb = np.moveaxis(correlator.filtered(spectra), 1, 0)[..., : SIZE[1], : SIZE[2]].astype(float)
    blocks = [max(1, min(4, n // thinnest)) for n, thinnest in zip(SIZE, (12, 4, 4), strict=True)]
    edges = [np.arange(n) * count // n for n, count in zip(SIZE, blocks, strict=True)]
    shift = np.array([0, 2, 1])
    for w in range(2):
        found = np.empty((np.prod(blocks), 3))
        for component, axis in ((0, 2), (1, 1), (2, 0)):
            step = np.eye(3, dtype=int)[axis]
            moved = np.roll(fb[w], -shift, (0, 1, 2))
            pairs = [np.roll(fa[w], -step, (0, 1, 2)) * moved, fa[w] * moved, fa[w] * np.roll(moved, -step, (0, 1, 2))]
            whole = [factor[min(w, len(factor) - 1)] for factor in spectra.gain]
            places = [np.array([3, 4, 3]) + shift + s * step for s in (-1, 0, 1)]
            gains = [np.prod([factor[k] for factor, k in zip(whole, place, strict=True)]) for place in places]
            gains = [(gain / gains[1]) ** power[component] for gain in gains]
            for number, block in enumerate(np.ndindex(*blocks)):
                kept = np.ones(SIZE)
                kept[np.ix_(*(e == n for e, n in zip(edges, block, strict=True)))] = 1 - part
                sums = (g * (p * kept).sum() for g, p in zip(gains, pairs, strict=True))
                found[number, component] = gaussian_offset(*sums)
        found = found @ slanted.T
        n = len(found)
        expected = n / (n - 1) * ((1 - part / n) / part) ** 2 * np.square(found - found.mean(0)).sum(0)
        np.testing.assert_allclose(got[w], expected, rtol=1e-3)


def test_jackknife_of_blocks_that_agree_is_zero():
    sums = np.tile([4.0, 2.0, 2.5, 2.0, 2.0, 1.0, 2.0], (1, 64, 1))
    np.testing.assert_allclose(jackknife_variance(sums, np.eye(3)[None], 1.0), 0, atol=1e-12)


def test_one_pass_does_not_amplify_and_more_converge():
    grid = window_grid((128, 128, 128), (32, 32, 32), 0.5)
    gains = [noise_amplification(grid, replace(CUBES, fine_passes=n)).gain for n in (1, 2, 3, 12, 14)]
    assert gains[0] == pytest.approx(1.0)
    assert all(a < b for a, b in pairwise(gains))
    assert gains[4] - gains[3] < 0.01
    unfiltered = noise_amplification(grid, replace(CUBES, filter_predictor=False)).gain
    assert unfiltered > gains[2]


def test_curvature_of_a_parabola_is_mean_less_centre():
    grid = window_grid((96, 96, 96), (32, 32, 16), 0.5)
    z, y, x = np.meshgrid(*grid.centres, indexing="ij")
    d = np.stack([0.01 * x**2 + y, 0.02 * z**2 - x, 3 * z + x * y])
    n = {"x": 32, "z": 16}
    for component, expected in enumerate((0.01 * n["x"] ** 2 / 12, 0.02 * n["z"] ** 2 / 12, 0.0)):
        np.testing.assert_allclose(averaging_bias(d, grid)[component], expected, atol=1e-9)


def inner_errors(particle_pair, uniform_flow, jitter, seeds, **kw):
    """Errors and stated standard deviations (3, vectors) of windows that the ends of the volume do not cut."""
    shift = (0.3, -0.6, 0.4)
    error, std = [], []
    for seed in seeds:
        pair = particle_pair((96, 96, 120), uniform_flow(shift), 12 / 24**3, seed=seed, jitter=jitter, **kw)
        field = measure(*pair, SMALL)
        assert np.isfinite(field.std).all()
        cut = (slice(None), *(slice(1, -1),) * 3)
        error.append((field.displacement - np.reshape(shift, (3, 1, 1, 1)))[cut].reshape(3, -1))
        std.append(field.std[cut].reshape(3, -1))
    return np.concatenate(error, 1), np.concatenate(std, 1)


@pytest.mark.parametrize(
    ("jitter", "rest"),
    [
        pytest.param((0.2, 0.2, 0.2), {}, marks=pytest.mark.full),
        ((0.1, 0.1, 0.3), {"sigma": (0.8, 0.8, 1.4), "ghosts": 0.3, "lost": 0.2}),
    ],
)
def test_true_errors_lie_within_the_stated_ones(particle_pair, uniform_flow, jitter, rest):
    error, std = inner_errors(particle_pair, uniform_flow, jitter, range(2), **rest)
    one, two = ((np.abs(error) <= k * std).mean(1) for k in (1, 2))
    assert ((one > 0.58) & (one < 0.78)).all(), one
    assert ((two > 0.89) & (two < 0.995)).all(), two


@pytest.mark.full
def test_twice_the_jitter_is_twice_the_std(particle_pair, uniform_flow):
    _, small = inner_errors(particle_pair, uniform_flow, (0.12, 0.12, 0.12), (5,))
    _, large = inner_errors(particle_pair, uniform_flow, (0.24, 0.24, 0.24), (5,))
    np.testing.assert_allclose(np.median(large, 1) / np.median(small, 1), 2, rtol=0.15)


def test_scatter_along_one_axis_is_stated_for_that_axis(particle_pair, uniform_flow):
    for component in range(3):
        jitter = np.where(np.arange(3) == component, 0.3, 0.02)
        _, std = inner_errors(particle_pair, uniform_flow, jitter, (7,))
        others = np.delete(np.median(std, 1), component)
        assert np.median(std[component]) > 2.5 * others.max()


def test_dark_windows_get_the_spread_of_their_neighbours(particle_pair, uniform_flow):
    pair = particle_pair((96, 96, 96), uniform_flow((0.3, 0.2, -0.4)), 12 / 32**3, jitter=(0.1, 0.1, 0.1))
    for volume in pair:
        volume.values[:, :, 56:] = 0.0
    field = measure(*pair, CUBES)
    assert not field.valid[..., -1].any()
    assert np.isfinite(field.std).all()
    lit = np.median(field.std[:, field.valid], 1)
    dark = np.median(field.std[:, ~field.valid], 1)
    assert ((dark > 0.5 * lit) & (dark < 10 * lit)).all()


def test_replaced_vectors_are_less_certain_where_the_flow_bends():
    grid = window_grid((96, 96, 96), (32, 32, 32), 0.5)
    _, _, x = np.meshgrid(*grid.centres, indexing="ij")
    d = np.stack([0.003 * x**2, 0 * x, 0 * x])
    valid = np.ones(grid.shape, bool)
    valid[2, 2, 2] = False
    std = standard_deviation(d, valid, np.full(d.shape, 0.01**2), grid, CUBES)
    gain = noise_amplification(grid, CUBES).gain
    q = 0.003 * 32**2 / 12
    assert std[0, 2, 2, 3] == pytest.approx(np.hypot(0.01 * gain**0.5, q))
    assert std[1, 2, 2, 2] == pytest.approx(0.01 * gain**0.5)
    assert std[0, 2, 2, 2] > 2 * q


def test_std_is_the_same_with_any_number_of_threads(particle_pair, uniform_flow):
    pair = particle_pair((64, 64, 96), uniform_flow((0.3, 0.2, -0.4)), 12 / 32**3, jitter=(0.1, 0.1, 0.1))
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            found.append(measure(*pair, CUBES).std)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)


def test_variance_only_when_asked_and_empty_windows_are_finite():
    empty = DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, (32, 32, 32)), np.zeros((32, 32, 32), np.float32))
    grid = window_grid((32, 32, 32), (32, 32, 32), 0.5)
    assert correlation_pass(empty, empty, grid, None, CUBES, 0.3).variance is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = correlation_pass(empty, empty, grid, None, CUBES, 0.3, scatter=True)
    assert not result.found.any()
    assert np.isfinite(result.variance).all()


def test_where_no_vector_is_valid_bars_are_those_of_what_was_measured():
    grid = window_grid((96, 96, 96), (32, 32, 32), 0.5)
    d, none = np.zeros((3, *grid.shape)), np.zeros(grid.shape, bool)
    std = standard_deviation(d, none, np.full(d.shape, 0.01**2), grid, CUBES)
    np.testing.assert_allclose(std, 0.01 * noise_amplification(grid, CUBES).gain ** 0.5)
