"""The plan of a run on a device: its memory, tiles where that is short, and time, announced beforehand."""

from dataclasses import replace

import pytest

pytest.importorskip("jax")

from oracles.cameras import small_camera

from plenopiv.chain import Chain
from plenopiv.device import plan as device_plan
from plenopiv.device.backend import device_of
from plenopiv.device.plan import frame_of
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.errors import PlenoPIVError
from plenopiv.reconstruction.tiles import cut
from plenopiv.run.plan import plan, plan_between_volumes
from plenopiv.volume import VoxelGrid

CORRELATION = CorrelationSettings(((16, 16, 8),), inner_window=(16, 16, 8))


@pytest.fixture(scope="module")
def chain():
    camera = small_camera("square")
    grid = VoxelGrid.covering((-0.4, 0.4), (-0.6, 0.6), (-0.9, 0.9), (0.03, 0.03, 0.1))
    return Chain((camera,), grid, correlation=CORRELATION, device=device_of("jax-cpu"))


def test_memory_and_time_are_those_of_the_device(chain):
    planned = plan(chain)
    assert planned.tiles == 1
    assert planned.on_device > 8 * chain.grid.size  # two volumes, for the correlation
    assert 0 < planned.takes.frame < 60
    assert 0 < planned.takes.pair < 60
    assert plan(chain.on_device(device_of("cpu"))).on_device == 0
    between = plan_between_volumes(chain)
    assert between.on_device <= planned.on_device


@pytest.mark.full
def test_volumes_are_tiled_to_the_device(chain, monkeypatch):
    """What the compiled programs say is replaced by so many bytes a row: each trial is compiled."""
    monkeypatch.setattr(device_plan, "frame_bytes", lambda p, s, tiles: 1e6 + 1e5 * (tiles[0].high - tiles[0].low))
    projection, settings, rows = chain.projection, chain.reconstruction, chain.lens_grid.shape[1]
    whole = cut(rows, 1, 0)
    tiles, taken = frame_of(projection, settings, chain.device, whole)
    assert (tiles, taken.bytes) == (whole, 1e6 + 1e5 * rows)
    assert taken.seconds > 0
    short = replace(chain.device, memory=0.8 * taken.bytes)
    tiles, less = frame_of(projection, settings, short, whole)
    tallest = max(tile.high - tile.low for tile in tiles)
    assert less.bytes == 1e6 + 1e5 * tallest <= short.memory
    assert less.seconds > taken.seconds  # margins are reconstructed twice
    with pytest.raises(PlenoPIVError, match=r"device_memory_gb: a frame takes"):
        frame_of(projection, settings, replace(short, memory=1e5), whole)


def test_memory_that_suffices_for_no_correlation(chain):
    with pytest.raises(PlenoPIVError, match=r"device_memory_gb: the correlation takes"):
        plan(chain.on_device(replace(chain.device, memory=2e5)))


def test_processes_share_a_device():
    device = device_of("jax-cpu", 8.0)
    assert device.shared_by(4).memory == 2e9
    assert device.shared_by(None) is device
    assert device.shared_by(4).stated == device.stated
