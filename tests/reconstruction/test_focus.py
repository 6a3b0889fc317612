"""How planes near focus count in the correlation."""

import numpy as np
from oracles.cameras import small_camera

from plenopiv.reconstruction.focus import focus_weight
from plenopiv.volume import SparseVolume, VoxelGrid


def test_weight_grows_as_the_square_to_one_at_the_reach():
    camera = small_camera("hexagonal")
    below, above = camera.dead_zone_mm()
    z = np.array([0.0, 1.5 * above, 3 * above, 5 * above, 1.5 * below, 3 * below, -4.0])
    np.testing.assert_allclose(focus_weight(camera, z, 3.0), [0, 0.25, 1, 1, 0.25, 1, 1], rtol=1e-6)
    assert (focus_weight(camera, z, 0.0) == 1).all()


def test_planes_are_scaled_each_by_its_own_factor():
    rng = np.random.default_rng(1)
    mask = rng.random((4, 3, 5)) < 0.5
    mask[2] = False
    grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (4, 3, 5))
    volume = SparseVolume.from_mask(grid, mask)
    factor = np.array([0.0, 0.5, 7.0, 1.0], np.float32)
    scaled = volume.with_planes_scaled(factor)
    np.testing.assert_array_equal(scaled.dense().values, volume.dense().values * factor[:, None, None])
