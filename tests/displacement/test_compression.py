"""Volumes as they are correlated, against sums written out, and where that leaves a particle's centre."""

import numpy as np
import pytest

from plenopiv.displacement.compression import CompressedVolume, compressed
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

SHAPE = (5, 7, 9)
GRID = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), SHAPE)


def sparse_volume(seed=0):
    """Two voxels in five hold light, some of them at the faces."""
    rng = np.random.default_rng(seed)
    volume = SparseVolume.from_mask(GRID, rng.random(SHAPE) < 0.4)
    return volume.with_values(rng.uniform(0.1, 9.0, volume.values.size).astype(np.float32))


def written_out(values, exponent):
    """Each voxel: 3/4 of its own and 1/8 of either neighbour's light, along x, then along y (its own again where there
    is no neighbour), then the power."""
    nz, ny, nx = values.shape
    out = np.zeros(values.shape)
    for k, j, i in np.ndindex(nz, ny, nx):
        for dj, along_y in ((-1, 0.125), (0, 0.75), (1, 0.125)):
            for di, along_x in ((-1, 0.125), (0, 0.75), (1, 0.125)):
                beside = min(max(j + dj, 0), ny - 1), min(max(i + di, 0), nx - 1)
                out[k, j, i] += along_y * along_x * max(values[k, *beside], 0.0)
    return out**exponent


@pytest.mark.parametrize("exponent", [0.5, 0.35, 2.0])
def test_intensities_are_blended_and_raised(exponent):
    volume = sparse_volume()
    expected = written_out(volume.dense().values, exponent)
    np.testing.assert_allclose(compressed(volume, exponent).slab(0, 5), expected, rtol=2e-6, atol=1e-6)
    negative = DenseVolume(GRID, volume.dense().values - np.float32(2.0))
    found = compressed(negative, exponent).slab(0, 5)
    np.testing.assert_allclose(found, written_out(negative.values, exponent), rtol=2e-6, atol=1e-6)


def test_slabs_are_those_of_the_whole_and_empty_beyond_it():
    volume = compressed(sparse_volume(), 0.5)
    whole = volume.slab(0, 5)
    np.testing.assert_array_equal(volume.slab(2, 4), whole[2:4])
    around = volume.slab(-2, 7)
    np.testing.assert_array_equal(around[2:7], whole)
    assert not around[:2].any()
    assert not around[7:].any()


def test_exponent_one_leaves_a_volume_as_it_is():
    volume = sparse_volume()
    assert compressed(volume, 1.0) is volume
    np.testing.assert_array_equal(CompressedVolume(volume, factor=3.0).slab(0, 5), 3 * volume.slab(0, 5))
    np.testing.assert_array_equal(CompressedVolume(volume, factor=3.0).values, 3 * volume.values)


def test_factor_comes_after_the_power():
    volume = sparse_volume()
    once = CompressedVolume(CompressedVolume(volume, 0.5), factor=4.0)
    np.testing.assert_allclose(once.slab(0, 5), 4 * compressed(volume, 0.5).slab(0, 5))
    np.testing.assert_allclose(once.values, 4 * np.sqrt(volume.values))


def test_any_volume_can_be_listed():
    light = compressed(sparse_volume(), 0.5)
    listed = SparseVolume.of(light)
    np.testing.assert_array_equal(listed.slab(0, 5), light.slab(0, 5))
    assert listed.values.all()
    assert listed.values.size == np.count_nonzero(light.slab(0, 5))


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_a_blended_particle_stays_where_it_is(exponent):
    """Of a particle that is even about a voxel or between two, the centre along x and y."""
    grid = VoxelGrid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 15, 15))
    for centre in (7.0, 7.5):
        profile = np.exp(-((np.arange(15) - centre) ** 2) / 2)
        light = compressed(DenseVolume(grid, (profile[:, None] * profile)[None].astype(np.float32)), exponent).slab(
            0, 1
        )
        for axis in (1, 2):
            along = np.moveaxis(light, axis, 0).reshape(15, -1).sum(1)
            assert along @ np.arange(15) / along.sum() == pytest.approx(centre, abs=1e-4)
