"""<A x, y> = <x, A' y> for random cameras and grids: forward and back share every weight."""

from math import pi

import numpy as np
import pytest
from oracles.cameras import small_camera

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.geometry import Plane, planes
from plenopiv.projection.plenoptic.projector import RULES, PlenopticProjector
from plenopiv.volume import VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")


def random_setting(seed):
    rng = np.random.default_rng(seed)
    pmr = rng.uniform(6, 16)
    camera = small_camera(
        ("square", "hexagonal")[seed % 2],
        pmr=pmr,
        microlenses=(5, 4),
        magnification=rng.uniform(-1.5, -0.4),
        rotation_rad=rng.uniform(-pi, pi) if seed % 3 else rng.uniform(-0.02, 0.02),
        offset_mm=tuple(rng.uniform(-0.05, 0.05, 2)),
        aperture=rng.uniform(0.8, 1.1),
    )
    # around the field of view, planes on both sides of focus or on one
    field = camera.lattice.pitch_mm / abs(camera.main_lens.magnification)
    shape = tuple(rng.integers([2, 3, 3], [6, 9, 20]))
    voxel = (*rng.uniform(0.2, 0.9, 2) * field, rng.uniform(0.05, 1.5))
    middle = rng.uniform([-1, -1, -4], [1, 1, 4]) * [field, field, 1]
    first = tuple(float(c - 0.5 * (n - 1) * d) for c, n, d in zip(middle, shape[::-1], voxel, strict=True))
    grid = VoxelGrid(first, tuple(map(float, voxel)), tuple(map(int, shape)))
    return rng, camera, grid, list(RULES)[seed // 2 % len(RULES)]


@pytest.mark.parametrize("first", [0, 20, *(pytest.param(n, marks=pytest.mark.full) for n in (40, 60, 80))])
def test_forward_and_back_are_transposes(first):
    met = 0
    for seed in range(first, first + 20):
        rng, camera, grid, rule = random_setting(seed)
        where = layout(camera)
        projector = PlenopticProjector(where, grid, rule)
        view = int(rng.integers(projector.views))
        x = rng.random(grid.shape).astype(np.float32)
        y = rng.normal(size=where.lenses).astype(np.float32)
        y[~where.seen[view]] = 0.0
        listed = projector.every_voxel().with_values(x.ravel())
        per_plane = planes(camera, grid)[:, Plane._fields.index("light")].astype(float)

        ax = projector.forward(view, listed).astype(float)
        back = projector.gather(view, y, listed).astype(float).reshape(grid.shape) * per_plane[:, None, None]
        sizes = np.linalg.norm(ax) * np.linalg.norm(y)
        assert abs(ax @ y - (x * back).sum()) <= 1e-6 * sizes, (seed, rule)

        met += sizes > 0
    assert met >= 15  # the identity holds of something
