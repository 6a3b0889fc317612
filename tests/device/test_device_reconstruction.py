"""Whole reconstructions by the device's code on this processor: the volumes of the kernels."""

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.tomography import cubes, four_cameras

pytest.importorskip("jax")

from plenopiv.cameras.pose import FRONT, SIDE
from plenopiv.device.reconstruct import reconstruct
from plenopiv.errors import PlenoPIVError
from plenopiv.lightfield import layout
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.projection.several_cameras import SeveralCameras
from plenopiv.reconstruction.reconstruct import reconstruct as on_processor
from plenopiv.reconstruction.settings import TOMOGRAPHY, ReconstructionSettings
from plenopiv.reconstruction.tiles import cut
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("one_thread")]

GRID = VoxelGrid.covering((-0.25, 0.25), (-0.5, 0.5), (-2.2, -1.6), (0.03, 0.03, 0.06))
WHERE = layout(small_camera("hexagonal", pmr=8, microlenses=(13, 19), offset_mm=(0.011, -0.005)))
PROJECTOR = PlenopticProjector(WHERE, GRID)


def frame_of(projection, count=40, light=2e4, noise=2.0, full=np.inf, seed=0):
    """The views of a few particles, each three voxels deep, with noise."""
    rng, dense = np.random.default_rng(seed), np.zeros(projection.grid.shape, np.float32)
    for k, j, i in zip(*(rng.integers(2, n - 2, count) for n in projection.grid.shape), strict=True):
        dense[k - 1 : k + 2, j, i] = light / 2, light, light / 2
    volume = SparseVolume.from_mask(projection.grid, dense > 0).with_values(dense[dense > 0])
    views = np.array([projection.forward(np.array([view]), volume)[0] for view in range(projection.views)])
    return (np.minimum(views + rng.normal(0, noise, views.shape), full) * projection.seen).astype(np.float32)


def compared(values, projection, settings, **options):
    """Both reconstructions; the same candidates and residuals, and volumes correlated at more than .9999."""
    expected = on_processor(values, projection, settings, **options)
    found = reconstruct(values, projection, settings, **options)
    one, other = (each.volume.dense().values.ravel() for each in (expected, found))
    correlation = np.corrcoef(one, other)[0, 1]
    print(
        f"\ncorrelated at 1 - {1 - correlation:.1e}; {expected.volume.column.size} voxels, residuals {found.residuals}"
    )
    assert correlation > 0.9999
    assert found.candidates == expected.candidates
    assert (found.threshold, found.particle, found.noise) == (expected.threshold, expected.particle, expected.noise)
    assert abs(found.volume.column.size - expected.volume.column.size) <= 0.01 * expected.volume.column.size
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-3)
    assert found.volume.values.min() > 0
    return found


def test_a_frame_of_a_plenoptic_camera():
    compared(frame_of(PROJECTOR), PROJECTOR, ReconstructionSettings())


def test_saturated_pixels_and_static_light():
    full = PROJECTOR.layout.camera.sensor.full_scale - PROJECTOR.layout.camera.sensor.black_level
    values = frame_of(PROJECTOR, light=4e5, full=full)
    assert (values >= full - 0.5).any()
    background = np.full(values.shape, 7, np.float32) * PROJECTOR.seen
    compared(values, PROJECTOR, ReconstructionSettings(iterations=2, relaxation=1.0), background=background)


@pytest.mark.parametrize("options", [{"method": "mart"}, {"candidates": "product", "seed": 3}])
def test_other_settings(options):
    compared(frame_of(PROJECTOR), PROJECTOR, ReconstructionSettings(iterations=2, **options))


def test_tiles():
    tiles = cut(GRID.shape[1], 2, PROJECTOR.passage)
    assert tiles[0].high > tiles[0].end
    found = compared(frame_of(PROJECTOR), PROJECTOR, ReconstructionSettings(iterations=2, relaxation=1.0), tiles=tiles)
    assert found.volume.grid == GRID


def test_the_same_bits_twice():
    values, settings = frame_of(PROJECTOR), ReconstructionSettings(iterations=2)
    one, two = (reconstruct(values, PROJECTOR, settings) for _ in range(2))
    np.testing.assert_array_equal(one.volume.column, two.volume.column)
    np.testing.assert_array_equal(one.volume.values, two.volume.values)
    assert one.residuals == two.residuals


def test_pinhole_cameras():
    projector = PinholeProjector(four_cameras(48), cubes(24, 20, 12))
    values = frame_of(projector, light=300, noise=1.0)
    compared(values, projector, TOMOGRAPHY)


@pytest.mark.full
def test_pinhole_cameras_in_tiles():
    projector = PinholeProjector(four_cameras(48), cubes(24, 20, 12))
    values = frame_of(projector, light=300, noise=1.0)
    compared(values, projector, TOMOGRAPHY, tiles=cut(20, 2, projector.passage))


@pytest.mark.full
def test_two_cameras_around_a_volume():
    grid = VoxelGrid.covering((-0.3, 0.3), (-0.3, 0.3), (-0.3, 0.3), (0.04, 0.04, 0.04))
    poses, where = (FRONT, SIDE), layout(small_camera("hexagonal", pmr=8, microlenses=(14, 14)))
    several = SeveralCameras(grid, [PlenopticProjector(where, pose.grid(grid)) for pose in poses], poses)
    values = frame_of(several, count=15)
    compared(values, several, ReconstructionSettings(iterations=3))
    compared(values, several, ReconstructionSettings(iterations=2), tiles=cut(grid.shape[1], 2, several.passage))


def test_progress_counts_views():
    values, seen = frame_of(PROJECTOR), []
    settings = ReconstructionSettings(iterations=2)
    reconstruct(values, PROJECTOR, settings, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (2 * PROJECTOR.views, 2 * PROJECTOR.views)
    assert seen == sorted(seen)


def test_a_frame_without_particles_is_told_of():
    dark = np.zeros(PROJECTOR.seen.shape, np.float32)
    with pytest.raises(PlenoPIVError, match="frame 3: no particles"):
        reconstruct(dark, PROJECTOR, ReconstructionSettings(), name="frame 3")
