"""Pinhole cameras by the device's code on this processor: the projection and the candidates of the kernels."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.tomography import cubes, four_cameras

pytest.importorskip("jax")
import jax.numpy as jnp

from plenopiv.device.projection import forward, gather, on_device
from plenopiv.projection.pinhole.projector import PinholeProjector
from plenopiv.volume import SparseVolume

pytestmark = pytest.mark.usefixtures("one_thread")


def bent():
    """Cameras turned far, one with a narrower sensor, with distorted images, and voxels that are no cubes."""
    cameras = [replace(camera, distortion=(-0.3, 0.2)) for camera in four_cameras(40, angle_deg=35.0)]
    cameras[1] = replace(cameras[1], sensor=replace(cameras[1].sensor, columns=26))
    return PinholeProjector(cameras, cubes(20, 18, 8, (0.1, 0.06, 0.074)))


def straight():
    return PinholeProjector(four_cameras(24), cubes(24, 20, 12))  # which do not see its corners


@pytest.mark.parametrize("cameras", [straight, pytest.param(bent, marks=pytest.mark.full)])
def test_light_and_back_are_those_of_the_kernels(cameras):
    projector = cameras()
    rng, views = np.random.default_rng(0), np.array([2, 0, 1, 3])
    dense = rng.random(projector.grid.shape, np.float32) * 1000
    listed = SparseVolume.from_mask(projector.grid, dense >= 0).with_values(dense.ravel())
    device = on_device(projector)
    light = forward(device, views, jnp.asarray(dense))
    kernels = projector.forward(views, listed)
    images = rng.normal(size=light.shape).astype(np.float32) * projector.seen[views]
    back, sums = gather(device, views, images), projector.gather(views, images, listed).reshape(dense.shape)
    assert np.abs(light - kernels).max() <= 1e-5 * kernels.max()
    assert np.abs(back - sums).max() <= 1e-5 * np.abs(sums).max()
    apart = np.sum(light * images.astype(np.float64)) - np.sum(back * dense.astype(np.float64))
    assert abs(apart) <= 1e-6 * np.linalg.norm(light) * np.linalg.norm(images)
    np.testing.assert_array_equal(light, forward(device, views, jnp.asarray(dense)))


@pytest.mark.parametrize("threshold", [0.0, 30.0, 60.0])
def test_the_same_voxels_are_lit(threshold):
    projector = straight()
    images = np.random.default_rng(2).uniform(-10, 90, (4, 24 * 24)).astype(np.float32)
    expected = projector.candidates(images, threshold)
    found = np.asarray(on_device(projector).candidates(images, threshold))
    assert 0 < expected.column.size < projector.grid.size
    np.testing.assert_array_equal(found > 0, expected.mask())
    np.testing.assert_allclose(found, expected.dense().values, rtol=1e-4)


def test_the_same_voxels_are_seen():
    projector = straight()
    found = np.asarray(on_device(projector).visible_voxels()) > 0
    assert 0 < found.mean() < 1
    np.testing.assert_array_equal(found, projector.visible_voxels().mask())
