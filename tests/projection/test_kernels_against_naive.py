"""Each kernel against direct sums over weights that plain Python computed voxel by voxel."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.cameras import small_camera
from oracles.naive_projection import exact_light, ray_light

from plenopiv.lightfield import layout
from plenopiv.projection.geometry import Plane, planes
from plenopiv.projection.planes import DensePlanes
from plenopiv.projection.projector import Projector
from plenopiv.volume import SparseVolume, VoxelGrid

pytestmark = pytest.mark.usefixtures("one_thread")

GRID = VoxelGrid((-0.0761, -0.0483, -2.213), (0.0385, 0.041, 1.03), (5, 2, 3))
NAIVE = {"exact": exact_light, "9-rays": lambda *a: ray_light(*a, 9), "1-ray": lambda *a: ray_light(*a, 1)}


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
        self.projector = Projector(self.where, GRID, rule)
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

    def sparse(self, values=None):
        return self.projector.every_voxel().with_values(self.values if values is None else values)

    def dense(self, values=None):
        return DensePlanes.of(self.sparse(values))


CASES = {}


@pytest.fixture(params=[(k, r) for k in ("square", "hexagonal") for r in NAIVE], ids=lambda p: f"{p[0]}-{p[1]}")
def case(request):
    if request.param not in CASES:
        CASES[request.param] = Case(*request.param)
    return CASES[request.param]


def close(got, want, form="sparse"):
    """To rounding. Dense planes round a voxel's place to 1/64 of it as well, which next to focus, where light ends
    sharply, is a tenth of a share here (voxels of a whole microlens); see test_light_of_a_point for real ones."""
    if form == "sparse":
        np.testing.assert_allclose(got, want, rtol=0, atol=3e-5 * np.abs(want).max())
    else:
        np.testing.assert_allclose(got, want, rtol=0, atol=0.1 * np.abs(want).max())
        assert np.std(got - want) < 0.05 * np.std(want)


def skip_rays(case, form):
    if form == "dense" and case.rule != "exact":
        pytest.skip("dense planes are projected by exact areas alone")


def test_there_is_something_to_compare(case):
    assert case.views.size >= 20
    assert (case.weights.sum((1, 2)) > 0.3).all()  # the inner views hold most of the light of every voxel


@pytest.mark.parametrize("form", ["sparse", "dense"])
def test_forward(case, form):
    skip_rays(case, form)
    volume = getattr(case, form)()
    got = np.array([case.projector.forward(v, volume) for v in range(case.projector.views)])
    close(got, np.tensordot(case.values.astype(float), case.weights, 1), form)


def test_sparse_gather(case):
    got = sum(case.projector.gather(v, case.image[v], case.sparse()).astype(float) for v in case.views)
    close(got, np.tensordot(case.shares, case.image.astype(float), 2))


def test_dense_adjoint(case):
    skip_rays(case, "dense")
    out = DensePlanes.empty(GRID)
    for v in case.views:
        case.projector.adjoint(v, case.image[v], out)
    close(out.inside.ravel(), np.tensordot(case.weights, case.image.astype(float), 2), "dense")
    assert not out.values[:, :, GRID.shape[2] :].any()


def test_dense_planes_are_refused_where_rays_are_asked_for(case):
    if case.rule == "exact":
        pytest.skip("exact areas")
    with pytest.raises(ValueError, match="exact areas alone"):
        case.projector.forward(0, case.dense())


@pytest.mark.parametrize("form", ["sparse", "dense"])
def test_multiply(case, form):
    skip_rays(case, form)
    volume = getattr(case, form)(case.values.copy())
    want = case.values.astype(float)
    image = (1.0 if form == "sparse" else 0.1) * case.image
    for v in case.views:
        case.projector.multiply(v, image[v], volume)
        want = want * np.maximum(1 + case.shares[:, v] @ image[v].astype(float), 0)
    close(volume.values if form == "sparse" else volume.inside.ravel(), want, form)


def test_sparse_volumes_may_leave_rows_and_planes_empty(case):
    mask = np.random.default_rng(7).random(GRID.shape) < 0.3
    mask[1], mask[3, 1] = False, False
    volume = SparseVolume.from_mask(GRID, mask).with_values(case.values[mask.ravel()])
    got = np.array([case.projector.forward(v, volume) for v in range(case.projector.views)])
    close(got, np.tensordot(case.values[mask.ravel()].astype(float), case.weights[mask.ravel()], 1))
