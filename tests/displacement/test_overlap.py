"""The correction for the overlap of windows: its powers, and displacements that one pass measures in full."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from plenopiv.displacement.compression import compressed
from plenopiv.displacement.correlation import WindowCorrelator
from plenopiv.displacement.multigrid import correlation_pass
from plenopiv.displacement.overlap import PLAIN, fade, overlap, powers
from plenopiv.displacement.peaks import find_peaks
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.transforms import fast_length
from plenopiv.displacement.uncertainty import gain_around
from plenopiv.displacement.windows import window_grid

SINGLE = CorrelationSettings(windows=((32, 32, 16),), inner_window=(32, 32, 16))


def peak(n, taper, variance, whitening, width, moved):
    """R(-1), R(0), R(1) of a Gaussian peak of ``width`` (variance) at ``moved``, seen through a window of ``n``: sums
    over waves written out, of a window that is not periodic (128 voxels)."""
    shared, total = overlap(fade(n, taper)), 128
    lags = [(d, math.exp(-((d - moved) ** 2) / (2 * width)) * shared[d + n - 1]) for d in range(1 - n, n)]
    out = np.zeros(3)
    for m in range(total):
        k = 2 * math.pi * (m if m <= total // 2 else m - total) / total
        real = sum(value * math.cos(k * d) for d, value in lags)
        imaginary = sum(-value * math.sin(k * d) for d, value in lags)
        scale = math.hypot(real, imaginary) ** -whitening * math.exp(-variance * k * k) / total
        for i, d in enumerate((-1, 0, 1)):
            out[i] += scale * (real * math.cos(k * d) - imaginary * math.sin(k * d))
    return out


def power_for(row, bend):
    """Linear between knots of 1/K, constant beyond."""
    knots = row[0] + np.arange(len(row) - PLAIN) / row[1]
    return np.interp(1 / bend, knots, row[PLAIN:])


@pytest.mark.parametrize("whitening", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("variance", [0.0, 0.4])
@pytest.mark.parametrize("n", [16, 48])
def test_the_power_puts_a_peak_where_the_particle_went(n, variance, whitening):
    row = powers(n, n, 2.0, variance, whitening)
    gain = 1 / overlap(fade(n, 2.0))[n]
    for width, moved in ((2.0, 0.3), (3.5, -0.1)):
        left, middle, right = np.log(peak(n, 2.0, variance, whitening, width, moved))
        raised = power_for(row, 2 * middle - left - right) * math.log(gain)
        found = 0.5 * (right - left) / (2 * middle - left - right - 2 * raised)
        assert found == pytest.approx(moved, rel=0.02)


def test_a_plain_correlation_is_divided_by_the_overlap():
    """But for peaks so wide that they are not corrected in full."""
    row = powers(32, 32, 2.0, 0.0, 0.0)
    np.testing.assert_allclose(row[PLAIN : PLAIN + 15], 1.0, atol=0.02)
    assert (np.diff(row[PLAIN + 20 :]) < 0).all()


def test_phases_alone_tell_no_width():
    """The power for s^2 = 4 then, and 1 without smoothing, where a peak is one voxel wide."""
    row = powers(32, 32, 2.0, 0.3, 1.0)
    assert len(set(row[PLAIN:])) == 1
    left, middle, right = np.log(peak(32, 2.0, 0.3, 1.0, 4.0, 0.1))
    raised = row[PLAIN] * math.log(1 / overlap(fade(32, 2.0))[32])
    assert 0.5 * (right - left) / (2 * middle - left - right - 2 * raised) == pytest.approx(0.1, rel=0.05)
    assert set(powers(16, 16, 2.0, 0.0, 1.0)[PLAIN:]) == {1.0}


@pytest.mark.parametrize("n", [8, 9, 15, 64, 100])
@pytest.mark.parametrize("taper", [0.0, 4.0])
def test_powers_stay_within_bounds(n, taper):
    for variance in (0.0, 0.03, 0.3, 1.0, 9.0):
        for whitening in (0.0, 0.3, 0.5, 0.8, 0.95, 1.0):
            row = powers(n, fast_length(n), taper, variance, whitening)
            assert np.isfinite(row).all()
            assert row[1] > 0
            assert (row[PLAIN:] >= 0).all()
            if row[0] > 0:  # not one power for all
                inverse = row[0] + np.arange(len(row) - PLAIN) / row[1]
                taken = -2 * np.log(overlap(fade(n, taper))[n]) * row[PLAIN:] * inverse  # of a peak's curvature
                assert taken.max() <= 0.5 + 1e-9


def test_a_long_peak_is_not_corrected_in_full():
    """Of a peak of which .3 of the displacement is left, .6 is found."""
    row = powers(12, 12, 2.0, 0.3, 0.5)
    left, middle, right = np.log(peak(12, 2.0, 0.3, 0.5, 14.0, 0.2))
    raised = power_for(row, 2 * middle - left - right) * math.log(1 / overlap(fade(12, 2.0))[12])
    kept = 0.5 * (right - left) / (2 * middle - left - right) / 0.2
    found = 0.5 * (right - left) / (2 * middle - left - right - 2 * raised) / 0.2
    assert kept == pytest.approx(0.3, abs=0.03)
    assert 0.5 < found < 0.7


def test_gains_are_raised_along_each_axis_by_the_curvature_there():
    """A peak of other widths along x, y and z, fitted in plain Python."""
    size, radius = (16, 24, 32), (3, 3, 3)
    correlator = WindowCorrelator(size, radius, (0.3, 0.4, 0.5), 0.5, 2.0)
    z, y, x = np.meshgrid(*(np.arange(-4, 5),) * 3, indexing="ij")
    widths, moved = (1.5, 2.5, 2.1), (0.2, -0.3, 0.15)
    c = np.exp(-sum((d - m) ** 2 / (2 * w) for d, m, w in zip((x, y, z), moved, widths, strict=True)))
    c = c[None].astype(np.float32)
    cuts = np.zeros((2, 3, 2))
    cuts[1] = 3.0, 1.5  # the second window is shorter along each axis
    gain = correlator.gain(cuts)
    place, d, power = np.zeros((2, 3), np.int64), np.zeros((2, 3)), np.zeros((2, 3))
    about = np.zeros(2, np.float32), np.zeros(2, bool), place, np.zeros((2, 3, 3))
    find_peaks(np.repeat(c, 2, 0), gain, d, *about, correlator.powers, power)
    around = gain_around(gain, place, power)
    assert not place.any()
    for window, axis in product(range(2), range(3)):
        steps = [tuple(4 + s * (2 - axis == k) for k in range(3)) for s in (-1, 0, 1)]
        left, middle, right = (math.log(c[0][at]) for at in steps)
        expected = power_for(correlator.powers[axis], 2 * middle - left - right)
        assert power[window, axis] == pytest.approx(expected, rel=1e-4)
        left, middle, right = (
            v + expected * math.log(gain[2 - axis][window, 4 + s])
            for v, s in zip((left, middle, right), (-1, 0, 1), strict=True)
        )
        assert around[window, 1 + 2 * axis] == pytest.approx(gain[2 - axis][window, 3] ** expected, rel=1e-4)
        assert around[window, 2 + 2 * axis] == pytest.approx(gain[2 - axis][window, 5] ** expected, rel=1e-4)
        assert d[window, axis] == pytest.approx(0.5 * (right - left) / (2 * middle - left - right), rel=1e-3)


def test_a_peak_beside_values_below_zero_has_no_unit():
    """Where no curvature of the logarithm can be had."""
    correlator = WindowCorrelator((16, 16, 16), (2, 2, 2), whitening=0.5)
    c = np.zeros((1, 7, 7, 7), np.float32)
    c[0, 3, 3, 2:5] = -0.1, 1.0, 0.8
    c[0, 2:5:2, 3, 3] = c[0, 3, 2:5:2, 3] = 0.5
    found = []
    for unit in (1e-3, 1.0, 1e3):
        d, power = np.zeros((1, 3)), np.zeros((1, 3))
        about = np.zeros(1, np.float32), np.zeros(1, bool), np.zeros((1, 3), np.int64), np.zeros((1, 3, 3))
        find_peaks(np.float32(unit) * c, correlator.gain(None), d, *about, correlator.powers, power)
        assert power[0, 0] == 1.0
        found.append(d[0])
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    np.testing.assert_allclose(found[2], found[1], atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("whitening", "smoothing"), [(0.0, 0.8), (0.5, 0.8), (0.5, 1.2)])
def test_one_pass_measures_what_deformation_has_left(axis, whitening, smoothing, particle_pair, uniform_flow):
    """A quarter of a voxel more than the predictor says; 36 particles in a window of 32 x 32 x 16. Divided by the
    overlap once, whitened windows keep .82 of it in depth and plain ones 1.18."""
    settings = replace(SINGLE, whitening=whitening, smoothing_voxels=smoothing)
    shape, shift = (48, 96, 96), 0.25 * (np.arange(3) == axis)
    pair = particle_pair(shape, uniform_flow(shift), 36 / (32 * 32 * 16), seed=axis)
    a, b = (compressed(volume, settings.intensity_exponent) for volume in pair)
    windows = window_grid(shape, (32, 32, 16), 0.5)
    nothing = fit_spline(np.zeros((3, *windows.shape)), windows.centres, shape)
    found = correlation_pass(a, b, windows, nothing, settings, settings.residual_search).displacement
    np.testing.assert_allclose(found.mean((1, 2, 3)), shift, atol=0.012)
