"""Each kernel against direct sums over weights that plain Python computed voxel by voxel."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light, ray_light

from plenopiv.lightfield import layout
from plenopiv.projection.plenoptic.geometry import Plane, planes
from plenopiv.projection.plenoptic.projector import PlenopticProjector
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid((-0.0761, -0.0483, -2.213), (0.0385, 0.041, 1.03), (5, 2, 3))
NAIVE = {
    "polygons": exact_light,
    "exact": exact_light,
    "9-rays": lambda *a: ray_light(*a, 9),
    "1-ray": lambda *a: ray_light(*a, 1),
}


class Case:
    """A tiny camera, the naive weights (voxel, view, lens) of a tiny grid, and random data for both."""

    def __init__(self, kind, rule):
        self.rule = rule
        camera = small_camera(kind, pmr=8, microlenses=(9, 8), offset_mm=(0.007, -0.004))
        where = layout(camera)
        # views whose pixels the aperture's rim does not cut: the rest is approximated, see test_light_of_a_point
        inner = np.hypot(*(np.abs(where.offsets) + 1.05).T) <= camera.aperture_radius_px
        self.where = replace(where, seen=where.seen & inner[:, None])
        self.views = np.flatnonzero(inner)
        self.projector = PlenopticProjector(self.where, GRID, rule, across=40.0)
        x, y, z = GRID.axes()
        points = [(px, py, pz) for pz in z for py in y for px in x]
        self.weights = np.array([NAIVE[rule](self.where, p) for p in points])
        per_plane = planes(camera, GRID)[:, Plane._fields.index("light")].astype(float)
        self.light = np.repeat(per_plane, GRID.shape[1] * GRID.shape[2])  # of a whole pixel, by voxel
        rng = np.random.default_rng(5)
        self.values = rng.random(GRID.size).astype(np.float32) + np.float32(0.1)
        self.image = rng.normal(size=(where.views, where.lenses)).astype(np.float32)
        self.image[~self.where.seen] = 0

    @property
    def shares(self):
        return self.weights / self.light[:, None, None]

    def volume(self):
        return self.projector.every_voxel().with_values(self.values.copy())

    def close(self, got, want):
        """To rounding. Maps interpolate as well, which next to focus, where light ends sharply, is some hundredths of
        the largest share (voxels of half a microlens); see test_light_of_a_point for real ones."""
        if self.rule != "exact":
            np.testing.assert_allclose(got, want, rtol=0, atol=3e-5 * np.abs(want).max())
        else:
            np.testing.assert_allclose(got, want, rtol=0, atol=0.1 * np.abs(want).max())
            assert np.std(got - want) < 0.05 * np.std(want)


CASES = {}


@pytest.fixture(params=[(k, r) for k in ("square", "hexagonal") for r in NAIVE], ids=lambda p: f"{p[0]}-{p[1]}")
def case(request):
    if request.param not in CASES:
        CASES[request.param] = Case(*request.param)
    return CASES[request.param]


def test_there_is_something_to_compare(case):
    assert case.views.size >= 20
    assert (case.weights.sum((1, 2)) > 0.3).all()  # the inner views hold most of the light of every voxel


def test_forward(case):
    got = np.array([case.projector.forward(v, case.volume()) for v in range(case.projector.views)])
    case.close(got, np.tensordot(case.values.astype(float), case.weights, 1))


def test_gather(case):
    got = sum(case.projector.gather(v, case.image[v], case.volume()).astype(float) for v in case.views)
    case.close(got, np.tensordot(case.shares, case.image.astype(float), 2))


def test_multiply(case):
    volume = case.volume()
    want = case.values.astype(float)
    image = (0.1 if case.rule == "exact" else 1.0) * case.image
    for v in case.views:
        case.projector.multiply(v, image[v], volume)
        want = want * np.maximum(1 + case.shares[:, v] @ image[v].astype(float), 0)
    case.close(volume.values, want)


def test_sparse_volumes_may_leave_rows_and_planes_empty(case):
    mask = np.random.default_rng(7).random(GRID.shape) < 0.3
    mask[1], mask[3, 1] = False, False
    volume = SparseVolume.from_mask(GRID, mask).with_values(case.values[mask.ravel()])
    got = np.array([case.projector.forward(v, volume) for v in range(case.projector.views)])
    case.close(got, np.tensordot(case.values[mask.ravel()].astype(float), case.weights[mask.ravel()], 1))
