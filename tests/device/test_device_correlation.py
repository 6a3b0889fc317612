"""Correlation on the device, run on the processor: part by part against the host's, and whole fields."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from oracles.particle_volumes import particle_pair

pytest.importorskip("jax")  # optional for users, a development requirement here

import jax.numpy as jnp

from plenopiv.device import correlation
from plenopiv.device.correlation_agreement import agreement as agreement_on_device
from plenopiv.device.correlation_deformation import Deformed, Planes
from plenopiv.device.correlation_memory import room
from plenopiv.device.correlation_windows import block_sums, of_block
from plenopiv.displacement.agreement import agreement
from plenopiv.displacement.deformation import DeformedPlanes
from plenopiv.displacement.depth_weights import DepthWeights
from plenopiv.displacement.multigrid import OnePair, measure
from plenopiv.displacement.predictor import fit_spline
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid
from plenopiv.displacement.windows import window_grid
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import DenseVolume, SparseVolume, VoxelGrid

SHAPE = (36, 52, 60)
SETTINGS = CorrelationSettings(windows=((24, 24, 16), (20, 20, 14)), inner_window=(20, 20, 14), search=0.3)


def swirl(p):
    """Up to 3 voxels along each axis, curved, across faces."""
    x, y, z = ((p[:, k] - c) / 30 for k, c in enumerate((30, 26, 18)))
    return np.stack([1.3 + 1.2 * y - 0.5 * z, -0.8 - 1.5 * x, 0.7 * np.sin(2 * x) + 0.6 * y], -1)


@pytest.fixture(scope="module")
def pair():
    return particle_pair(SHAPE, swirl, 0.002, (1.0, 1.0, 1.4), lost=0.1, ghosts=0.2)


@pytest.fixture(scope="module")
def predictor():
    windows = window_grid(SHAPE, (24, 24, 16), 0.5)
    z, y, x = np.meshgrid(*windows.centres, indexing="ij")
    at = swirl(np.stack([x.ravel(), y.ravel(), z.ravel()], -1)).T.reshape(3, *z.shape)
    return fit_spline(at, windows.centres, SHAPE)


def sparse(volume):
    return SparseVolume.from_mask(volume.grid, volume.values > 1e-3).with_values(volume.values[volume.values > 1e-3])


DEPTH = DepthWeights(
    np.random.default_rng(2).uniform(0.01, 1.0, (SHAPE[0], 3, 2)).astype(np.float32),
    np.array([0.0, 20.0, 51.0]),
    np.array([5.0, 40.0]),
)


def compare(one, other, vectors=0.005, different=0):
    """RMS by component, and how many valid flags differ."""
    np.testing.assert_array_equal(one.z, other.z)
    assert (one.valid != other.valid).sum() <= different
    both = one.valid & other.valid
    for name in ("displacement", "raw"):
        apart = (getattr(other, name) - getattr(one, name))[:, both]
        assert (np.sqrt((apart**2).mean(1)) < vectors).all(), name
    np.testing.assert_allclose(other.std[:, both], one.std[:, both], rtol=0.02, atol=1e-4)
    np.testing.assert_allclose(other.peak_ratio[both], one.peak_ratio[both], rtol=1e-3)


@pytest.mark.parametrize("resident", [True, False])
@pytest.mark.parametrize("share", [-0.5, 0.5])
def test_planes_are_deformed_as_on_the_host(pair, predictor, share, resident):
    """Layers of windows that overlap, the first and last at the volume's faces; displacements reach beyond them."""
    volume = sparse(pair[0])
    host, device = DeformedPlanes(volume, predictor, share), Deformed(Planes(volume, resident), predictor, share, 14, 6)
    for start in range(1, 36 - 13, 6):
        np.testing.assert_allclose(device.layer(start), host.slab(start, start + 14), atol=2e-6 * volume.values.max())


def test_planes_without_a_predictor_are_those_of_the_volume(pair):
    volume = sparse(pair[0])
    for depth, step, starts in ((8, 8, (0, 8, 16)), (9, 4, (3, 7, 11, 15, 19, 23, 27))):
        device = Deformed(Planes(volume, resident=False), None, 0.5, depth, step)
        for start in starts:
            np.testing.assert_array_equal(device.layer(start), volume.slab(start, start + depth))


@pytest.mark.full
def test_weights_by_agreement(pair):
    windows = [np.stack([volume.values[k : k + 13, 5:24, 7:29] for k in (0, 9)]) for volume in pair]
    found = agreement_on_device(*map(jnp.asarray, windows))
    np.testing.assert_allclose(found, agreement(*windows), atol=2e-6)


@pytest.mark.full
def test_sums_of_blocks_are_those_of_the_windows():
    """Against plain loops: products of two windows, one moved around its ends, by block."""
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 1, 6, 8, 10)).astype(np.float32)

    class How:
        around, blocks = (6, 8, 10), (2, 2, 3)

    place = np.array([[3, -2, 1]])
    transforms = (jnp.fft.rfftn(jnp.asarray(v), axes=(1, 2, 3)) for v in (a, b))
    found = np.asarray(block_sums(*transforms, jnp.asarray(place), How))[0].reshape(2, 2, 3, 7)
    moved = np.roll(b[0], (-1, 2, -3), (0, 1, 2))
    steps = [(0, 0), (2, -1), (2, 1), (1, -1), (1, 1), (0, -1), (0, 1)]
    blocks = [of_block(n, count) for n, count in zip((6, 8, 10), (2, 2, 3), strict=True)]
    for n, (axis, side) in enumerate(steps):
        one, two = (np.roll(a[0], -1, axis) if side < 0 else a[0]), (np.roll(moved, -1, axis) if side > 0 else moved)
        if n == 0:
            one, two = a[0], moved
        expected = np.einsum("zyx,za,yb,xc->abc", one * two, *blocks)
        np.testing.assert_allclose(found[..., n], expected, atol=2e-5)


def test_windows_of_the_first_pass_are_offset_as_on_the_host(pair, predictor):
    windows = window_grid(SHAPE, (24, 24, 16), 0.5)
    first = predictor.at(*windows.centres) + np.random.default_rng(1).uniform(-1.5, 1.5, (3, *windows.shape))
    first[2, 0] = 9.0  # does not fit
    host, found = OnePair(*pair, DEPTH).offset(windows, first)
    device, found_too = correlation.DevicePair(*pair, DEPTH, room(SHAPE, SETTINGS, None)).offset(windows, first)
    assert 0.2 < found.mean() < 1
    assert (found != found_too).sum() <= 1
    both = found & found_too
    np.testing.assert_allclose(device[:, both], host[:, both], atol=2e-4)


@pytest.mark.parametrize("depth", [None, DEPTH], ids=["", "weighted by depth"])
def test_a_field_is_the_hosts(pair, depth):
    compare(measure(*pair, SETTINGS, depth=depth), correlation.measure(*pair, SETTINGS, depth=depth), different=1)


@pytest.mark.full
@pytest.mark.parametrize(
    "settings",
    [
        {"agreement": 2.0, "whitening": 0.3, "taper_voxels": 0.0, "intensity_exponent": 1.0, "fine_passes": 2},
        {"whitening": 0.0, "overlap": 0.2, "fine_passes": 1, "smoothing_voxels": 0.0},
    ],
)
def test_settings_and_odd_windows(pair, settings):
    settings = CorrelationSettings(((22, 21, 15),), inner_window=(22, 21, 15), **settings)
    compare(measure(*pair, settings), correlation.measure(*pair, settings), different=1)


def test_two_runs_and_planes_sent_one_after_the_other_give_the_same_bits(pair):
    volumes, whole = [sparse(volume) for volume in pair], room(SHAPE, SETTINGS, None)
    assert whole.resident
    fields = []
    for plan in (whole, whole, replace(whole, resident=False)):
        fields.append(measure(*volumes, SETTINGS, pairs=partial(correlation.DevicePair, plan=plan)))
    for field in fields[1:]:
        for name in ("displacement", "raw", "valid", "peak_ratio", "std"):
            np.testing.assert_array_equal(getattr(field, name), getattr(fields[0], name))


def test_memory_takes_smaller_batches_first_then_planes_for_volumes():
    shape, settings = (240, 600, 800), CorrelationSettings()
    plans = [room(shape, settings, memory, voxels=1 << 24) for memory in (None, 2.0e9, 0.8e9)]
    assert [plan.resident for plan in plans] == [True, True, False]
    assert plans[0].voxels > plans[1].voxels >= 1 << 18
    for plan, memory in zip(plans[1:], (2.0e9, 0.8e9), strict=True):
        assert plan.needed <= memory


def test_too_little_memory_is_said_at_once(pair):
    with pytest.raises(PlenoPIVError, match=r'device_memory_gb.*compute.device = "cpu"'):
        correlation.measure(*pair, SETTINGS, memory=1e5)


def test_uniform_windows_and_bodies(pair):
    """Half of the volume is dark, and a body fills a corner."""
    dark = [
        replace(volume, values=np.where(np.arange(60) < 26, volume.values, 0.0).astype(np.float32)) for volume in pair
    ]
    inside = np.zeros((9, 13, 15), bool)
    inside[:5, :6, :6] = True
    solid = Solid(inside, (4, 4, 4))
    one, other = measure(*dark, SETTINGS, solid=solid), correlation.measure(*dark, SETTINGS, solid=solid)
    np.testing.assert_array_equal(one.solid, other.solid)
    assert one.solid.any()
    assert not one.valid.all()
    np.testing.assert_array_equal(one.valid, other.valid)
    np.testing.assert_allclose(other.displacement, one.displacement, atol=0.005)


def test_grids_that_differ_are_refused(pair):
    other = DenseVolume(VoxelGrid((1.0, 0.0, 0.0), (1.0,) * 3, SHAPE), pair[1].values)
    with pytest.raises(PlenoPIVError, match="differ in grid"):
        correlation.measure(pair[0], other, SETTINGS)
