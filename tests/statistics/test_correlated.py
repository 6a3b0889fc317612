"""Limiting cases of sampling uncertainty: white noise, AR(1) in time, Gaussian moments; coverage of the intervals."""

import numpy as np
import pytest
import xarray

from plenopiv.statistics import SeriesStatistics
from plenopiv.statistics.correlated import TimeCorrelation
from plenopiv.statistics.variables import INTERVAL

SHAPE = (6, 8, 9)


def ar1(memory, count, seed, shape=(3, *SHAPE)):
    rng = np.random.default_rng(seed)
    state = rng.normal(size=shape)
    for _ in range(count):
        yield state
        state = memory * state + np.sqrt(1 - memory**2) * rng.normal(size=shape)


def spacing_of(samples, lags=16, missing=0.0):
    rng = np.random.default_rng(0)
    time, n = TimeCorrelation(SHAPE, lags), np.zeros(SHAPE, int)
    for values in samples:
        counted = rng.random(SHAPE) >= missing
        n += counted
        time.add(values, counted)
    return time, time.spacing(n)


def test_autocorrelation_is_that_of_all_samples_together():
    samples = np.stack(list(ar1(0.7, 60, 1))) + 100.0
    time, _ = spacing_of(samples, lags=5)
    off = samples - samples.mean(0)
    for lag in range(1, 6):
        expected = (off[lag:] * off[:-lag]).mean(0) / (off**2).mean(0)
        found = time.correlation()[lag - 1]
        # the middle place averages over five vectors along each axis around it
        box = expected[:, 1:6, 2:7, 3:8].mean((1, 2, 3))
        np.testing.assert_allclose(found[:, 3, 4, 5], box, atol=1e-5)


def test_white_noise_is_independent():
    _, spacing = spacing_of(ar1(0.0, 120, 2))
    for components in ((0,), (1,), (2,), (0, 1), (2, 2), (1, 1, 1)):
        found = spacing(*components)
        assert found.mean() == pytest.approx(1.0, abs=0.06)
        assert (found >= 1).all()


@pytest.mark.parametrize(("memory", "missing"), [(0.5, 0.0), (0.8, 0.0), (0.5, 0.1)])
def test_an_ar1_process_has_its_known_number_of_independent_samples(memory, missing):
    """T = (1 + a)/(1 - a) for the mean, with a^2 in place of a for variances, a^3 for skewness."""
    _, spacing = spacing_of(ar1(memory, 300, 3), missing=missing)
    for order in (1, 2, 3):
        a = memory**order
        assert spacing(*[1] * order).mean() == pytest.approx((1 + a) / (1 - a), rel=0.08)
    assert not spacing.longer_than_lags().any()


@pytest.mark.parametrize("missing", [0.0, 0.5, 0.8])
def test_errors_of_means_are_as_stated_where_vectors_are_missing(missing):
    """Of what is missing at random T is 1 + 2 (1 - share) sum rho(k): neighbours in time are often not there."""
    off, stated = [], []
    for seed in range(4):
        rng = np.random.default_rng(50 + seed)
        time, n, total = TimeCorrelation(SHAPE, 16), np.zeros(SHAPE, int), np.zeros((3, *SHAPE))
        for values in ar1(0.8, 300, 60 + seed):
            counted = rng.random(SHAPE) >= missing
            n += counted
            total += np.where(counted, values, 0.0)
            time.add(values, counted)
        spacing = time.spacing(n)
        off.append(total / n)
        stated.append(np.sqrt(np.stack([spacing(c) for c in range(3)]) / n))
    ratio = np.sqrt(np.mean(np.square(off)) / np.mean(np.square(stated)))
    assert ratio == pytest.approx(1.0, abs=0.1)
    a, share = 0.8, 1 - missing
    assert spacing(0).mean() == pytest.approx(1 + 2 * share * a / (1 - a), rel=0.15)


@pytest.mark.parametrize(
    ("memory", "count", "share"), [(0.98, 20, 1.0), (0.98, 47, 1.0), (0.0, 5, 0.0), (0.5, 30, 0.0)]
)
def test_a_series_shorter_than_the_lags_may_be_too_short(memory, count, share):
    _, spacing = spacing_of(ar1(memory, count, 9))
    assert spacing.longer_than_lags().mean() == pytest.approx(share, abs=0.02)


def oscillating(period, memory, count, seed, shape=(3, *SHAPE)):
    """Unit variance and rho = exp(-k/memory) cos(2 pi k/period): the real part of a rotating AR(1)."""
    turn, kept = np.exp(2j * np.pi / period), np.exp(-1 / memory)
    rng = np.random.default_rng(seed)
    state = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    for _ in range(count):
        yield state.real
        noise = rng.normal(size=shape) + 1j * rng.normal(size=shape)
        state = kept * turn * state + np.sqrt(1 - kept**2) * noise


@pytest.mark.parametrize(("period", "memory", "count"), [(4, 10, 200), (3, 20, 400), (8, 20, 400), (24, 20, 800)])
def test_products_of_flow_that_oscillates(period, memory, count):
    """rho^2 goes on where rho is negative, and means are no worse than stated."""
    lags = np.arange(1, count)
    rho = np.exp(-lags / memory) * np.cos(2 * np.pi * lags / period)
    true, of_mean = (1 + 2 * ((1 - lags / count) * r).sum() for r in (rho**2, rho))
    _, spacing = spacing_of(oscillating(period, memory, count, 7), lags=60)
    assert spacing(0, 0).mean() == pytest.approx(true, rel=0.12)
    assert spacing(0, 1).mean() == pytest.approx(true, rel=0.12)
    assert spacing(0).mean() > of_mean
    assert not spacing.longer_than_lags().any()
    _, short = spacing_of(oscillating(period, memory, count, 7), lags=6)
    assert short.longer_than_lags().mean() > 0.9


def test_error_bars_of_stresses_where_flow_oscillates():
    off, stated = [], []
    for seed in range(6):
        series = None
        for values in oscillating(4, 10, 200, 20 + seed):
            field = xarray.Dataset({name: (("z", "y", "x"), v) for name, v in zip("uvw", values, strict=True)})
            for axis, n in zip(("z", "y", "x"), SHAPE, strict=True):
                field[axis] = np.arange(float(n))
            field = field.assign({f"{name}_std": 0.0 * field.u for name in "uvw"} | {"valid": 0.0 * field.u + 1})
            series = series or SeriesStatistics(field)
            series.add(field)
        found = series.result()
        off += [found.uu.values - 1, found.uv.values]
        stated += [found.uu_std.values, found.uv_std.values]
    held = [np.mean(np.abs(o) < INTERVAL * s) for o, s in zip(off, stated, strict=True)]
    assert np.mean(held[::2]) > 0.85  # 60 % without the negative lobes
    assert np.mean(held[1::2]) > 0.9


def test_a_place_that_is_measured_late_is_followed_from_there():
    time, n = TimeCorrelation(SHAPE, 8), np.zeros(SHAPE, int)
    for k, values in enumerate(ar1(0.6, 200, 4)):
        counted = np.full(SHAPE, k >= 60)
        n += counted
        time.add(50.0 + values, counted)
    assert time.spacing(n)(0).mean() == pytest.approx(4.0, rel=0.1)


def test_correlation_beyond_the_lags_is_said():
    _, spacing = spacing_of(ar1(0.98, 120, 5), lags=4)
    assert spacing.longer_than_lags().mean() > 0.9


def test_pairs_set_aside_are_steps_in_time():
    """Every second sample missing: the lag of what follows is two, and its correlation that of two steps."""
    time, n = TimeCorrelation(SHAPE, 6), np.zeros(SHAPE, int)
    for k, values in enumerate(ar1(0.8, 400, 6)):
        counted = np.full(SHAPE, k % 2 == 0)
        n += counted
        time.add(values, counted)
    assert time.correlation()[1].mean() == pytest.approx(0.64, abs=0.03)


def coverage(found, truth):
    return {
        name: 100 * float((np.abs(found[name] - value) < INTERVAL * found[f"{name}_std"]).mean())
        for name, value in truth.items()
    }


@pytest.mark.parametrize("memory", [0.0, 0.5])
def test_intervals_cover(memory, field_of):
    """Of Gaussian turbulence with known noise of the vectors, 95 % of the places; the whole is in benchmarks."""
    rng = np.random.default_rng(7)
    stress = np.array([[1.0, -0.4, 0.1], [-0.4, 0.6, 0.05], [0.1, 0.05, 0.4]])
    root, noise, statistics = np.linalg.cholesky(stress), 0.2, None
    for white in ar1(memory, 100, 8):
        values = 3.0 + np.einsum("ij,j...->i...", root, white) + noise * rng.normal(size=white.shape)
        field = field_of(values, noise, rng.random(SHAPE) > 0.03)
        statistics = statistics or SeriesStatistics(field)
        statistics.add(field)
    truth = {f"{n}_mean": 3.0 for n in "uvw"} | {f"{n}_skewness": 0.0 for n in "uvw"}
    for a in range(3):
        truth["uvw"[a] * 2 + "_corrected"] = stress[a, a]
        truth["uvw"[a] + "_rms_corrected"] = np.sqrt(stress[a, a])
        truth["uvw"[a] * 2] = stress[a, a] + noise**2
        truth |= {"uvw"[a] + "uvw"[b]: stress[a, b] for b in range(a + 1, 3)}
    found = coverage(statistics.result(), truth)
    assert min(found.values()) > 88, found
    assert max(found.values()) < 99, found
    assert 92 < np.mean(list(found.values())) < 97, found


def test_a_gaussian_s_variances_have_their_known_uncertainty(field_of):
    """2 u^4/n for a variance, (1 + r^2) u^2 v^2/n for a covariance, 6/n for skewness."""
    rng = np.random.default_rng(9)
    statistics = None
    for _ in range(200):
        u, other, w = rng.normal(size=(3, 8, 9, 10))
        field = field_of(np.stack([2 * u, 0.6 * u + 0.8 * other, w]))
        statistics = statistics or SeriesStatistics(field, lags=0)
        statistics.add(field)
    found = statistics.result()
    assert float(found.uu_std.mean()) == pytest.approx(4 * np.sqrt(2 / 200), rel=0.03)
    assert float(found.uv_std.mean()) == pytest.approx(2 * np.sqrt(1.36 / 200), rel=0.03)
    assert float((found.w_skewness_std**2).mean()) ** 0.5 == pytest.approx(np.sqrt(6 / 200), rel=0.06)
