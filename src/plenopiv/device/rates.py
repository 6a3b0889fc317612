"""How fast a device does its work: seconds of ``work``, from its memory's bandwidth and its rate of operations.

A stage takes as long as the slower of the two, divided by the share of it that the stage reaches. Shares of this
processor were fitted to one size (benchmarks/speed/device.py). Those of graphics processors are assumptions until they
are measured: half of the bandwidth or rate where whole arrays stream through, or reads from a cache are counted as
operations, a quarter where data decide what is read.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from plenopiv.device.backend import Device
from plenopiv.device.work import Work

USUAL = 0.5  # share of bandwidth and rate
ASSUMED = {"deformation": 0.25, "offset": 0.25, "images": 0.5, "back": 0.5, "candidates": 0.25}
FITTED = {  # the caches of this processor hold a batch, and a map
    "deformation": 0.34,
    "windows": 1.8,
    "last windows": 1.6,
    "offset": 2.8,
    "images": 1.1,
    "back": 0.47,
    "candidates": 0.45,
}


@dataclass(frozen=True)
class Rates:
    """``bandwidth`` of the memory, B/s; ``operations`` a second, float32; ``link``: B/s from this machine's memory;
    ``call_s``: to start a program; ``shares``: reached by stage. ``memory``: bytes."""

    name: str
    memory: float
    bandwidth: float
    operations: float
    link: float
    call_s: float = 2e-5
    shares: Mapping[str, float] = field(default_factory=lambda: ASSUMED)

    def seconds(self, stages: Mapping[str, Work]) -> dict[str, float]:
        """Of each stage."""
        return {name: self.of_stage(name, work) for name, work in stages.items()}

    def of_stage(self, name: str, work: Work) -> float:
        """Of one."""
        least = max(work.moved / self.bandwidth, work.operations / self.operations)
        return least / self.shares.get(name, USUAL) + work.calls * self.call_s


# As their makers state them; laptops at a sustained 100 W.
CARDS = (
    Rates("laptop (GeForce RTX 4070 Laptop, 8 GB)", 8e9, 256e9, 15e12, 12e9),
    Rates("workstation (GeForce RTX 4090, 24 GB)", 24e9, 1008e9, 82e12, 25e9),
    Rates("H100 SXM, 80 GB", 80e9, 3350e9, 67e12, 50e9),
)


def bare(device: Device) -> Rates:
    """What the device in use does at its best: copies, products, sends from this machine's memory, starts a program.
    Tried once in a process, in a second or two, however much of its memory may be taken."""
    return replace(_tried(device.kind, device.name), memory=device.memory or 0.0)


@cache
def _tried(kind: str, name: str) -> Rates:
    import jax
    import jax.numpy as jnp
    import numpy as np

    here = kind == "jax-cpu"
    copied, few = (jnp.zeros(1 << bits, jnp.float32) for bits in ((24, 18) if here else (26, 22)))
    sent = np.zeros(1 << 22, np.float32)
    rounds = 64  # of a product and a sum, each four times
    steps = jax.jit(lambda a: jax.lax.fori_loop(0, rounds, lambda _, v: _four(v), a))
    return Rates(
        name,
        memory=0.0,
        bandwidth=8.0 * copied.size / best(jax.jit(lambda a: a + 1.0), copied),
        operations=8.0 * rounds * few.size / best(steps, few),
        link=sent.nbytes / best(lambda: jax.device_put(sent, may_alias=False)),
        call_s=best(jax.jit(lambda a: a + 1.0), jnp.zeros(8)),
        shares=FITTED if here else ASSUMED,
    )


def _four(values: Any) -> Any:
    for _ in range(4):
        values = values * 1.0001 + 0.5
    return values


def best(function: Callable[..., Any], *arguments: Any, times: int = 4) -> float:
    """Least seconds of several runs until the device has done it; the first, which may compile, does not count. Of this
    processor, which others may use too, the time of its cores over their number."""
    import jax

    device = jax.config.jax_default_device
    here, seconds = device.platform == "cpu", []
    clock = time.process_time if here else time.perf_counter
    for _ in range(times + 1):
        begin = clock()
        jax.block_until_ready(function(*arguments))
        seconds.append((clock() - begin) / ((os.cpu_count() or 1) if here else 1))
    return max(min(seconds[1:]), 1e-9)
