"""Times told before a run: the machine's present speed, and kernels that are not compiled yet."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from plenopiv.cameras.presets import preset
from plenopiv.chain import Chain
from plenopiv.run import present
from plenopiv.run.duration import TimeEstimate
from plenopiv.run.plan import Plan, plan, plan_between_volumes
from plenopiv.volume import VoxelGrid

GRID = VoxelGrid.covering((-0.5, 0.5), (-0.5, 0.5), (-1.0, 1.0), (0.02, 0.02, 0.1))
NOMINAL = TimeEstimate(10.0, 4.0, 8.0)


@pytest.fixture
def planned():
    return replace(plan(Chain((preset("pmr14"),), GRID)), takes=NOMINAL)


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """No kernels are kept, and nothing was measured."""
    monkeypatch.setattr(present, "folder", lambda: tmp_path / "kernels")
    monkeypatch.setattr(present, "_measured", {})
    monkeypatch.setattr(present, "compile_seconds", lambda: 0.0)
    monkeypatch.setattr(present, "_rate", lambda threads: 2.0 * present.REFERENCE)
    return tmp_path


def test_a_fast_machine_takes_less_and_compiles_once(fresh, planned):
    first = present.as_it_is_now(planned).takes
    assert (first.frame, first.pair, first.start, first.speed) == (5.0, 2.0, 4.0, 2.0)
    assert first.compiling == present.COMPILING_S / 2
    assert first.run(2, 1) == pytest.approx(4.0 + 10.0 + 2.0 + first.compiling)
    assert f"{first.compiling:.0f} s of it to compile kernels, once on this machine" in first.words(2, 1)
    assert "this machine has now 200 % of the speed of that in docs/speed.md" in first.words(2, 1)
    present.remember(planned)
    assert present.as_it_is_now(planned).takes.compiling == 0.0
    assert "compile" not in present.as_it_is_now(planned).takes.words(2, 1)


def test_what_is_compiled_is_not_counted_again(fresh, planned, monkeypatch):
    whole = present.as_it_is_now(planned).takes.compiling
    monkeypatch.setattr(present, "compile_seconds", lambda: 3.0)
    assert present.as_it_is_now(planned).takes.compiling == whole - 3.0
    monkeypatch.setattr(present, "compile_seconds", lambda: 300.0)
    assert present.as_it_is_now(planned).takes.compiling == 0.0


def test_a_mark_is_of_its_kind_of_run_and_of_the_sources(fresh, planned, monkeypatch):
    present.remember(planned)
    other = replace(
        planned, chain=replace(planned.chain, reconstruction=replace(planned.chain.reconstruction, method="mart"))
    )
    assert present.as_it_is_now(other).takes.compiling > 0
    between = plan_between_volumes(planned.chain)
    assert 0 < present.as_it_is_now(between).takes.compiling < present.as_it_is_now(other).takes.compiling
    monkeypatch.setattr(present, "_of_sources", lambda: "edited")
    assert present.as_it_is_now(planned).takes.compiling > 0


def test_an_old_mark_counts_no_more(fresh, planned, monkeypatch):
    present.remember(planned)
    monkeypatch.setattr(present, "KEPT_DAYS", -1.0)
    assert present.as_it_is_now(planned).takes.compiling > 0


def test_where_no_mark_can_be_left_nothing_fails(fresh, planned):
    (fresh / "kernels").write_text("a file where a folder should be")
    present.remember(planned)
    assert present.as_it_is_now(planned).takes.compiling > 0


def test_a_device_s_times_are_its_own(fresh, planned):
    device = replace(planned.chain.device, kind="gpu")
    on_device = Plan(replace(planned.chain, device=device), planned.needed, NOMINAL)
    assert present.as_it_is_now(on_device) is on_device
    present.remember(on_device)
    assert not (fresh / "kernels").exists()


def test_left_is_told_without_the_compilation_in_the_first_frame():
    takes = NOMINAL.at_speed(1.0, compiling=20.0)
    assert takes.left(2, 10.0, 1) == pytest.approx(10.0 + 4.0 + 20.0)
    assert takes.left(2, 10.0, 1, compiled=15.0) == pytest.approx(10.0 + 4.0 + 5.0)
    assert takes.left(2, 10.0, 1, compiled=40.0) == pytest.approx(14.0)


def test_the_probe_is_short_measured_once_and_sees_a_busy_machine(monkeypatch):
    monkeypatch.setattr(present, "_measured", {})
    calls = []
    rate = present._rate
    monkeypatch.setattr(present, "_rate", lambda threads: calls.append(threads) or rate(threads))
    alone = present.present_speed(1)
    assert present.present_speed(1) == alone > 0
    assert calls == [1]

    stop = threading.Event()
    numbers = np.linspace(0.5, 1.5, present.NUMBERS, dtype=np.float32)

    def busy():
        out = np.empty_like(numbers)
        while not stop.is_set():
            np.sqrt(numbers, out=out)

    others = [threading.Thread(target=busy) for _ in range(12)]
    for other in others:
        other.start()
    try:
        crowded = rate(2)
    finally:
        stop.set()
        for other in others:
            other.join()
    assert crowded < 0.8 * max(rate(2) for _ in range(3))
