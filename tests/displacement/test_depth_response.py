"""What part of a displacement in depth one pass finds."""

import numpy as np
import pytest

from plenopiv.displacement import multigrid
from plenopiv.displacement.depth_response import LEAST, depth_response
from plenopiv.displacement.multigrid import OnePair, measure
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import PassResult
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import DenseVolume, VoxelGrid

SHAPE = (60, 64, 64)
SETTINGS = CorrelationSettings(((32, 32, 16),), inner_window=(24, 24, 13))
WINDOWS = window_grid(SHAPE, *SETTINGS.passes[-1])
STILL = fit_spline(np.zeros((3, *WINDOWS.shape)), WINDOWS.centres, SHAPE)


class Finds:
    """Windows that find the part ``r`` (nz,) of a displacement of .1 voxel along each axis, with noise."""

    def __init__(self, r, noise=0.02, lit=True):
        self.r, self.noise, self.lit, self.asked = np.asarray(r), noise, lit, []

    def correlated(self, windows, predictor, settings, search, step_done=None, scatter=False):
        self.asked.append(windows)
        moved, rng = predictor.at(*windows.centres), np.random.default_rng(len(self.asked))
        part = np.interp(windows.starts[0], WINDOWS.starts[0], self.r)[:, None, None]
        found = moved + part * (0.1 - moved) + rng.normal(0, self.noise, moved.shape)
        lit = np.broadcast_to(self.lit, windows.shape).copy()
        return PassResult(found, lit, np.ones(windows.shape, np.float32))


def of(pairs, windows=WINDOWS, predictor=STILL):
    """The part found, after a last pass."""
    last = pairs.correlated(windows, predictor, SETTINGS, SETTINGS.residual_search)
    return depth_response(pairs, windows, predictor, SETTINGS, last)


@pytest.mark.parametrize("part", [1.0, 0.6, 0.35])
def test_part_found_is_measured_in_each_layer(part):
    r = np.linspace(part, 0.8 * part, WINDOWS.shape[0])
    found = of(Finds(r))
    assert found.shape == (WINDOWS.shape[0],)
    np.testing.assert_allclose(found, r, atol=0.05)


def test_part_is_within_its_limits():
    count = WINDOWS.shape[0]
    assert of(Finds(np.full(count, 1.3))).max() == 1.0
    assert of(Finds(np.zeros(count))).min() == LEAST


def test_windows_without_light_say_nothing():
    count = WINDOWS.shape[0]
    np.testing.assert_array_equal(of(Finds(np.full(count, 0.5), lit=False)), 1.0)


def test_only_a_sample_of_windows_is_asked():
    pairs, wide = Finds(np.full(WINDOWS.shape[0], 0.5)), window_grid((60, 300, 300), *SETTINGS.passes[-1])
    predictor = fit_spline(np.zeros((3, *wide.shape)), wide.centres, (60, 300, 300))
    of(pairs, wide, predictor)
    assert len(pairs.asked) == 2
    for sample in pairs.asked[1:]:
        assert max(sample.shape[1:]) <= 6
        assert sample.shape[0] <= -(-wide.shape[0] // 2)
        assert sample.step[0] <= sample.size[0]  # no plane between layers is left out
        assert all(set(few) <= set(all_) for few, all_ in zip(sample.starts, wide.starts, strict=True))


def particles(length, moved=0.0, count=900, others=1):
    """Volumes (z, y, x) of Gaussian particles, sigma 0.8 across and ``length`` in depth, ``moved`` in depth; a tenth of
    them elsewhere in each."""
    rng, axes = np.random.default_rng(1), []
    at = rng.uniform(-8, np.array(SHAPE) + 8, (count, 3)) + np.array([moved, 0, 0])
    at[: count // 10] = np.random.default_rng(others).uniform(0, SHAPE, (count // 10, 3))
    for k, (n, sigma) in enumerate(zip(SHAPE, (length, 0.8, 0.8), strict=True)):
        axes.append(np.exp(-((np.arange(n) - at[:, [k]]) ** 2) / (2 * sigma**2)))
    values = np.einsum("pz,py,px->zyx", *axes, optimize=True)
    return DenseVolume(VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), SHAPE), values.astype(np.float32))


def test_long_particles_show_less_of_a_displacement_and_have_longer_error_bars(monkeypatch):
    short, long = (OnePair(particles(s), particles(s, moved=0.1, others=2)) for s in (1.0, 4.0))
    assert of(short).mean() > 0.9
    assert of(long).mean() < 0.5
    known = measure(long.a, long.b, SETTINGS)
    monkeypatch.setattr(multigrid, "depth_response", lambda pairs, windows, *_: np.ones(windows.shape[0]))
    unknown = measure(long.a, long.b, SETTINGS)
    np.testing.assert_array_equal(known.displacement, unknown.displacement)
    np.testing.assert_array_equal(known.std[:2], unknown.std[:2])
    assert np.median(known.std[2] / unknown.std[2]) > 1.3
