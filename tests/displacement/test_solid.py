"""Windows in a solid body: not measured, and no other vector depends on what the volumes hold there."""

import numpy as np
import pytest

from plenopiv.displacement import ensemble
from plenopiv.displacement.multigrid import measure
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.solid import Solid, block_of, vectors_in
from plenopiv.displacement.windows import window_grid
from plenopiv.volume import DenseVolume

SHAPE = (48, 64, 80)  # z, y, x
SETTINGS = CorrelationSettings(windows=((32, 32, 24), (24, 24, 16)), inner_window=(16, 16, 12), fine_passes=1)
SHIFT = (1.5, -1.0, 0.75)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("block", [(1, 1, 1), (2, 3, 4)])
def test_shares_are_counted_voxels(axis, block):
    """Against every voxel of every window, blocks unfolded into voxels; a body at the low end of one axis."""
    blocks = [-(-n // b) for n, b in zip(SHAPE, block, strict=True)]
    inside = np.random.default_rng(axis).random(blocks) < 0.2
    inside[tuple(slice(0, -(-14 // block[k])) if k == axis else slice(None) for k in range(3))] = True
    windows = window_grid(SHAPE, (24, 16, 12), 0.5)
    voxels = inside
    for k, b in enumerate(block):
        voxels = np.repeat(voxels, b, k)
    share = Solid(inside, block).share(windows)
    for place in np.ndindex(share.shape):
        cut = [slice(s[p], s[p] + n) for s, p, n in zip(windows.starts, place, windows.size, strict=True)]
        assert share[place] == pytest.approx(voxels[tuple(cut)].mean())
    first = share.take(0, axis).mean()
    assert first > share.take(-1, axis).mean() + 0.2


def test_larger_windows_need_the_room_of_half_a_last_one():
    inside = np.zeros((32, 32, 32), bool)
    inside[:, :, :20] = True  # 0.625 of a large window, 0.25 and 1 of small ones
    solid, last = Solid(inside, (1, 1, 1)), (16, 16, 16)
    assert not solid.filled(window_grid((32, 32, 32), (32, 32, 32), 0.0), last).any()
    assert solid.filled(window_grid((32, 32, 32), last, 0.0), last)[0, 0].tolist() == [True, False]
    inside[:, :, 20:31] = True
    assert solid.filled(window_grid((32, 32, 32), (32, 32, 32), 0.0), last).all()
    half = np.zeros((16, 16, 16), bool)
    half[:, :8] = True
    assert not Solid(half, (1, 1, 1)).filled(window_grid((16, 16, 16), last, 0.0), last).any()  # not more than half


def test_blocks_are_an_eighth_of_the_smallest_window():
    assert block_of(SETTINGS) == (1, 2, 2)
    assert block_of(CorrelationSettings()) == (1, 6, 6)


@pytest.fixture(scope="module")
def walled(particle_pair, uniform_flow):
    """Particles that move, and beyond x = 44 reflections that stand still."""
    a, b = particle_pair(SHAPE, uniform_flow(SHIFT), 20 / 16**3, seed=4)
    still, _ = particle_pair(SHAPE, uniform_flow((0, 0, 0)), 20 / 16**3, seed=5)
    wall = np.zeros(SHAPE, bool)
    wall[:, :, 44:] = True
    volumes = [DenseVolume(v.grid, np.where(wall, 3 * still.values, v.values)) for v in (a, b)]
    return volumes, Solid(wall, (1, 1, 1))


def test_vectors_in_a_body_are_not_measured_and_others_do_not_see_it(walled):
    volumes, solid = walled
    field = measure(*volumes, SETTINGS, solid=solid)
    windows = window_grid(SHAPE, SETTINGS.windows[-1], SETTINGS.overlap)
    inside = windows.centres[2] > 44
    assert 0 < inside.sum() < inside.size
    np.testing.assert_array_equal(field.solid, np.broadcast_to(inside, field.solid.shape))
    np.testing.assert_array_equal(field.solid, vectors_in(solid, SHAPE, SETTINGS))
    for values in (field.displacement, field.raw, field.std, field.peak_ratio):
        np.testing.assert_array_equal(np.isnan(values), np.broadcast_to(field.solid, values.shape))
    assert not field.valid[field.solid].any()
    error = np.abs(field.displacement - np.reshape(SHIFT, (3, 1, 1, 1)))
    clear = windows.starts[2] + windows.size[2] <= 44
    assert np.nanmax(error[..., clear]) < 0.25
    assert field.valid[..., clear].all()


def test_light_in_windows_of_the_body_changes_no_vector(walled):
    """Whatever the volumes hold where windows of every size lie in the body."""
    volumes, solid = walled
    other = [volume.with_values(volume.values.copy()) for volume in volumes]
    rng = np.random.default_rng(0)
    for volume in other:
        volume.values[:, :, 76:] = 50 * rng.random(volume.values[:, :, 76:].shape)
    settings = CorrelationSettings(windows=((16, 16, 12),), inner_window=(16, 16, 12), fine_passes=1)
    before, after = (measure(*pair, settings, solid=solid) for pair in (volumes, other))
    free = ~before.solid
    np.testing.assert_array_equal(before.displacement[:, free], after.displacement[:, free])
    np.testing.assert_array_equal(before.std[:, free], after.std[:, free])


def test_nor_an_error_bar_of_an_ensemble(walled, monkeypatch):
    """What it does to the brightness of pairs beside."""
    monkeypatch.setattr(ensemble, "brightness", lambda volume: 1.0)
    volumes, solid = walled
    settings = CorrelationSettings(windows=((24, 24, 16), (16, 16, 12)), inner_window=(12, 12, 8), fine_passes=1)
    fields = []
    for seed in (0, 1):
        rng, pairs = np.random.default_rng(seed), []
        for _ in range(3):
            pair = [volume.with_values(volume.values.copy()) for volume in volumes]
            for volume in pair:
                volume.values[:, :, 72:] = 50 * rng.random(volume.values[:, :, 72:].shape)
            pairs.append(tuple(pair))
        fields.append(ensemble.measure_ensemble(pairs, settings, solid=solid))
    free = ~fields[0].solid
    np.testing.assert_array_equal(fields[0].std[:, free], fields[1].std[:, free])


def test_without_a_body_nothing_is_left_out(walled):
    volumes, _ = walled
    assert measure(*volumes, SETTINGS).solid is None
    nothing = Solid(np.zeros(SHAPE, bool), (1, 1, 1))
    with_nothing, plain = measure(*volumes, SETTINGS, solid=nothing), measure(*volumes, SETTINGS)
    np.testing.assert_array_equal(with_nothing.displacement, plain.displacement)
    assert not with_nothing.solid.any()
