"""What a correlation takes of a device: memory against the compiled programs, time against what was measured."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jax")

import jax.numpy as jnp
from jax import ShapeDtypeStruct

from plenopiv.device import work
from plenopiv.device.candidates import VIEWS
from plenopiv.device.correlation_deformation import _deformed
from plenopiv.device.correlation_memory import batch_bytes, layers_bytes
from plenopiv.device.correlation_offset import _sums
from plenopiv.device.correlation_windows import How, correlated
from plenopiv.device.plane_tables import Bucket
from plenopiv.device.planes import map_units
from plenopiv.device.rates import CARDS, Rates
from plenopiv.device.voxel_tables import Asking
from plenopiv.device.work_of_frames import LEFT, TAP, groups_of, judged_voxels, map_work, reconstruction
from plenopiv.displacement.settings import CorrelationSettings
from plenopiv.displacement.window_pass import WindowPass
from plenopiv.displacement.windows import window_grid

SPEED = Path(__file__).parents[2] / "benchmarks" / "speed"
MEASURED = json.loads((SPEED / "device-jax-cpu.json").read_text())
WINDOW = (40, 36, 20)  # x, y, z
SETTINGS = CorrelationSettings((WINDOW,), inner_window=WINDOW)


def floats(*shape):
    return ShapeDtypeStruct(shape, jnp.float32)


def whole_numbers(*shape):
    return ShapeDtypeStruct(shape, jnp.int32)


def temporary(program, *arguments):
    return program.lower(*arguments).compile().memory_analysis().temp_size_in_bytes


def test_batches_take_no_more_than_is_planned():
    shape, batch = (40, 80, 90), 4
    windows = WindowPass(window_grid(shape, WINDOW, 0.5), None, SETTINGS, 0.25, shape)
    how, planes = How.of(windows, scatter=True), floats(20, 80, 90)
    filters = tuple(map(floats, how.around))
    about = whole_numbers(batch, 2), floats(batch, 3, 2), floats(batch, WINDOW[2]), filters, floats(3, 34)
    arguments = planes, planes, *about, how
    planned = batch_bytes(batch * int(np.prod(how.around)))
    assert 0.3 * planned < temporary(correlated, *arguments) < planned
    slab, places = floats(30, 80, 90), whole_numbers(batch, 3)
    assert temporary(_sums, slab, slab, places, places, how.size) < planned


def test_planes_take_no_more_than_is_planned():
    ny, nx, depth, step, source = 80, 90, 20, 10, 26
    taps = [(whole_numbers(n), floats(n, 4)) for n in (step, ny, nx)]
    first = floats(depth, ny, nx), floats(source, ny, nx), whole_numbers()
    arguments = *first, *taps[0], floats(3, 8, 9, 10), *taps[1], *taps[2], floats()
    held = 4.0 * ny * nx * (2 * depth + source)
    planned = layers_bytes((60, ny, nx), SETTINGS)
    assert 0.5 * planned < held + temporary(_deformed, *arguments) < planned


def test_one_size_tells_the_times_of_others():
    """Measured on the processor: shares fitted to the second of four sizes predict each stage of the others, less than
    half to nearly four times as large, and the whole within 30 %."""
    rates = Rates(**MEASURED["rates"], shares=MEASURED["shares"])
    voxels = [int(np.prod(size["shape"])) for size in MEASURED["pairs"]]
    assert voxels[1] > 2 * voxels[0]
    assert voxels[3] > 3.5 * voxels[1]
    for size in MEASURED["pairs"]:
        counted = work.correlation(tuple(size["shape"]), CorrelationSettings(**MEASURED["settings"]), size["voxels"])
        predicted = rates.seconds(counted)
        for name, stage in size["stages"].items():
            assert 1 / 1.3 < predicted[name] / stage["seconds"] < 1.3, (size["shape"], name)
        assert 1 / 1.3 < sum(predicted.values()) / size["whole_s"] < 1.3


def test_one_frame_tells_the_times_of_others():
    """The same of one group of views, forward and back, and of dense ray tracing."""
    rates = Rates(**MEASURED["rates"], shares=MEASURED["shares"])
    assert len(MEASURED["frames"]) == 4
    for size in MEASURED["frames"]:
        for name, stage in size["stages"].items():
            counted = work.Work(stage["moved"], stage["operations"], stage["calls"])
            assert 1 / 1.3 < rates.of_stage(name, counted) / stage["seconds"] < 1.3, (size["shape"], name)


def test_what_a_frame_takes_follows_its_planes_and_views():
    """Of a bucket of one plane, counted by hand: copied with its borders, read and written for each of four phases; and
    of two planes that share a map, to which four places in each of them add."""
    bucket = Bucket(planes=1, members=1, points=2, voxels=1, taps=(3, 4))
    units = (10 + 2) * (20 + 3)
    assert map_units(bucket, (10, 20)) == (12, 23)
    spread = map_work(bucket, (10, 20))
    assert spread.moved == 4 * (2 * 200 + 4 * (200 + units))
    assert spread.operations == TAP * 4 * 12 * units
    shared = Bucket(planes=1, members=2, points=1, voxels=2, taps=(3, 4))
    units = (5 + 2) * (10 + 3)
    assert map_work(shared, (10, 20)).moved == 4 * (4 * 200 + 2 * 200 + 8 * 2 * units)
    assert map_work(shared, (10, 20)).operations == TAP * 8 * 12 * units
    asking = Asking(planes=1, window=(2, 3))
    one = reconstruction((10, 20), [bucket], [asking], 50, [8], [(1, 6)], 7)
    twice = reconstruction((10, 20), [bucket, bucket], [asking, asking], 50, [8], [(2, 6)], 7)
    more = reconstruction((10, 20), [bucket], [asking], 50, [8, 8], [(1, 6)], 14)
    for name, stage in one.items():
        assert twice[name].moved == pytest.approx(2 * stage.moved)
        if name != "candidates":
            assert more[name].operations == pytest.approx(2 * stage.operations)
    assert groups_of([(0.5, 4), (0.25, 8)], 10) == [4, 4, 2, 8, 2]


def test_dense_ray_tracing_judges_what_is_left():
    """The first views all voxels, of a plane that fills most of a run; each others what is left, a run at the least."""
    assert judged_voxels(60_480, 1) == VIEWS * 60_480
    left = LEFT * 60_480 + 4096 / 2
    assert judged_voxels(60_480, 13) == pytest.approx(VIEWS * (60_480 + 12 * left))
    assert judged_voxels(14_560, 12) == VIEWS * (14_560 + 11 * 4096)
    # counted in recordings of 1 particle per microlens, mean of the planes of all depths
    assert judged_voxels(60_480, 13) == pytest.approx(140.6e6 / 128, rel=0.1)
    assert judged_voxels(24_480, 12) == pytest.approx(74.8e6 / 80, rel=0.1)


def test_what_takes_longer():
    shape = (100, 300, 400)
    usual = work.correlation(shape, SETTINGS, 1 << 24)
    twice = work.correlation((200, 300, 400), SETTINGS, 1 << 24)
    for name, stage in usual.items():
        assert 1.5 < twice[name].moved / max(stage.moved, 1) < 2.6 or stage.moved == 0, name
    laptop, _, server = (sum(card.seconds(usual).values()) for card in CARDS)
    assert laptop > 3 * server
    assert work.vectors(shape, SETTINGS) > 0
