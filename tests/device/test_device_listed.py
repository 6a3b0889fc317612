"""Lists of the voxels that hold light, plane by plane."""

import numpy as np
import pytest

pytest.importorskip("jax")

import jax.numpy as jnp

from plenopiv.device.listed import SHORTEST, listed, listed_shape, run_of

GRID = (4, 30, 50)


def volume_of(share, seed=0):
    """Lit voxels everywhere but in plane 1."""
    lit = np.random.default_rng(seed).random(GRID) < share
    lit[1] = False
    return np.where(lit, np.float32(2), np.float32(0))


@pytest.mark.parametrize("share", [0.0, 0.03, 1.1])
def test_each_plane_is_listed_in_order(share):
    volume = volume_of(share)
    found = listed(jnp.asarray(volume))
    voxels, start = np.asarray(found.voxels), np.asarray(found.start)
    assert voxels.shape[1] == run_of(GRID)
    for k, plane in enumerate(volume):
        of_plane = voxels[start[k] : start[k + 1]].ravel()
        numbers = np.flatnonzero(plane)
        np.testing.assert_array_equal(of_plane[: numbers.size], numbers)
        assert (of_plane[numbers.size :] == plane.size).all()
        assert of_plane.size - numbers.size < run_of(GRID)
    assert (voxels[start[-1] :] == volume[0].size).all()


def test_a_shorter_list_takes_the_room_of_the_one_before():
    first = listed(jnp.asarray(volume_of(0.5)))
    second = listed(jnp.asarray(volume_of(0.05)), len(first.voxels))
    assert second.voxels.shape == first.voxels.shape
    assert second.start[-1] < first.start[-1]
    longer = listed(jnp.asarray(volume_of(1.1)), len(second.voxels))
    assert len(longer.voxels) >= longer.start[-1]


def test_what_is_planned_holds_its_share_of_each_plane():
    planned = listed_shape(GRID, 0.2)
    assert planned.voxels.shape[1] == run_of(GRID) >= SHORTEST
    found = listed(jnp.asarray(volume_of(0.15)))
    assert found.voxels.shape[0] <= planned.voxels.shape[0]
