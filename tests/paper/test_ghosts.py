"""The parts of paper/ghosts.py against loops."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "paper"))

import ghosts

from plenopiv.accuracy.volumes import near_particles
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.full

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
    np.testing.assert_array_equal(box.values, volume.dense().values[:, 6:12, 5:15])


def test_voxels_near_particles():
    at = np.array([[0.02, 0.01, -0.3], [0.8, -0.8, 0.65], [5.0, 0.0, 0.0]])
    z, y, x = np.meshgrid(*GRID.axes()[::-1], indexing="ij")
    far = [np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) for a, b, c in at]
    near = near_particles(GRID, at, ghosts.NEAR)
    assert 0 < near.sum() < near.size / 2
    np.testing.assert_array_equal(near, np.min(far, 0) <= ghosts.NEAR * 0.1)


def test_it_is_ghosts():
    """As measured: where all is lit that lines of sight cross, windows see the jet without ghosts alone."""
    few, many = json.loads((Path(ghosts.__file__).parent / "results/ghosts.json").read_text())["cases"]
    assert few["light_of_ghosts"] < 0.5 < many["light_of_ghosts"]
    assert few["as_it_is"]["gross"] < 0.15
    assert many["as_it_is"]["gross"] > 0.5
    assert many["without_ghosts"]["gross"] < 0.2
