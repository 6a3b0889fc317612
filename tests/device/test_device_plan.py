"""What a correlation takes of a device: memory against the compiled programs, time against what was measured."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jax")

import jax.numpy as jnp
from jax import ShapeDtypeStruct

from plenopiv.device import work
from plenopiv.device.correlation_deformation import _deformed
from plenopiv.device.correlation_memory import batch_bytes, layers_bytes
from plenopiv.device.correlation_offset import _sums
from plenopiv.device.correlation_windows import How, correlated
from plenopiv.device.rates import CARDS, Rates
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
    arguments = planes, planes, whole_numbers(batch, 2), floats(batch, 3, 2), filters, how
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
    """Measured on the processor: shares fitted to the middle of three sizes predict each stage of the others, less than
    half and more than twice as large, and the whole within 30 %."""
    rates = Rates(**MEASURED["rates"], shares=MEASURED["shares"])
    voxels = [int(np.prod(size["shape"])) for size in MEASURED["pairs"]]
    assert voxels[1] > 2 * voxels[0]
    assert voxels[2] > 2 * voxels[1]
    for size in MEASURED["pairs"]:
        counted = work.correlation(tuple(size["shape"]), CorrelationSettings(**MEASURED["settings"]), size["voxels"])
        predicted = rates.seconds(counted)
        for name, stage in size["stages"].items():
            assert 1 / 1.3 < predicted[name] / stage["seconds"] < 1.3, (size["shape"], name)
        assert 1 / 1.3 < sum(predicted.values()) / size["whole_s"] < 1.3


def test_what_takes_longer():
    shape = (100, 300, 400)
    usual = work.correlation(shape, SETTINGS, 1 << 24)
    twice = work.correlation((200, 300, 400), SETTINGS, 1 << 24)
    for name, stage in usual.items():
        assert 1.5 < twice[name].moved / max(stage.moved, 1) < 2.6 or stage.moved == 0, name
    laptop, _, server = (sum(card.seconds(usual).values()) for card in CARDS)
    assert laptop > 3 * server
    assert work.vectors(shape, SETTINGS) > 0
