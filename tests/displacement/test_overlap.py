"""The correction for the overlap of windows: its powers, and displacements that one pass measures in full."""

import math
from dataclasses import replace

import numpy as np
import pytest

from plenopiv.displacement.correlation import WindowCorrelator
from plenopiv.displacement.multigrid import compressed, correlation_pass
from plenopiv.displacement.overlap import PLAIN, fade, overlap, powers
from plenopiv.displacement.peaks import find_peaks
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
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
    np.testing.assert_allclose(powers(32, 32, 2.0, 0.0, 0.0)[PLAIN:], 1.0, atol=0.02)


def test_phases_alone_tell_no_width():
    row = powers(16, 16, 2.0, 0.3, 1.0)
    assert len(set(row[PLAIN:])) == 1
    assert row[PLAIN] > 1


def test_gains_are_raised_along_each_axis_by_the_curvature_there():
    """A peak of other widths along x, y and z, fitted in plain Python."""
    size, radius = (16, 24, 32), (3, 3, 3)
    correlator = WindowCorrelator(size, radius, (0.3, 0.4, 0.5), 0.5, 2.0)
    z, y, x = np.meshgrid(*(np.arange(-4, 5),) * 3, indexing="ij")
    widths, moved = (1.5, 2.5, 2.1), (0.2, -0.3, 0.15)
    c = np.exp(-sum((d - m) ** 2 / (2 * w) for d, m, w in zip((x, y, z), moved, widths, strict=True)))
    c = c[None].astype(np.float32)
    gain = correlator.gain(None)
    d, power = np.zeros((1, 3)), np.zeros((1, 3))
    about = np.zeros(1, np.float32), np.zeros(1, bool), np.zeros((1, 3), np.int64), np.zeros((1, 3, 3))
    find_peaks(c, gain, d, *about, correlator.powers, power)
    for axis in range(3):
        steps = [tuple(4 + s * (2 - axis == k) for k in range(3)) for s in (-1, 0, 1)]
        left, middle, right = (math.log(c[0][at]) for at in steps)
        expected = power_for(correlator.powers[axis], 2 * middle - left - right)
        assert power[0, axis] == pytest.approx(expected, rel=1e-4)
        left, middle, right = (
            v + expected * math.log(gain[2 - axis][0, 4 + s])
            for v, s in zip((left, middle, right), (-1, 0, 1), strict=True)
        )
        assert d[0, axis] == pytest.approx(0.5 * (right - left) / (2 * middle - left - right), rel=1e-3)


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
