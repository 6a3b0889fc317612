"""Reconstruction quality and centres, against closed forms."""

from math import erf

import numpy as np
import pytest

from plenopiv.accuracy import exact_volume, ghost_light, intensity_centre_mm, reconstruction_quality
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

GRID = VoxelGrid((-0.5, -0.3, -1.0), (0.02, 0.02, 0.08), (25, 31, 51))


def test_a_volume_is_like_itself_and_its_multiples():
    rng = np.random.default_rng(0)
    volume = DenseVolume(GRID, rng.random(GRID.shape, dtype=np.float32))
    assert reconstruction_quality(volume, volume) == pytest.approx(1.0)
    assert reconstruction_quality(DenseVolume(GRID, 7 * volume.values), volume) == pytest.approx(1.0)


def test_ghosts_of_equal_number_and_light_halve_the_square():
    """One true particle and one ghost like it: Q = 1/sqrt(2). Light elsewhere alone: 0."""
    true = exact_volume([[-0.2, 0.0, 0.0]], 5.0, GRID)
    ghost = exact_volume([[0.2, 0.0, 0.0]], 5.0, GRID)
    both = DenseVolume(GRID, true.values + ghost.values)
    assert reconstruction_quality(both, true) == pytest.approx(np.sqrt(0.5), abs=1e-6)
    assert reconstruction_quality(ghost, true) == pytest.approx(0.0, abs=1e-9)


def test_a_shift_of_a_gaussian_follows_the_closed_form():
    """Q of Gaussians of one width, d apart, is exp(-d^2 / (4 sigma^2)); voxels widen them by 1/12 each."""
    diameter, shift = 8.0, 2.0
    centre = np.array([[0.0, 0.0, 0.0]])
    moved = np.array([[0.0, 0.0, shift * 0.08]])
    q = reconstruction_quality(exact_volume(moved, 1.0, GRID, diameter), exact_volume(centre, 1.0, GRID, diameter))
    assert q == pytest.approx(np.exp(-(shift**2) / (4 * ((diameter / 4) ** 2 + 1 / 12))), abs=2e-3)


def test_sparse_volumes_are_compared_too():
    exact = exact_volume([[0.0, 0.0, 0.0], [0.3, 0.1, 0.5]], [1.0, 3.0], GRID)
    sparse = SparseVolume.from_mask(GRID, exact.values > 0)
    sparse = sparse.with_values(exact.values[exact.values > 0])
    assert reconstruction_quality(sparse, exact) == pytest.approx(1.0)


def test_empty_and_unlike_volumes():
    empty = DenseVolume(GRID, np.zeros(GRID.shape, np.float32))
    assert np.isnan(reconstruction_quality(empty, exact_volume([[0, 0, 0]], 1.0, GRID)))
    small = VoxelGrid(GRID.first_mm, GRID.voxel_mm, (2, 2, 2))
    with pytest.raises(PlenoPIVError, match="one grid"):
        reconstruction_quality(DenseVolume(small, np.zeros((2, 2, 2), np.float32)), empty)


def test_volumes_in_different_places_are_unlike():
    exact = exact_volume([[0.0, 0.0, 0.0]], 1.0, GRID)
    moved = VoxelGrid((6.5, -0.3, -1.0), GRID.voxel_mm, GRID.shape)
    with pytest.raises(PlenoPIVError, match="one grid"):
        reconstruction_quality(DenseVolume(moved, exact.values), exact)


def test_the_exact_volume_holds_each_particle_s_light_where_it_is():
    places, light = np.array([[-0.21, 0.05, -0.33], [0.17, -0.11, 0.41]]), np.array([2.0, 5.0])
    volume = exact_volume(places, light, GRID)
    assert volume.values.sum() == pytest.approx(light.sum(), rel=1e-3)
    for place, brightness in zip(places, light, strict=True):
        centre = intensity_centre_mm(volume, tuple(place), (0.1, 0.1, 0.3))
        np.testing.assert_allclose(centre, place, atol=1e-3)
        k, j, i = (round(v) for v in ((place - GRID.first_mm) / GRID.voxel_mm)[::-1])
        assert volume.values[k - 3 : k + 4, j - 3 : j + 4, i - 3 : i + 4].sum() == pytest.approx(brightness, rel=1e-3)


def test_particles_at_and_beyond_the_border_are_cut():
    edge = exact_volume([[-0.51, -0.3, -1.0]], 1.0, GRID)  # on a face along x, in the first voxel's centre along y, z
    inside = 0.5 + 0.5 * erf(0.5 / (0.75 * np.sqrt(2.0)))  # half of it and half a voxel; sigma is 3/4 voxel
    assert edge.values.sum() == pytest.approx(0.5 * inside**2, abs=1e-3)
    assert exact_volume([[9.0, 0.0, 0.0]], 1.0, GRID).values.sum() == 0.0


def test_the_centre_of_a_box_weighs_by_intensity():
    values = np.zeros(GRID.shape, np.float32)
    values[10, 15, 20], values[11, 15, 20], values[10, 15, 22] = 1.0, 2.0, 1.0
    values[20, 15, 20] = 100.0  # outside the reach
    x, y, z = GRID.axes()
    centre = intensity_centre_mm(DenseVolume(GRID, values), (x[20], y[15], z[10]), (0.1, 0.1, 0.2))
    np.testing.assert_allclose(centre, [(3 * x[20] + x[22]) / 4, y[15], (2 * z[10] + 2 * z[11]) / 4])
    assert np.isnan(intensity_centre_mm(DenseVolume(GRID, values), (x[40], y[2], z[2]), (0.05, 0.05, 0.1))).all()


def test_a_particle_may_be_wider_along_one_axis():
    """Diameters go with x, y, z: the second moment along each axis is sigma^2 and a voxel's 1/12."""
    diameters = (4.0, 6.0, 8.0)
    place = np.zeros(3)
    volume = exact_volume([place], 1.0, GRID, diameters).values.astype(float)
    index = (place - GRID.first_mm) / GRID.voxel_mm
    for axis, (diameter, centre, over) in enumerate(zip(diameters, index, ((0, 1), (0, 2), (1, 2)), strict=True)):
        along = volume.sum(over)
        moment = along @ (np.arange(len(along)) - centre) ** 2 / along.sum()
        assert moment == pytest.approx((diameter / 4) ** 2 + 1 / 12, rel=0.02), "xyz"[axis]
    one, three = (exact_volume([place], 1.0, GRID, diameter) for diameter in (4.0, (4.0, 4.0, 4.0)))
    np.testing.assert_array_equal(one.values, three.values)


def test_light_far_from_every_particle_is_a_ghost():
    """Three voxels of 1, 2 and 4: in a particle's voxel, 2.9 voxels off along z, and 3.1 voxels off along x."""
    x, y, z = GRID.axes()
    values = np.zeros(GRID.shape, np.float32)
    values[10, 15, 12], values[13, 15, 12], values[10, 15, 15] = 1, 2, 4
    place = np.array([x[12] - 0.1 * 0.02, y[15], z[10] + 0.1 * 0.08])
    volume = DenseVolume(GRID, values)
    assert ghost_light(volume, [place]) == pytest.approx(4 / 7)
    assert ghost_light(volume, [place, (x[15], y[15], z[10])]) == 0
    assert ghost_light(volume, [place], 2.8) == pytest.approx(6 / 7)
    assert ghost_light(volume, [(x[0], y[0], z[0] - 1)]) == 1
    assert np.isnan(ghost_light(DenseVolume(GRID, 0 * values), [place]))
    mask = SparseVolume.from_mask(GRID, values > 0)
    assert ghost_light(mask.with_values(np.array([1, 4, 2], np.float32)), [place]) == pytest.approx(4 / 7)


def test_the_centre_of_even_light_is_where_it_was_sought():
    """The voxels at both ends of the reach count."""
    even = DenseVolume(GRID, np.ones(GRID.shape, np.float32))
    place = np.add(GRID.first_mm, (10 * 0.02, 12 * 0.02, 11 * 0.08))
    centre = intensity_centre_mm(even, tuple(place), (3 * 0.02, 3 * 0.02, 3 * 0.08))
    np.testing.assert_allclose(centre, place, atol=1e-9)
