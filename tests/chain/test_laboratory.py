"""Volumes in lens space, vectors in the laboratory: positions and displacements are the laboratory's."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.tomography import cubes, four_cameras

from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.cameras.space_map import SpaceMap
from plenopiv.chain import Chain
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.focus import focus_weight
from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.run.plan import plan
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.volume import VoxelGrid

N = 1.333
CAMERA = small_camera("hexagonal", pmr=10, microlenses=(76, 62))
GRID = VoxelGrid.covering((3.8, 6.4), (-3.0, -1.0), (0.5, 3.5), (0.0275, 0.0275, 0.1))  # of the laboratory
SMALL_CAMERA = small_camera("hexagonal", pmr=10, microlenses=(40, 36))
SMALL = VoxelGrid.covering((4.5, 5.7), (-2.5, -1.5), (1.0, 3.0), (0.0275, 0.0275, 0.1))
MIDDLE = np.array([5.1, -2.0, 2.0])
SETTINGS = ReconstructionSettings(iterations=3)
WINDOWS = CorrelationSettings(windows=((32, 32, 16),), inner_window=(16, 16, 8))
GRADIENT = np.array([[0.004, 0.03, -0.008], [-0.03, 0.006, 0.01], [0.02, 0.015, -0.02]])  # of displacements
MOVED_MM = np.array([0.04, -0.03, 0.12])


def behind_water(p):
    """Laboratory to lens space: depth shrinks by n, magnification changes with it, and the frame is shifted, turned by
    0.3 degrees about z and sheared."""
    turn = np.radians(0.3)
    x, y, z = (np.asarray(p, float) - MIDDLE).T
    x, y = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    return np.stack([x + 0.01 * x * z + 0.02 * z, y + 0.01 * y * z - 0.01 * x, z / N + 0.01 * x * x + 1.7], -1)


def turned_by_a_quarter(p):
    """The laboratory's x is the camera's y, and its z points away from the camera."""
    x, y, z = (np.asarray(p, float) - MIDDLE).T
    return np.stack([y, x, 1.7 - z / N], -1)


@cache
def space(function):
    axes = [np.linspace(lo - 0.4, hi + 0.4, 6) for lo, hi in GRID.limits_mm()]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return SpaceMap.fitted(points, function(points), 4)


@cache
def chain_of(function, small=False):
    found = None if function is None else space(function)
    camera, grid = (SMALL_CAMERA, SMALL) if small else (CAMERA, GRID)
    return Chain((camera,), grid, SETTINGS, WINDOWS, 0.5, space=found)


def volumes_of(chain, function, moved, count, seed=0):
    """Both volumes of particles about the volume that move by ``moved(positions)`` in mm."""
    rng = np.random.default_rng(seed)
    half = np.array([0.5 * (hi - lo) + 0.3 for lo, hi in chain.grid.limits_mm()])
    at = rng.uniform(-1, 1, (count, 3)) * half + MIDDLE
    light = np.full(count, 15_000.0)
    return tuple(
        chain.reconstruct([particle_image(chain.camera, Particles(function(p), light), rays=2000)]).volume
        for p in (at - moved(at) / 2, at + moved(at) / 2)
    )


def measured(chain, *scene):
    """The field of the laboratory of ``volumes_of``, 1 ms apart."""
    return chain.velocity(*volumes_of(chain, *scene), dt_s=1e-3).isel(time=0)


def test_a_linear_flow_behind_water_is_the_laboratory_s():
    field = measured(chain_of(behind_water), behind_water, lambda p: MOVED_MM + (p - MIDDLE) @ GRADIENT.T, 1800)
    z, y, x = np.meshgrid(field.z, field.y, field.x, indexing="ij")
    at = np.stack([x, y, z], -1)
    true = MOVED_MM + (at - MIDDLE) @ GRADIENT.T
    found = np.stack([field[name].values for name in "uvw"], -1)
    off = (found - true) / GRID.voxel_mm
    rms, bias = np.sqrt((off**2).mean((0, 1, 2))), off.mean((0, 1, 2))
    print(f"RMS {rms}, bias {bias} voxels, {off[..., 0].size} vectors")
    assert field.attrs["frame"] == "laboratory"
    deep = WINDOWS.windows[-1][2] * GRID.voxel_mm[2]
    in_half = np.linspace(-0.25, 0.25, 101)[:, None, None, None, None] * (0.0, 0.0, deep) + at
    nearest = CAMERA.dead_zones(chain_of(behind_water).space.to_lens(in_half)[..., 2]).min(0)
    assert (field.near_focus.values == (nearest < 1.5)).all()
    assert field.valid.all()
    assert (rms < (0.04, 0.04, 0.08)).all()  # of the like flow in lens space, without a map: 0.025, 0.027, 0.07
    assert (np.abs(bias) < 0.03).all()


@pytest.mark.parametrize("function", [pytest.param(behind_water, marks=pytest.mark.full), turned_by_a_quarter])
@pytest.mark.parametrize("axis", range(3))
def test_a_motion_along_an_axis_of_the_laboratory_is_along_that_axis(function, axis):
    step = np.zeros(3)
    step[axis] = 1.5 * GRID.voxel_mm[axis]
    field = measured(chain_of(function, small=True), function, lambda p: np.broadcast_to(step, p.shape), 300)
    for name, want, voxel in zip("uvw", step, GRID.voxel_mm, strict=True):
        assert float(field[name].median()) == pytest.approx(want, abs=0.15 * voxel)


@pytest.mark.parametrize("axis", range(3))
def test_a_particle_lies_where_it_is_in_the_laboratory(axis):
    at = MIDDLE.copy()
    at[axis] += 0.3
    chain = chain_of(behind_water, small=True)
    others = np.array([[-0.5, -0.4, -0.6], [0.5, 0.4, -0.6]]) + MIDDLE  # an image of one particle alone is too dark
    image = particle_image(SMALL_CAMERA, Particles(behind_water(np.vstack([at, others])), np.full(3, 15_000.0)))
    volume = chain.in_laboratory(chain.reconstruct([image]).volume)
    assert volume.grid == SMALL
    light = volume.dense().values
    z, y, x = np.meshgrid(*SMALL.axes()[::-1], indexing="ij")
    near = (np.abs(x - at[0]) < 0.15) & (np.abs(y - at[1]) < 0.15) & (np.abs(z - at[2]) < 0.5)
    centre = [np.average(c[near], weights=light[near]) for c in (x, y, z)]
    np.testing.assert_allclose((centre - at) / GRID.voxel_mm, 0, atol=0.5)


def test_voxels_of_lens_space_are_the_laboratory_s():
    chain = chain_of(behind_water)
    grid = chain.lens_grid
    np.testing.assert_allclose(grid.voxel_mm, np.array(GRID.voxel_mm) / (1, 1, N), rtol=0.01)
    corners = np.stack(np.meshgrid(*GRID.limits_mm(), indexing="ij"), -1).reshape(-1, 3)
    low, high = np.array(grid.limits_mm()).T
    image = behind_water(corners)
    assert (image > low + 0.9 * np.array(grid.voxel_mm)).all()
    assert (image < high - 0.9 * np.array(grid.voxel_mm)).all()
    assert grid.size < 1.35 * GRID.size
    quarter = chain_of(turned_by_a_quarter).lens_grid
    np.testing.assert_allclose(quarter.shape, np.array(GRID.shape)[[0, 2, 1]] + 2, atol=1)
    assert chain_of(None).lens_grid is GRID


@pytest.mark.full
def test_an_ensemble_of_one_pair_is_that_pair():
    chain = chain_of(behind_water, small=True)
    volumes = volumes_of(chain, behind_water, lambda p: np.broadcast_to(MOVED_MM, p.shape), 300)
    assert chain.ensemble([volumes], 1e-3).identical(chain.velocity(*volumes, 1e-3))


def test_tiles_are_those_of_lens_space():
    """A volume of the laboratory that is turned has other rows; the light in tiles is that of the whole."""
    chain = chain_of(turned_by_a_quarter, small=True)
    rows = chain.lens_grid.shape[1]
    assert rows != chain.grid.shape[1]
    at = np.random.default_rng(1).uniform(-0.4, 0.4, (40, 3)) + MIDDLE
    image = particle_image(SMALL_CAMERA, Particles(turned_by_a_quarter(at), np.full(40, 15_000.0)), rays=2000)
    whole = chain.in_laboratory(chain.reconstruct([image]).volume)
    planned = plan(chain)
    assert planned.tiles == 1
    in_tiles = chain.with_tiles(cut(rows, 2, chain.projection.passage))
    parts = in_tiles.in_laboratory(in_tiles.reconstruct([image]).volume)
    assert parts.values.sum() == pytest.approx(whole.values.sum(), rel=0.05)
    a, b = (volume.dense().values.ravel() for volume in (whole, parts))
    assert np.corrcoef(a, b)[0, 1] > 0.9


def test_what_a_run_takes_is_of_both_grids():
    """Reconstruction takes what lens space asks for, correlation what the laboratory does."""
    chain = chain_of(behind_water)
    here, there = plan(chain), plan(replace(chain, space=None, grid=chain.lens_grid))
    assert here.needed.volumes == there.needed.volumes
    assert here.takes.frame == there.takes.frame
    assert here.takes.pair > plan(replace(chain, space=None)).takes.pair
    assert here.needed.layers > plan(replace(chain, space=None)).needed.layers


def test_focus_is_where_the_lens_has_it():
    chain = chain_of(behind_water)
    chain = replace(chain, reconstruction=replace(chain.reconstruction, focus_reach=8.0))  # the volume's far side
    x, y, z = GRID.axes()
    for k, j, i in [(0, 0, 0), (len(z) // 2, 20, 15), (len(z) - 1, len(y) - 1, len(x) - 1), (3, len(y) - 1, 0)]:
        depth = chain.space.to_lens([x[i], y[j], z[k]])[2]
        weight = chain.depth_weights.slab(k, k + 1, GRID.shape[1:])[0, j, i]
        expected = focus_weight(chain.camera, np.array([depth]), chain.reconstruction.focus_reach)[0]
        assert weight == pytest.approx(expected, abs=0.02)
    assert 0 < chain.depth_weights.values.min() < 0.5 * chain.depth_weights.values.max()


def test_it_pickles_and_differs_by_its_map():
    chain = chain_of(behind_water)
    assert pickle.loads(pickle.dumps(chain)) == chain
    assert chain != chain_of(turned_by_a_quarter)
    assert chain.frame == "laboratory"
    assert chain_of(None).frame == "camera"


def test_what_a_map_does_not_go_with():
    chain = chain_of(behind_water)
    for other in (
        replace(chain, cameras=(CAMERA, CAMERA), poses=(FRONT, SIDE)),
        Chain(tuple(four_cameras(40)), cubes(24, 23, 22), TOMOGRAPHY, space=chain.space),
    ):
        with pytest.raises(PlenoPIVError, match="this takes one plenoptic camera"):
            _ = other.projection
    far = replace(chain, space=space(lambda p: behind_water(p) + np.array([0.0, 0.0, 150.0])))
    with pytest.raises(PlenoPIVError, match=r"not in front of the main lens at 100 mm; is the calibration"):
        _ = far.projection
