"""The parts of paper/ghosts.py against loops."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import ghosts

from plenopiv.simulation.particles import Particles
from plenopiv.volume import SparseVolume, VoxelGrid

GRID = VoxelGrid.covering((-1.0, 1.0), (-0.9, 0.9), (-0.7, 0.7), (0.1, 0.1, 0.1))


@pytest.fixture
def volume():
    rng = np.random.default_rng(4)
    lit = rng.random(GRID.shape) < 0.3
    return SparseVolume.from_mask(GRID, lit).with_values(rng.uniform(1, 2, int(lit.sum())).astype(np.float32))


def test_the_middle_of_a_volume_lies_where_it_lay(volume):
    box = ghosts.middle(volume, (1.0, 0.6, 5.0))
    assert box.grid.shape == (14, 6, 10)
    np.testing.assert_allclose(box.grid.limits_mm(), [(-0.5, 0.5), (-0.3, 0.3), (-0.7, 0.7)], atol=1e-9)
    np.testing.assert_array_equal(box.dense().values, volume.dense().values[:, 6:12, 5:15])


def test_light_near_particles(volume):
    at = np.array([[0.02, 0.01, -0.3], [0.8, -0.8, 0.65], [5.0, 0.0, 0.0]])
    near = ghosts.near_particles(volume, Particles(at, np.ones(3)))
    x, y, z = (np.array(axis) for axis in GRID.axes())
    k, j, i = np.nonzero(volume.dense().values)
    places = np.column_stack([x[i], y[j], z[k]])
    expected = [min(np.linalg.norm(place - p) for p in at) < ghosts.NEAR * 0.1 for place in places]
    assert 0 < sum(expected) < len(expected) / 2
    np.testing.assert_array_equal(near, expected)


def test_it_is_ghosts():
    """As measured: where all is lit that lines of sight cross, windows see the jet without ghosts alone."""
    few, many = json.loads((Path(ghosts.__file__).parent / "results/ghosts.json").read_text())["cases"]
    assert few["light_of_ghosts"] < 0.5 < many["light_of_ghosts"]
    assert few["as_it_is"]["gross"] < 0.15
    assert many["as_it_is"]["gross"] > 0.5
    assert many["without_ghosts"]["gross"] < 0.2
