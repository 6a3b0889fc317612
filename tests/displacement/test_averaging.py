"""Means over inner windows against sums over voxels written out, and what they find of a flow that bends."""

import numpy as np
import pytest

from plenopiv.displacement.averaging import averaged, mean_weights
from plenopiv.displacement.correlation import fade
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.uncertainty import iteration_gain, standard_deviation
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError

SHAPE = (40, 72, 90)
WINDOWS = window_grid(SHAPE, (32, 32, 16), 0.5)
INNER = window_grid(SHAPE, (20, 20, 10), 0.6)
WHOLE = CorrelationSettings(windows=((32, 32, 32),))
RESOLVED = CorrelationSettings(windows=((32, 32, 32),), inner_window=(20, 20, 20))


def between(values, knots, place, straight_on):
    """The value at one place along one axis, linear between knots."""
    if not straight_on:
        place = min(max(place, knots[0]), knots[-1])
    n = 0
    while n < len(knots) - 2 and place > knots[n + 1]:
        n += 1
    share = (place - knots[n]) / (knots[n + 1] - knots[n])
    return (1 - share) * values[n] + share * values[n + 1]


@pytest.mark.parametrize("straight_on", [True, False])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mean_is_that_of_the_voxels(axis, straight_on):
    weights = mean_weights(WINDOWS, INNER, straight_on)[axis]
    knots = INNER.centres[axis]
    values = np.random.default_rng(axis).normal(size=len(knots))
    assert WINDOWS.starts[axis][0] < knots[0]  # so that some voxels lie beyond the outermost inner vector
    for start, found in zip(WINDOWS.starts[axis], weights @ values, strict=True):
        voxels = [between(values, knots, start + n, straight_on) for n in range(WINDOWS.size[axis])]
        assert found == pytest.approx(sum(voxels) / len(voxels))


def test_linear_fields_come_back_exactly_at_the_faces_too():
    slopes = np.random.default_rng(0).normal(size=(3, 3))
    inner, whole = (
        np.einsum("ca,a...->c...", slopes, np.meshgrid(*g.centres, indexing="ij")) for g in (INNER, WINDOWS)
    )
    found, raw, valid, ratio = averaged(
        inner, inner, np.ones(INNER.shape, bool), np.full(INNER.shape, 3, np.float32), INNER, WINDOWS
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


def test_where_most_inside_is_an_outlier_the_window_is_replaced_and_its_raw_vector_says_what_was_measured():
    valid = np.ones(INNER.shape, bool)
    corner = tuple(slice(0, n) for n in (3, 3, 3))
    valid[corner] = False
    raw = np.where(valid, 1.0, 9.0)[None].repeat(3, 0)
    mean, as_measured, measured, _ = averaged(
        np.ones_like(raw), raw, valid, np.ones(INNER.shape, np.float32), INNER, WINDOWS
    )
    assert np.argwhere(~measured).tolist() == [[0, 0, 0]]
    np.testing.assert_allclose(mean, 1.0)
    assert (as_measured[:, 0, 0, 0] > 5).all()
    np.testing.assert_allclose(as_measured[:, measured], 1.0)


def test_noise_left_in_a_mean_is_that_of_white_noise_averaged_twice():
    """One pass: a vector is the noise under its tapered window; the mean over a whole window is that of vectors."""
    inner, whole = window_grid((96,) * 3, (16,) * 3, 0.5), window_grid((96,) * 3, (32,) * 3, 0.5)
    settings = CorrelationSettings(windows=((32,) * 3,), inner_window=(16,) * 3, inner_overlap=0.5, fine_passes=1)
    _, _, left = iteration_gain(inner, settings, whole)
    weight = fade(16, settings.taper_voxels) ** 2
    axis = np.zeros((inner.shape[0], 96))
    for n, start in enumerate(inner.starts[0]):
        axis[n, start : start + 16] = weight / weight.sum()
    middle = mean_weights(whole, inner, True)[0][2] @ axis  # of a window away from the faces, along one axis
    one = (axis[2] ** 2).sum()
    assert left == pytest.approx(((middle**2).sum() / one) ** 3, rel=0.05)


def test_a_uniform_variance_is_what_is_left_of_it():
    inner, whole = window_grid((64,) * 3, (20,) * 3, 0.6), window_grid((64,) * 3, (32,) * 3, 0.5)
    still, variance = np.zeros((3, *inner.shape)), np.full((3, *inner.shape), 0.04)
    gain, _, left = iteration_gain(inner, RESOLVED, whole)
    std = standard_deviation(still, np.ones(inner.shape, bool), variance, inner, RESOLVED, whole)
    assert std.shape == (3, *whole.shape)
    np.testing.assert_allclose(std, np.sqrt(gain * left * 0.04))
    assert 0 < left < 0.5


def wave(p):
    """Along x, over three windows."""
    return 3.0 * np.sin(2 * np.pi * p[:, [1]] / 96) * [1, 0, 0]


def mean_of_wave(y, size):
    return 3.0 * np.mean([np.sin(2 * np.pi * (y + n - (size - 1) / 2) / 96) for n in range(size)], 0)


def test_inner_windows_find_what_bends_in_a_window_and_say_how_well(particle_pair):
    pair = particle_pair((64, 96, 64), wave, 14 / 32**3, seed=3)
    inside, errors = [], []
    for settings in (WHOLE, RESOLVED):
        field = measure(*pair, settings)
        np.testing.assert_array_equal(field.y, window_grid((64, 96, 64), (32, 32, 32), 0.5).centres[1])
        error = field.displacement[0] - mean_of_wave(field.y, 32)[:, None]
        errors.append(np.sqrt((error**2).mean()))
        inside.append((np.abs(error) <= 2 * field.std[0]).mean())
    assert errors[1] < 0.6 * errors[0]
    assert field.valid.all()
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
