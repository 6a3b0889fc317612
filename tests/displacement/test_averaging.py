"""Means over sub-windows against sums over voxels written out, and what they find of a flow that bends."""

import numpy as np
import pytest

from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.noise_amplification import noise_amplification
from plenopiv.displacement.overlap import fade
from plenopiv.displacement.resolution import averaged_share
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.sub_windows import average_sub_windows, mean_weights
from plenopiv.displacement.uncertainty import standard_deviation
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError

SHAPE = (40, 72, 90)
WINDOWS = window_grid(SHAPE, (32, 32, 16), 0.5)
INNER = window_grid(SHAPE, (20, 20, 10), 0.6)
WHOLE = CorrelationSettings(windows=((32, 32, 32),), inner_window=(32, 32, 32))
RESOLVED = CorrelationSettings(windows=((32, 32, 32),), inner_window=(20, 20, 20))


def between(values, knots, place, extrapolate):
    """The value at one place along one axis, linear between knots."""
    if not extrapolate:
        place = min(max(place, knots[0]), knots[-1])
    n = 0
    while n < len(knots) - 2 and place > knots[n + 1]:
        n += 1
    share = (place - knots[n]) / (knots[n + 1] - knots[n])
    return (1 - share) * values[n] + share * values[n + 1]


@pytest.mark.parametrize("extrapolate", [True, False])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mean_is_that_of_the_voxels(axis, extrapolate):
    weights = mean_weights(WINDOWS, INNER, extrapolate)[axis]
    knots = INNER.centres[axis]
    values = np.random.default_rng(axis).normal(size=len(knots))
    assert WINDOWS.starts[axis][0] < knots[0]  # so that some voxels lie beyond the outermost inner vector
    for start, found in zip(WINDOWS.starts[axis], weights @ values, strict=True):
        voxels = [between(values, knots, start + n, extrapolate) for n in range(WINDOWS.size[axis])]
        assert found == pytest.approx(sum(voxels) / len(voxels))


def test_a_mean_over_a_share_is_that_of_the_middle_of_the_window():
    share = (0.5, 0.75, 0.8)  # along x, y, z
    for axis, part in enumerate(share[::-1]):
        weights = mean_weights(WINDOWS, INNER, True, share)[axis]
        knots, size = INNER.centres[axis], WINDOWS.size[axis]
        values = np.random.default_rng(axis).normal(size=len(knots))
        for middle, found in zip(WINDOWS.centres[axis], weights @ values, strict=True):
            places = middle + part * (np.arange(size) - (size - 1) / 2)
            assert found == pytest.approx(np.mean([between(values, knots, place, True) for place in places]))


@pytest.mark.parametrize("share", [(1.0, 1.0, 1.0), (0.5, 0.75, 0.8)])
def test_linear_fields_come_back_exactly_at_the_faces_too(share):
    slopes = np.random.default_rng(0).normal(size=(3, 3))
    inner, whole = (
        np.einsum("ca,a...->c...", slopes, np.meshgrid(*g.centres, indexing="ij")) for g in (INNER, WINDOWS)
    )
    found, raw, valid, ratio = average_sub_windows(
        inner, inner, np.ones(INNER.shape, bool), np.full(INNER.shape, 3, np.float32), INNER, WINDOWS, share
    )
    np.testing.assert_allclose(found, whole, atol=1e-12)
    np.testing.assert_allclose(raw, whole, atol=1e-12)
    np.testing.assert_allclose(ratio, 3, rtol=1e-6)
    assert valid.all()
    assert valid.shape == WINDOWS.shape


def test_one_inner_window_along_an_axis_is_the_mean():
    inner = window_grid((10, 72, 90), (20, 20, 10), 0.6)
    weights = mean_weights(window_grid((10, 72, 90), (32, 32, 10), 0.5), inner, True)
    assert weights[0].tolist() == [[1.0]]


def test_a_peak_without_a_second_does_not_outshine_the_others():
    ratio = np.full(INNER.shape, 4.0, np.float32)
    ratio[:2] = 1e3
    ratio[-2:] = 0.0
    still = np.zeros((3, *INNER.shape))
    *_, found = average_sub_windows(still, still, np.ones(INNER.shape, bool), ratio, INNER, WINDOWS)
    assert (found[0] >= 4.0).all()
    assert (found[0] < 20.0).all()
    assert ((found[-1] >= 1.0) & (found[-1] < 4.0)).all()
    *_, none = average_sub_windows(still, still, np.ones(INNER.shape, bool), 0 * ratio, INNER, WINDOWS)
    assert (none == 0).all()


def test_where_most_inside_is_an_outlier_the_window_is_replaced_and_its_raw_vector_says_what_was_measured():
    valid = np.ones(INNER.shape, bool)
    corner = tuple(slice(0, n) for n in (3, 3, 3))
    valid[corner] = False
    raw = np.where(valid, 1.0, 9.0)[None].repeat(3, 0)
    mean, as_measured, measured, _ = average_sub_windows(
        np.ones_like(raw), raw, valid, np.ones(INNER.shape, np.float32), INNER, WINDOWS
    )
    assert np.argwhere(~measured).tolist() == [[0, 0, 0]]
    np.testing.assert_allclose(mean, 1.0)
    assert (as_measured[:, 0, 0, 0] > 5).all()
    np.testing.assert_allclose(as_measured[:, measured], 1.0)


@pytest.mark.parametrize("depth", [16, 40, 96])
def test_noise_left_in_means_is_that_of_white_noise_averaged_twice(depth):
    """One pass: a vector is the noise under its tapered window. At the faces, where vectors are continued straight on,
    and where one or two lie above one another, too."""
    shape = (depth, 64, 80)
    inner, whole = window_grid(shape, (16,) * 3, 0.5), window_grid(shape, (32, 32, min(depth, 32)), 0.5)
    settings = CorrelationSettings(windows=((16,) * 3,), inner_window=(16,) * 3, overlap=0.5, fine_passes=1)
    assert len(settings.passes) == 1
    means = mean_weights(whole, inner, True)
    weight = fade(16, settings.taper_voxels) ** 2
    expected = []
    for total, starts, rows in zip(shape, inner.starts, means, strict=True):
        seen = np.zeros((len(starts), total))
        for n, start in enumerate(starts):
            seen[n, start : start + 16] = weight / weight.sum()
        expected.append(((rows @ seen) ** 2).sum(1) / (seen[0] ** 2).sum())
    left = noise_amplification(inner, settings).variance_of_mean(means)
    np.testing.assert_allclose(left, np.einsum("z,y,x->zyx", *expected), rtol=0.02)


def test_more_passes_leave_less_in_a_mean():
    """What iteration adds are short waves."""
    inner, whole = window_grid((64,) * 3, (20,) * 3, 0.6), window_grid((64,) * 3, (32,) * 3, 0.5)
    means, left = mean_weights(whole, inner, True), []
    for passes in (1, 2, 3):
        amplification = noise_amplification(
            inner, CorrelationSettings(((32,) * 3,), inner_window=(20,) * 3, fine_passes=passes)
        )
        left.append(amplification.variance_of_mean(means))
        assert (left[-1] * amplification.gain).max() < 1
    assert (left[0] > left[1]).all()
    assert (left[1] > left[2]).all()


def test_error_bars_of_means():
    inner, whole = window_grid((64,) * 3, (20,) * 3, 0.6), window_grid((64,) * 3, (32,) * 3, 0.5)
    still, variance, valid = np.zeros((3, *inner.shape)), np.full((3, *inner.shape), 0.04), np.ones(inner.shape, bool)
    amplification = noise_amplification(inner, RESOLVED)
    left = amplification.variance_of_mean(mean_weights(whole, inner, True, averaged_share(RESOLVED)))
    std = standard_deviation(still, valid, variance, inner, RESOLVED, whole)
    np.testing.assert_allclose(std, np.broadcast_to(np.sqrt(amplification.gain * left * 0.04), std.shape))
    assert left[1, 1, 1] < left[0, 0, 0] < 0.7  # at a corner the outermost vectors count most

    along_x = np.array(np.meshgrid(*inner.centres, indexing="ij"))[2]
    of_noise = amplification.bias_share * amplification.gain * 0.04
    for second_difference in (0.05, 0.006, 0.003):  # q^2 above, about twice and half what noise alone gives it
        bent, q = second_difference * along_x**2, second_difference * 20**2 / 12
        of_bent = standard_deviation(bent[None].repeat(3, 0), valid, variance, inner, RESOLVED, whole)
        np.testing.assert_allclose(of_bent**2 - std**2, 0.3 * max(q**2 - of_noise, 0.0), atol=1e-12)

    valid[:3, :3, :3] = False
    replaced = standard_deviation(still, valid, variance, inner, RESOLVED, whole)
    np.testing.assert_allclose(replaced[:, 0, 0, 0], np.sqrt(amplification.gain * 0.04))
    np.testing.assert_allclose(replaced[:, 1:], std[:, 1:])


def wave(p):
    """Along x, over three windows."""
    return 3.0 * np.sin(2 * np.pi * p[:, [1]] / 96) * [1, 0, 0]


def mean_of_wave(y, size):
    return 3.0 * np.mean([np.sin(2 * np.pi * (y + n - (size - 1) / 2) / 96) for n in range(size)], 0)


def test_inner_windows_find_what_bends_in_a_window_and_say_how_well(particle_pair):
    pairs = [particle_pair((64, 96, 64), wave, 14 / 32**3, seed=seed) for seed in (3, 4, 5)]
    inside, errors = [], []
    for settings in (WHOLE, RESOLVED):
        fields = [measure(*pair, settings) for pair in pairs]
        np.testing.assert_array_equal(fields[0].y, window_grid((64, 96, 64), (32, 32, 32), 0.5).centres[1])
        error = [field.displacement[0] - mean_of_wave(field.y, 32)[:, None] for field in fields]
        errors.append(np.sqrt(np.mean(np.square(error))))
        inside.append(np.mean(np.abs(error) <= 2 * np.array([field.std[0] for field in fields])))
    assert errors[1] < 0.6 * errors[0]
    assert all(field.valid.all() for field in fields)
    assert min(inside) > 0.8


@pytest.mark.parametrize("shift", [(3.2, 0.0, 0.0), (0.0, -2.6, 0.0), (0.0, 0.0, 2.3)])
def test_signs_are_those_of_windows(particle_pair, uniform_flow, shift):
    field = measure(*particle_pair((64, 64, 64), uniform_flow(shift), 14 / 32**3), RESOLVED)
    np.testing.assert_allclose(field.displacement.mean((1, 2, 3)), shift, atol=0.03)
    assert field.valid.all()


@pytest.mark.parametrize(
    ("inner", "said"),
    [((48, 32, 32), "larger than the last"), ((32, 32, 4), "8 voxels or more"), ((8, 8), r"\[x, y, z\]")],
)
def test_inner_windows_that_do_not_fit_are_refused(inner, said):
    with pytest.raises(PlenoPIVError, match=f"correlation.inner_window: .*{said}"):
        CorrelationSettings(windows=((32, 32, 32),), inner_window=inner)


def test_three_quarters_of_the_last_window_unless_said_otherwise():
    sizes = (64, 64, 32), (48, 40, 8)
    usual, none = CorrelationSettings(sizes), CorrelationSettings(sizes, inner_window=sizes[-1])
    assert usual.sub_window == (36, 30, 8)
    assert usual.passes == [((64, 64, 32), 0.5), ((48, 40, 8), 0.5), ((36, 30, 8), 0.5), ((36, 30, 8), 0.6)]
    assert none.sub_window is None
    assert none.passes == [((64, 64, 32), 0.5), *[((48, 40, 8), 0.5)] * 2]
