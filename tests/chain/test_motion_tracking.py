"""Both frames of a pair reconstructed together: where voxels go, what they begin with, and what it is good for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.cameras.space_map import SpaceMap
from plenopiv.chain import Chain
from plenopiv.displacement.deformation import DeformedPlanes
from plenopiv.displacement.field import DisplacementField
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.motion_tracking import FAINTEST, SharedGuess, displacement_of_frame, reconstruct_together
from plenopiv.reconstruction.settings import ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.simulation.images import particle_image
from plenopiv.simulation.particles import Particles
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid.covering((-0.5, 0.5), (-0.4, 0.4), (0.5, 1.7), (0.025, 0.025, 0.1))
WINDOWS = CorrelationSettings(windows=((32, 32, 12),), inner_window=(16, 16, 8), fine_passes=1)
MOVED_MM = np.array([0.05, 0.025, 0.1])
LIGHT = 20_000.0
GRADIENT = np.array([[0.02, 0.0, 0.1], [0.0, -0.03, 0.0], [0.0, 0.01, 0.0]])  # of dx, dy, dz by x, y, z, in voxels
START = np.array([2.0, -1.0, 0.7])


def chain(**settings):
    camera = small_camera("hexagonal", pmr=8, microlenses=(30, 26))
    return Chain((camera,), GRID, ReconstructionSettings(iterations=5, **settings), WINDOWS, 0.5)


def linear_field(grid=GRID, shape=(3, 4, 5)):
    """What moves by START + GRADIENT x at mid-time."""
    z, y, x = (np.linspace(2, n - 3, m) for n, m in zip(grid.shape, shape, strict=True))
    at = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1)
    moved = np.moveaxis(START + at @ GRADIENT.T, -1, 0)
    return DisplacementField(z, y, x, moved, moved, np.ones(shape, bool), np.ones(shape, np.float32), 0 * moved)


def moved_at(spline, at):
    """(3,) of a spline at voxel (x, y, z)."""
    return spline.at(*(np.array([c]) for c in at[::-1]))[:, 0, 0, 0]


@pytest.mark.parametrize("sign", [1, -1])
def test_voxels_go_where_the_flow_at_mid_time_takes_them(sign):
    """X' = X + D with D = d(X + D/2) for the first frame, and back: to second order in the gradient."""
    spline, at = displacement_of_frame(chain(), linear_field(), sign), np.array([18.0, 15.0, 6.0])
    exact = sign * np.linalg.solve(np.eye(3) - sign * GRADIENT / 2, START + GRADIENT @ at)
    assert moved_at(spline, at) == pytest.approx(exact, abs=np.abs(GRADIENT).max() ** 2 * np.abs(exact).max())
    without_mid_time = sign * (START + GRADIENT @ at)
    assert np.abs(without_mid_time - exact).max() > 10 * np.abs(moved_at(spline, at) - exact).max()


def test_in_lens_space_it_is_what_the_map_makes_of_it():
    """A laboratory twice as deep, and displaced: the same motion is half as many millimetres in depth."""
    rng = np.random.default_rng(0)
    lens = rng.uniform(-2, 2, (400, 3))
    space = SpaceMap.fitted(lens * (1.0, 1.0, 2.0) + (0.1, -0.2, 0.4), lens, 2)
    grid = VoxelGrid.covering((-0.4, 0.6), (-0.6, 0.2), (1.4, 3.8), (0.025, 0.025, 0.2))
    behind = replace(chain(), grid=grid, space=space)
    shape = (3, 4, 5)
    even = replace(linear_field(grid), displacement=np.broadcast_to(START[:, None, None, None], (3, *shape)))
    spline = displacement_of_frame(behind, even, 1)
    voxel = np.array(behind.lens_grid.voxel_mm)
    expected = START * grid.voxel_mm / (1.0, 1.0, 2.0) / voxel
    assert moved_at(spline, np.array(behind.lens_grid.shape[::-1]) / 2) == pytest.approx(expected, abs=1e-3)


def test_a_guess_is_the_mean_of_both_frames_and_some_light_everywhere():
    rng = np.random.default_rng(1)
    own, other = (rng.random(GRID.shape, np.float32) * (rng.random(GRID.shape) < 0.2) for _ in range(2))
    spline = displacement_of_frame(chain(), linear_field(), 1)
    moved = DeformedPlanes(DenseVolume(GRID, other.astype(np.float32)), spline, 1.0)
    guess = SharedGuess(SparseVolume.of(DenseVolume(GRID, own.astype(np.float32))), moved)
    listed = SparseVolume.of(DenseVolume(GRID, (rng.random(GRID.shape) < 0.5).astype(np.float32)))
    light = (own + moved.slab(0, GRID.shape[0]))[listed.mask()]
    assert guess(listed) == pytest.approx(light + FAINTEST * light.mean(), rel=1e-5)
    tile = cut(GRID.shape[1], 3, 4)[1]
    part, where = listed.y_range(tile.low, tile.high), np.zeros(GRID.shape, bool)
    where[:, tile.low : tile.high] = listed.mask()[:, tile.low : tile.high]
    light = (own + moved.slab(0, GRID.shape[0]))[where]
    assert guess(part) == pytest.approx(light + FAINTEST * light.mean(), rel=1e-5)


def frames(chain, count, moved_mm, seed=0):
    """Images of both frames, and where the particles are in the first."""
    half = [0.5 * (hi - lo) for lo, hi in GRID.limits_mm()]
    middle = [0.5 * (hi + lo) for lo, hi in GRID.limits_mm()]
    at = np.random.default_rng(seed).uniform(-0.9, 0.9, (count, 3)) * half + middle - moved_mm / 2
    light, black = np.full(count, LIGHT), chain.camera.sensor.black_level
    return [particle_image(chain.camera, Particles(p, light)) + black for p in (at, at + moved_mm)], at


def ghost_share(volume, at_mm):
    """Of a volume's light that farther than a voxel from every particle."""
    index = np.rint((at_mm - GRID.first_mm) / GRID.voxel_mm).astype(int)
    near = np.zeros(GRID.shape, bool)
    for x, y, z in index:
        near[max(z - 1, 0) : z + 2, max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2] = True
    dense = volume.slab(0, GRID.shape[0])
    return float(dense[~near].sum() / dense.sum())


def test_each_frame_begins_with_the_other_where_the_flow_takes_it(monkeypatch):
    """The other frame's light is where the own one's is, and was not before it was moved."""
    both, guesses = chain(motion_tracking=1), []
    images, _ = frames(both, 60, MOVED_MM)
    volumes = [both.reconstruct([image]).volume for image in images]

    def kept(self, images, name, progress, static, guess):
        guesses.append(guess)
        return SimpleNamespace(volume=guess.own)

    monkeypatch.setattr(Chain, "reconstruct", kept)
    assert reconstruct_together(both, images, volumes) == tuple(volumes)
    for guess, own, other in zip(guesses, volumes, volumes[::-1], strict=True):
        assert guess.own is own
        light, moved, still = (v.slab(0, GRID.shape[0]).ravel() for v in (own, guess.moved, other))
        assert np.corrcoef(light, moved)[0, 1] > 0.6
        assert np.corrcoef(light, still)[0, 1] < 0.3


def test_a_guess_without_light_is_even():
    """As in the margin of a tile, of which both volumes have nothing."""
    one = chain()
    images, _ = frames(one, 60, MOVED_MM)
    nothing = one.reconstruct([images[0]], guess=lambda volume: np.zeros(volume.values.size, np.float32)).volume
    even = one.reconstruct([images[0]], guess=lambda volume: np.ones(volume.values.size, np.float32)).volume
    assert nothing.values.tobytes() == even.values.tobytes()
    assert np.isfinite(nothing.values).all()


@pytest.mark.full
def test_ghosts_lose_light():
    """A seventh of the light that is beside particles goes where they are, and half of the errors in depth."""
    both = chain(motion_tracking=1)
    images, at = frames(both, 200, MOVED_MM)
    volumes = [both.reconstruct([image]).volume for image in images]
    together = reconstruct_together(both, images, volumes)
    for alone, found, where in zip(volumes, together, (at, at + MOVED_MM), strict=True):
        assert ghost_share(found, where) < 0.9 * ghost_share(alone, where)
    errors = []
    for pair in (volumes, together):
        off = both.displacement(*pair).displacement - (MOVED_MM / GRID.voxel_mm)[:, None, None, None]
        errors.append(np.sqrt((off**2).mean((1, 2, 3))))
    assert errors[1][2] < 0.75 * errors[0][2]
    assert errors[1].max() < errors[0].max()


@pytest.mark.full
def test_fluid_at_rest_is_measured_no_worse():
    """Ghosts rest where particles do: nothing tells them apart, and nothing gets worse."""
    both = chain(motion_tracking=1)
    images, _ = frames(both, 400, np.zeros(3))
    rng = np.random.default_rng(3)
    noisy = [image + rng.normal(0, 5, image.shape) for image in images]
    volumes = [both.reconstruct([image]).volume for image in noisy]
    alone, found = (both.displacement(*pair) for pair in (volumes, reconstruct_together(both, noisy, volumes)))
    assert np.sqrt((found.displacement**2).mean()) < 1.05 * np.sqrt((alone.displacement**2).mean()) + 1e-3


@pytest.mark.full
def test_in_tiles_it_is_the_same():
    """But for the views' equations at the tiles' borders, of which margins take most."""
    both = chain(motion_tracking=1)
    images, _ = frames(both, 60, MOVED_MM)
    volumes = [both.reconstruct([image]).volume for image in images]
    tiled = both.with_tiles(cut(GRID.shape[1], 2, both.projection.passage))
    for whole, parts in zip(*(reconstruct_together(c, images, volumes) for c in (both, tiled)), strict=True):
        a, b = (volume.slab(0, GRID.shape[0]).ravel() for volume in (whole, parts))
        assert np.corrcoef(a, b)[0, 1] > 0.98


def test_without_passes_volumes_are_those_of_each_frame():
    one = chain()
    images, _ = frames(one, 50, MOVED_MM)
    volumes = [one.reconstruct([image]).volume for image in images]
    for found, volume in zip(reconstruct_together(one, images, volumes), volumes, strict=True):
        assert found is volume
