"""Limits of colours from the data: what is constant is no pattern, both signs share a scale, outliers count little."""

import numpy as np
import pytest

from plenopiv.report.limits import colour_limits


def test_both_signs_are_drawn_about_zero():
    assert colour_limits(np.linspace(-1, 3, 1001), outer=(0, 100)) == ("diverging", -3.0, 3.0)


def test_a_constant_component_lies_in_the_middle_of_its_colours():
    kind, low, high = colour_limits(np.full(100, 0.3), least_span=0.1)
    assert (kind, low, high) == ("sequential", pytest.approx(0.25), pytest.approx(0.35))
    assert colour_limits(np.zeros(5), least_span=0.1) == ("diverging", -0.05, 0.05)
    kind, low, high = colour_limits(np.zeros(5))
    assert (kind, low) == ("diverging", -high)
    assert high > 0


def test_noise_of_a_constant_component_does_not_fill_the_colours():
    noise = 0.3 + 1e-4 * np.random.default_rng(0).normal(size=1000)
    _, low, high = colour_limits(noise, least_span=0.1)
    shares = (noise - low) / (high - low)
    assert 0.45 < shares.min() < shares.max() < 0.55


@pytest.mark.parametrize("sign", [1, -1])
def test_one_sign_begins_at_zero_where_it_comes_near(sign):
    ends = colour_limits(sign * np.linspace(0.2, 1, 101), outer=(0, 100))[1:]
    assert ends == ((0.0, 1.0) if sign > 0 else (-1.0, 0.0))
    ends = colour_limits(sign * np.linspace(0.8, 1, 101), outer=(0, 100))[1:]
    assert ends == pytest.approx((0.8, 1.0) if sign > 0 else (-1.0, -0.8))


def test_an_outlier_does_not_fade_all_others():
    values = np.append(np.linspace(0, 1, 1000), [1e6, np.nan, np.inf])
    assert colour_limits(values)[2] < 1.01


def test_without_a_value_there_are_limits():
    assert colour_limits(np.full(4, np.nan)) == ("sequential", 0.0, 1.0)
