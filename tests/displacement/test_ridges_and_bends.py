"""Correlations that are ridges, and error bars of vectors that are means where the flow bends."""

import numpy as np
import pytest

from plenopiv.displacement.peaks import untilted
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.uncertainty import standard_deviation
from plenopiv.displacement.windows import window_grid

SHAPE = (44, 100, 120)
SETTINGS = CorrelationSettings(windows=((40, 32, 16),), inner_window=(20, 16, 10))
WINDOWS = window_grid(SHAPE, (40, 32, 16), 0.5)
INNER = window_grid(SHAPE, (20, 16, 10), 0.6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_ridge_along_an_axis_is_not_turned(axis):
    """What is the same along an axis has no curvature there: sections are taken as they are, however the other two lie
    to one another."""
    z, y, x = np.mgrid[-1:2, -1:2, -1:2]
    one, other = [(y, x), (z, x), (z, y)][axis]
    ridge = np.exp(-0.5 * (one * one + other * other) + 0.3 * one * other)
    matrix = np.empty((3, 3))
    untilted(ridge, 1, 1, 1, matrix)
    np.testing.assert_array_equal(matrix, np.eye(3))


def parabola(windows, axis, bend):
    """u = bend x^2 / 2 at the vectors of windows, x in voxels along an axis (z, y, x)."""
    place = np.meshgrid(*windows.centres, indexing="ij")[axis]
    out = np.zeros((3, *windows.shape))
    out[0] = 0.5 * bend * (place - 0.5 * SHAPE[axis]) ** 2
    return out


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_error_bars_of_a_bending_flow_without_noise(axis):
    """A window's mean of a parabola misses its value at the centre by (n^2 - 1) bend/24. That is the error bar of a
    window's own vector; of the mean over a larger window, .55 of what its sub-windows miss is left."""
    bend, n = 4e-3, INNER.size[axis]
    field = parabola(INNER, axis, bend)
    valid, variance = np.ones(INNER.shape, bool), np.full(field.shape, 1e-14)
    missed = np.mean((np.arange(n) - 0.5 * (n - 1)) ** 2) * bend / 2
    assert missed == pytest.approx((n * n - 1) * bend / 24)
    own = standard_deviation(field, valid, variance, INNER, SETTINGS)
    np.testing.assert_allclose(own[0], missed, rtol=0.02)
    np.testing.assert_allclose(own[1:], 0, atol=1e-6)
    mean = standard_deviation(field, valid, variance, INNER, SETTINGS, WINDOWS)
    assert mean.shape == (3, *WINDOWS.shape)
    np.testing.assert_allclose(mean[0], np.sqrt(0.3) * missed, rtol=0.02)
    np.testing.assert_allclose(mean[1:], 0, atol=1e-6)
