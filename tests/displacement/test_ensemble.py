"""Correlations summed over pairs: against direct sums, for signs, weights, memory, and what error bars cover."""

import weakref
from dataclasses import replace
from itertools import product

import numba
import numpy as np
import pytest
from oracles.quadratic_peak import maximum_about

from plenopiv.displacement import ensemble
from plenopiv.displacement.ensemble import SummedPairs, brightness, measure_ensemble
from plenopiv.displacement.multigrid import correlation_pass, measure
from plenopiv.displacement.offset import discrete_offset, summed_offset
from plenopiv.displacement.parts_of_pairs import PartsOfPairs
from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import average_sub_windows
from plenopiv.displacement.uncertainty import OF_MEANS
from plenopiv.displacement.window_pass import PassVectors, WindowPass, scattered_layers
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import DenseVolume, VoxelGrid

CUBE = (24, 24, 24)
SMALL = CorrelationSettings(windows=(CUBE,), inner_window=CUBE, fine_passes=3)
PLAIN = CorrelationSettings(
    windows=((16, 16, 16),),
    inner_window=(16, 16, 16),
    smoothing_voxels=0,
    taper_voxels=0,
    intensity_exponent=1,
    whitening=0,
)
FIELDS = ("z", "y", "x", "displacement", "raw", "valid", "peak_ratio", "std")


def same(one, other):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def dense(values):
    return DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, values.shape), np.asarray(values, np.float32))


def scaled(pair, one, two):
    return tuple(dense(volume.values * factor) for volume, factor in zip(pair, (one, two), strict=True))


@pytest.fixture
def thin_pairs(particle_pair, uniform_flow):
    """``make(count, shift)``: pairs of two particles a window."""

    def make(count, shift, shape=(48, 48, 60), particles=2.0, first_seed=0, **more):
        density = particles / np.prod(CUBE)
        seeds = range(first_seed, first_seed + count)
        return [particle_pair(shape, uniform_flow(shift), density, seed=seed, **more) for seed in seeds]

    return make


@pytest.mark.parametrize("settings", [SMALL, replace(SMALL, agreement=2.0, whitening=0.3, intensity_exponent=1.0)])
def test_one_pair_is_measured_as_ever(thin_pairs, settings):
    (pair,) = thin_pairs(1, (1.3, -0.6, 0.4), particles=10.0)
    same(measure_ensemble([pair], settings), measure(*pair, settings))


def test_peaks_are_looked_for_in_the_sum_of_plain_correlations(thin_pairs, monkeypatch):
    """One window of 16^3, correlated in plain loops: products of all voxels, around the window's ends."""
    pairs = thin_pairs(3, (1.3, -0.8, 0.4), (16, 16, 16), particles=4.0)
    pairs[1] = scaled(pairs[1], 5.0, 0.3)
    summed, fit = [], PassVectors.fit
    monkeypatch.setattr(PassVectors, "fit", lambda *given: summed.append(given[3][0].copy()) or fit(*given))
    SummedPairs(pairs, PLAIN).correlated(window_grid((16,) * 3, (16,) * 3, 0.5), None, PLAIN, 0.25)

    lights = [[float((v.values.astype(float) ** 2).sum() / v.values.sum()) for v in pair] for pair in pairs]
    expected = np.zeros((11, 11, 11))
    for pair, light in zip(pairs, lights, strict=True):
        a, b = (v.values * (aim / own) for v, own, aim in zip(pair, light, lights[0], strict=True))
        a, b = (v.astype(float) - v.mean(dtype=float) for v in (a, b))
        for at in product(range(11), repeat=3):
            expected[at] += (a * np.roll(b, [5 - s for s in at], (0, 1, 2))).sum()
    assert np.abs(expected).max() > 10
    np.testing.assert_allclose(summed[0], expected, atol=1e-4 * expected.max())


def test_offset_windows_sum_numerator_and_energy_apart(thin_pairs):
    pairs = thin_pairs(3, (1.2, -0.1, 0.3), (32, 32, 40))
    pairs[2] = scaled(pairs[2], 3.0, 7.0)
    windows = window_grid((32, 32, 40), CUBE, 0.5)
    first = np.zeros((3, *windows.shape))
    first[0] = 1.0
    found, again = summed_offset(pairs, windows, first)
    corner = (4, 4, 2)  # of the first window, and of both its cuts: half a voxel, rounded down, is taken back

    def correlation(d):
        numerator = energy = 0.0
        for a, b in pairs:
            one = a.values[tuple(slice(c, c + 24) for c in corner)].astype(float)
            two = b.values[tuple(slice(c + s, c + s + 24) for c, s in zip(corner, d, strict=True))].astype(float)
            numerator += ((one - one.mean()) * two).sum()
            energy += ((two - two.mean()) ** 2).sum()
        return numerator / np.sqrt(energy)

    middle = np.array([0, 0, 1])
    assert again[0, 0, 0]
    np.testing.assert_allclose(found[:, 0, 0, 0], maximum_about(correlation, middle)[::-1], atol=1e-4)


def test_offset_windows_of_one_pair_walk_as_ever(thin_pairs):
    (pair,) = thin_pairs(1, (2.2, -1.1, 0.3), particles=10.0)
    windows = window_grid((48, 48, 60), CUBE, 0.5)
    first = np.zeros((3, *windows.shape))
    first[2, 0] = 90.0  # beyond the volume
    for one, many in zip(discrete_offset(*pair, windows, first), summed_offset([pair], windows, first), strict=True):
        np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("shift", [(1.4, 0.0, 0.0), (0.0, -2.6, 0.0), (0.0, 0.0, 3.3)])
def test_many_pairs_find_what_one_cannot(thin_pairs, shift):
    """Each axis and sign; one particle and a half in a window, ghosts, and particles that one volume lacks."""
    pairs = thin_pairs(12, shift, (36, 36, 48), particles=1.5, ghosts=0.5, lost=0.3)
    target = np.reshape(shift, (3, 1, 1, 1))
    found = measure_ensemble(pairs, SMALL)
    assert found.valid.mean() > 0.95
    assert np.abs(found.displacement - target).max() < 0.3
    windows = window_grid((36, 36, 48), CUBE, 0.5)
    alone = [correlation_pass(*pair, windows, None, SMALL, SMALL.search).displacement for pair in pairs]
    assert (np.abs(np.stack(alone) - target).max(1) > 1).mean() > 0.3


def test_a_bright_pair_counts_as_the_others(thin_pairs):
    """Scaled by any factor, a pair gives the same; were it not weighted, one a hundred times as bright would rule."""
    pairs = [
        *thin_pairs(4, (1.0, 0.5, 0.0), particles=4.0),
        *thin_pairs(1, (-5.0, 0.5, 0.0), particles=4.0, first_seed=9),
    ]
    bright = [*pairs[:4], scaled(pairs[4], 100.0, 30.0)]
    one, other = (measure_ensemble(some, SMALL) for some in (pairs, bright))
    np.testing.assert_allclose(other.displacement, one.displacement, atol=1e-3)
    assert np.abs(np.median(other.displacement[0]) - 1.0) < 0.1


def test_brightness_is_of_particles_not_of_how_many():
    rng = np.random.default_rng(0)
    thin, thick = (np.where(rng.random((20, 20, 20)) < share, 7.0, 0.0) for share in (0.01, 0.3))
    assert brightness(dense(thin)) == pytest.approx(7.0)
    assert brightness(dense(thick)) == pytest.approx(7.0)
    assert brightness(dense(0 * thin)) == 0.0


@pytest.mark.parametrize("inner", [CUBE, (20, 20, 20)])
def test_a_pair_without_particles_says_nothing_of_errors(thin_pairs, inner):
    """Left out whole, the other pair would leave no light: its part is infinitesimal, with sub-windows or without."""
    pair, settings = thin_pairs(1, (1.0, 0.5, 0.0), particles=20.0)[0], replace(SMALL, inner_window=inner)
    dark = tuple(dense(0 * volume.values) for volume in pair)
    alone, beside = measure_ensemble([pair], settings), measure_ensemble([pair, dark], settings)
    np.testing.assert_allclose(beside.displacement, alone.displacement, atol=1e-5)
    np.testing.assert_allclose(beside.std, alone.std, rtol=0.3)


@pytest.mark.parametrize("light", [0.0, 3.7])
def test_pairs_without_particles_change_nothing(thin_pairs, light):
    """Correlations of uniform windows would be rounding, which whitening raises."""
    pairs = thin_pairs(2, (1.0, 0.5, 0.0), particles=6.0)
    even = tuple(dense(0 * volume.values + light) for volume in pairs[0])
    windows, settings = window_grid((48, 48, 60), CUBE, 0.5), replace(SMALL, whitening=1.0)

    def first_pass(pairs):
        summed = SummedPairs(pairs, settings)
        found = summed.correlated(windows, None, settings, settings.search, scatter=True)
        return found.displacement, found.peak_ratio, *summed.offset(windows, found.displacement)

    for order in ([*pairs, even], [even, *pairs]):
        for one, other in zip(first_pass(order), first_pass(pairs), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


def test_neither_threads_nor_parts_of_the_windows_change_a_bit(thin_pairs, monkeypatch):
    pairs = thin_pairs(2, (1.0, 0.5, 0.0), particles=6.0)
    expected, threads = measure_ensemble(pairs, SMALL), numba.get_num_threads()
    monkeypatch.setattr(ensemble, "PLANES_BYTES", 1)
    try:
        numba.set_num_threads(1)
        same(measure_ensemble(pairs, SMALL), expected)
    finally:
        numba.set_num_threads(threads)


class OneAtATime:
    """Pairs made anew whenever they are asked for; fails if one that was given out before is still held."""

    def __init__(self, pairs):
        self.pairs, self.given, self.asked = pairs, [], 0

    def __len__(self):
        return len(self.pairs)

    def __getitem__(self, index):
        assert not [volume for volume in self.given if volume() is not None]
        pair = scaled(self.pairs[index], 1.0, 1.0)
        self.given, self.asked = [weakref.ref(volume) for volume in pair], self.asked + 1
        return pair


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_one_pair_is_held_at_a_time(thin_pairs, exponent):
    pairs, reports = OneAtATime(thin_pairs(3, (1.0, 0.5, 0.0), (32, 32, 48), particles=6.0)), []
    settings = replace(SMALL, intensity_exponent=exponent)
    measure_ensemble(pairs, settings, lambda *report: reports.append(report))
    # its grid, four passes, the scatter, and one to four steps of the offset
    assert 3 * (settings.fine_passes + 2) < pairs.asked <= 1 + 3 * (settings.fine_passes + 5)
    for what in {what for what, _, _ in reports}:
        done = [(k, n) for name, k, n in reports if name == what]
        assert done == [(k, len(done)) for k in range(1, len(done) + 1)]


def test_no_pairs_and_other_grids_are_refused(thin_pairs):
    with pytest.raises(PlenoPIVError, match="no pairs"):
        measure_ensemble([], SMALL)
    pairs = [*thin_pairs(1, (0, 0, 0)), *thin_pairs(1, (0, 0, 0), (48, 48, 64))]
    with pytest.raises(PlenoPIVError, match="first volume of pair 2"):
        measure_ensemble(pairs, SMALL)


def coverage(fields, shift):
    """Shares of the errors (3,) within one and two stated deviations; windows at the volume's faces left out."""
    cut = (slice(None), *(slice(1, -1),) * 3)
    error = np.concatenate([(f.displacement - np.reshape(shift, (3, 1, 1, 1)))[cut].reshape(3, -1) for f in fields], 1)
    std = np.concatenate([f.std[cut].reshape(3, -1) for f in fields], 1)
    return (np.abs(error) <= std).mean(), (np.abs(error) <= 2 * std).mean()


@pytest.mark.full
@pytest.mark.parametrize("particles", [1.0, 2.0, 6.0])
def test_errors_of_ensembles_lie_within_the_stated_ones(thin_pairs, particles):
    shift, count = (0.3, -0.6, 0.4), round(12 / particles)
    fields = []
    for seed in range(3):
        more = {"particles": particles, "first_seed": 100 * seed, "jitter": (0.15,) * 3}
        fields.append(measure_ensemble(thin_pairs(count, shift, (72, 72, 96), **more), SMALL))
    one, two = coverage(fields, shift)
    assert 0.58 < one < 0.78
    assert 0.9 < two < 0.99


@pytest.mark.full
@pytest.mark.parametrize(("inner", "long"), [(CUBE, 1.0), ((16, 16, 16), 1.0), ((16, 16, 16), 3.0)])
def test_a_flow_that_fluctuates_makes_error_bars_longer(particle_pair, uniform_flow, inner, long):
    """Each pair moves by its own amount, all its particles alike: only the scatter between pairs shows that. Of
    particles that are ``long`` a pass shows a third of it."""
    rng, fields, count = np.random.default_rng(3), [], 10
    settings = replace(SMALL, inner_window=inner)
    for ensemble_number in range(6):
        shifts = 0.15 * rng.standard_normal((count, 3))
        density, seed = 5 / np.prod(CUBE), 50 * ensemble_number
        about = (48, 48, 60), density, (1.0, 1.0, long)
        pairs = [particle_pair(about[0], uniform_flow(s), *about[1:], seed + k) for k, s in enumerate(shifts)]
        fields.append(measure_ensemble(pairs, settings))
    error = np.array([f.displacement.mean((1, 2, 3)) for f in fields])
    stated = np.median(np.concatenate([f.std.reshape(3, -1) for f in fields], 1), 1)
    assert 0.03 < np.sqrt((error**2).mean()) < 0.07  # 0.15 / sqrt(10)
    assert (0.8 * 0.15 / np.sqrt(count) < stated).all()
    assert (stated < 2 * 0.15 / np.sqrt(count)).all()


@pytest.mark.full
def test_errors_of_means_over_sub_windows_lie_within_the_stated_ones(thin_pairs):
    """What chance makes of the scatter between pairs does not make bars of a steady flow longer."""
    shift, settings = (0.3, -0.6, 0.4), replace(SMALL, inner_window=(16, 16, 16))
    more = {"particles": 6.0, "jitter": (0.15,) * 3}
    pairs = [thin_pairs(10, shift, (72, 72, 96), first_seed=100 * seed, **more) for seed in range(3)]
    one, two = coverage([measure_ensemble(each, settings) for each in pairs], shift)
    assert 0.58 < one < 0.78
    assert 0.9 < two < 0.99


@pytest.mark.parametrize("overlap", [0.6, 0.1])  # where layers overlap more, the scatter is known in every second
def test_parts_of_pairs_are_averaged_as_their_vectors_are(overlap):
    """Against what each pair alone finds, a field that is averaged over sub-windows: the variance of the mean."""
    shape, count, settings = (40, 40, 48), 7, replace(SMALL, inner_window=(10, 10, 10))
    windows, whole = window_grid(shape, (10, 10, 10), overlap), window_grid(shape, CUBE, settings.overlap)
    scattered = scattered_layers(windows, settings)
    assert scattered.all() == (overlap < 0.5)
    rng, nothing = np.random.default_rng(0), (np.ones(windows.shape, bool), np.ones(windows.shape, np.float32))
    known = np.broadcast_to(scattered[:, None, None], windows.shape).copy()
    known[-1, :, 0] = False
    parts, means = PartsOfPairs(count, windows, shape, known, settings), []
    for number in range(count):
        alone = rng.standard_normal((*windows.shape, 3))
        for layers in (slice(0, 2), slice(2, windows.shape[0])):  # left out in part, the mean moves the other way
            left_out = -OF_MEANS / count * alone[layers].reshape(layers.stop - layers.start, -1, 3)
            parts.add(number, range(layers.start, layers.stop), left_out)
        alone[-1, :, 0] = alone[-1, :, 1]
        for layer in np.flatnonzero(~scattered):
            alone[layer] = (alone[layer - 1] + alone[layer + 1]) / 2
        field = np.moveaxis(alone, -1, 0)
        mean, *_ = average_sub_windows(field, field, *nothing, windows, whole, averaged_share(settings))
        means.append(mean)
    np.testing.assert_allclose(parts.variance(), np.var(means, 0, ddof=1) / count, rtol=1e-3)


def test_a_peak_is_the_sum_of_what_pairs_and_blocks_add_to_it(particle_pair, uniform_flow):
    """As it is fitted, corrected for overlap: contributions of all pairs against the summed correlation."""
    pairs = [particle_pair((24, 32, 32), uniform_flow((0.2, -0.3, 0.4)), 60 / 16**3, seed=seed) for seed in (1, 2)]
    settings = replace(PLAIN, whitening=0.5, smoothing_voxels=0.8)
    summed, windows = SummedPairs(pairs, settings), window_grid((24, 32, 32), (16, 16, 16), 0.5)
    batches = WindowPass(windows, None, settings, 0.25, (24, 32, 32))
    peaks = summed._peaks(batches, range(batches.layers), PassVectors(windows, False, settings), lambda *_: None)
    total = np.zeros_like(peaks.total)

    def add(layer, part, spectra):
        own = batches.correlator.contributions(spectra, peaks.place[layer, part], peaks.power[layer, part])
        total[layer, part] += own.sum(1)

    for pair in summed:
        batches.each_batch(*pair, add)
    assert (np.abs(peaks.power - 1) > 0.05).any()
    np.testing.assert_allclose(total, peaks.total, rtol=2e-3)
