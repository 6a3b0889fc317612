"""Weights by depth: where they are, and that they shift no displacement."""

import numpy as np
import pytest
from oracles.particle_volumes import render

from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.volume import DenseVolume, VoxelGrid

ALL_ALIKE = np.zeros(1), np.zeros(1)
VARIED = DepthWeights(
    np.random.default_rng(3).uniform(0.2, 1.0, (12, 3, 2)).astype(np.float32),
    np.array([2.0, 10.0, 15.0]),
    np.array([4.0, 9.0]),
)


def at(weights, z, y, x):
    """One place at a time, linear along each axis, the outermost values beyond."""
    along_z = [
        np.interp(x, weights.x, [np.interp(y, weights.y, plane[:, c]) for c in range(plane.shape[1])])
        for plane in weights.values.astype(float)
    ]
    return float(np.interp(z, np.arange(len(along_z)), along_z))


def test_of_planes_is_linear_between_the_places():
    slab = VARIED.slab(3, 7, (20, 14))
    assert slab.shape == (4, 20, 14)
    for k, j, i in [(0, 0, 0), (1, 6, 5), (3, 19, 13), (2, 12, 7)]:
        assert slab[k, j, i] == pytest.approx(at(VARIED, 3 + k, j, i), rel=1e-6)


def test_planes_that_count_alike_stay_one_value_each():
    weights = DepthWeights(np.arange(1, 6, dtype=np.float32)[:, None, None], *ALL_ALIKE)
    np.testing.assert_array_equal(weights.slab(1, 3, (20, 14)).ravel(), [2, 3])


@pytest.mark.parametrize(
    "weights", [VARIED, DepthWeights(VARIED.values[:, :1, :1], *ALL_ALIKE)], ids=["tilted", "flat"]
)
def test_of_windows_is_the_geometric_mean_of_both_places(weights):
    centres, moved = np.array([[1.0, 3.0], [6.5, 8.0], [13.0, 20.0]]), np.array([0.0, 3.0, -1.5])
    found = weights.of_windows(4, 6, centres, moved)
    assert found.shape == (3, 6)
    for row, (y, x), d in zip(found, centres, moved, strict=True):
        for k, value in enumerate(row):
            both = at(weights, 4 + k - d / 2, y, x) * at(weights, 4 + k + d / 2, y, x)
            assert value == pytest.approx(np.sqrt(both), rel=1e-6)


def test_one_plane_is_enough():
    weights = DepthWeights(np.full((1, 1, 1), 0.5, np.float32), *ALL_ALIKE)
    np.testing.assert_array_equal(weights.of_windows(0, 1, np.zeros((2, 2)), np.array([0.0, 0.4])), [[0.5], [0.5]])


SHAPE, LONG, MOVED = (48, 48, 48), 3.0, 2.0
HEIGHT = np.arange(SHAPE[0]) + 4.0  # voxels above the plane of no weight
RISING = (HEIGHT / HEIGHT.max()) ** 2


def long_particles(moved):
    """Gaussian in depth with a standard deviation of LONG voxels."""
    centres = np.random.default_rng(5).uniform((2, 2, 4), (46, 46, 44), (130, 3)) + np.array([0, 0, moved])
    values = render(SHAPE, centres, np.ones(len(centres)), (1.0, 1.0, LONG))
    return DenseVolume(VoxelGrid((0.0,) * 3, (1.0,) * 3, SHAPE), values)


def in_the_middle(a, b, depth=None):
    """Mean displacement in depth of the windows about the height of the middle, and that height."""
    settings = CorrelationSettings(
        windows=((24, 24, 24),),
        inner_window=(24, 24, 24),
        fine_passes=3,
        intensity_exponent=1.0,
        whitening=0.0,
        agreement=0.0,
    )
    field = measure(a, b, settings, depth=depth)
    return float(field.displacement[2][1].mean()), HEIGHT[0] + field.z[1]


def test_weights_do_not_pull_but_volumes_that_are_weighted_are_pulled_as_derived():
    a, b = long_particles(-MOVED / 2), long_particles(MOVED / 2)
    weights = DepthWeights(RISING.astype(np.float32)[:, None, None], *ALL_ALIKE)
    free, height = in_the_middle(a, b, weights)
    pulled, _ = in_the_middle(*(v.with_values(v.values * weights.values) for v in (a, b)))
    expected = MOVED / (1 + 2 * LONG**2 / height**2)
    assert expected < 0.98 * MOVED
    assert free == pytest.approx(MOVED, abs=0.01)
    assert pulled == pytest.approx(expected, abs=0.01)
    assert in_the_middle(a, b)[0] == pytest.approx(MOVED, abs=0.01)
