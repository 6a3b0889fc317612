"""Dense ray tracing by the device's code on this processor leaves the voxels that the kernels leave."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from oracles.cameras import small_camera

pytest.importorskip("jax")

from plenopiv.device import candidates
from plenopiv.device.projection import on_device
from plenopiv.lattice import LatticeMap
from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = [pytest.mark.full, pytest.mark.usefixtures("one_thread")]

NEAR = VoxelGrid.covering((-0.41, 0.39), (-0.3, 0.33), (-2.1, 2.0), (0.0385, 0.0385, 0.2))
FAR = VoxelGrid.covering((-0.2, 0.2), (-0.3, 0.3), (4.0, 5.0), (0.01, 0.01, 0.5))
FOCUS = VoxelGrid.covering((-0.41, 0.39), (-0.3, 0.33), (-0.02, 0.02), (0.01, 0.01, 0.02))  # judged together
LENS_MAP = LatticeMap(2, 0.25, ((0.012, 0.01), (-0.008, -0.015), (0.01, 0.0), (0.0, 0.02), (0.01, 0.0)))


@pytest.mark.parametrize(
    ("kind", "degrees", "grid", "lens_map", "light"),
    [
        ("hexagonal", 30.0, NEAR, LENS_MAP, True),
        ("square", 0.3, FOCUS, None, False),
        pytest.param("square", 90.0, NEAR, None, False, marks=pytest.mark.full),
        pytest.param("hexagonal", 0.5, FAR, None, False, marks=pytest.mark.full),
        pytest.param("hexagonal", 0.3, FOCUS, LENS_MAP, False, marks=pytest.mark.full),
    ],
)
def test_the_same_voxels_stay(kind, degrees, grid, lens_map, light, monkeypatch):
    monkeypatch.setattr(candidates, "SHORTEST", 512)  # so that runs of several lengths judge what is left of a plane
    camera = small_camera(kind, pmr=8, rotation_rad=radians(degrees), offset_mm=(0.013, -0.027))
    where = layout(camera.with_lattice(replace(camera.lattice, map=lens_map)))
    rng = np.random.default_rng(3)
    if light:
        where = replace(where, light=rng.uniform(0.6, 1.0, where.seen.shape).astype(np.float32))
    projector = PlenopticProjector(where, grid)
    dark = rng.random(where.seen.shape) < (0.8 if grid is NEAR else 0.3)
    most = np.where(dark, rng.uniform(0, 40, dark.shape), np.inf).astype(np.float32)
    expected, device = projector.candidates(most, 5000.0).mask(), on_device(projector)
    found, seen = (np.asarray(mask) > 0 for mask in (device.candidates(most, 5000.0), device.visible_voxels()))
    np.testing.assert_array_equal(seen, projector.visible_voxels().mask())
    assert 40 < expected.sum() < 0.95 * seen.sum()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("count", [0, 1, 4000, 5000, 17_000, 60_000, 65_000])
def test_runs_hold_all_voxels_and_few_others(count):
    run = candidates.run_length(count, 1 << 16)
    judged = -(-count // run) * run
    assert count <= judged <= max(1.25 * count, count + candidates.SHORTEST)
    assert run in (1 << 16, 1 << 14, 1 << 12)
