"""What this machine, as it is now, makes of an estimated time: its present speed, and kernels that are not compiled.

Speed: each thread multiplies and adds numbers for a quarter of a second, all of them at once, as a run does; so a busy
or a throttled machine shows, and a faster one. One thread alone does it for compilation, which has but one. Measured on
a machine four to seven times as slow as usual, as others used it: 67 and 108 s told, 82 and 99 s taken.

Compilation: a run that ends leaves a mark beside the compiled kernels, named by a hash of the kernels' sources, of the
versions that compile, and of what kind of run it was. Where the mark of a run is missing, it will compile.
"""

from __future__ import annotations

import contextlib
import hashlib
import platform
import threading
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numba
import numpy as np

import plenopiv
from plenopiv.chain import Chain
from plenopiv.kernels import compile_seconds
from plenopiv.kernels.store import DAY_S, KEPT_DAYS, folder
from plenopiv.run.plan import Plan
from plenopiv.run.versions import versions

PROBE_S = 0.25  # twice where kernels have to be compiled; .08 s found .4 to .75 where .25 find .62 to .70
VALID_S = 60.0  # a measured speed is not measured again
NUMBERS = 1 << 17  # of an array: three of them fit the second-level cache
REFERENCE = 14000.0  # rounds a second of a thread where the constants of ``duration`` hold; from runs beside them
COMPILING_S = 19.0  # of a run's kernels, there
COMPILING_CORRELATION_S = 12.0  # of those between volumes alone
ENDING = ".ran"
MARK_OF = b"plenopiv.kernels"  # in the text of a module that has kernels

_measured: dict[int, tuple[float, float]] = {}  # threads -> when, rounds a second


def as_it_is_now(planned: Plan) -> Plan:
    """The same plan with the time that it will take on this machine now; on a graphics processor as it was."""
    if planned.chain.device.kind != "cpu":
        return planned
    speed = present_speed(numba.get_num_threads())
    compiling = 0.0
    if not _mark(planned).exists() or _age_s(_mark(planned)) > KEPT_DAYS * DAY_S:
        nominal = COMPILING_S if planned.reconstructs else COMPILING_CORRELATION_S
        compiling = max(nominal / present_speed(1) - compile_seconds(), 0.0)
    return replace(planned, takes=planned.takes.at_speed(speed, compiling))


def remember(planned: Plan) -> None:
    """Leave the mark of a run that has ended: all of its kernels are compiled."""
    if planned.chain.device.kind == "cpu":
        with contextlib.suppress(OSError):  # without it the next run's estimate is too long
            mark = _mark(planned)
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()


def present_speed(threads: int) -> float:
    """Speed of each of so many threads at once, 1 where the constants of ``duration`` hold."""
    when, rate = _measured.get(threads, (-np.inf, 0.0))
    now = time.monotonic()
    if now - when > VALID_S:
        _measured[threads] = now, (rate := _rate(threads))
    return rate / REFERENCE


def _rate(threads: int) -> float:
    """Rounds a second of a thread."""
    rounds = [0] * threads
    begin = threading.Barrier(threads + 1)
    end = [0.0]

    def work(k: int) -> None:
        a = np.linspace(0.5, 1.5, NUMBERS, dtype=np.float32)
        b, c = a[::-1].copy(), np.empty_like(a)
        begin.wait()
        while time.perf_counter() < end[0]:  # ufuncs let go of Python's lock
            np.multiply(a, b, out=c)
            np.sqrt(c, out=c)
            np.add(c, a, out=c)
            np.multiply(c, b, out=c)
            rounds[k] += 1

    workers = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(threads)]
    for worker in workers:
        worker.start()
    end[0] = time.perf_counter() + PROBE_S  # arrays are made meanwhile, a millisecond
    begin.wait()
    start = time.perf_counter()
    for worker in workers:
        worker.join()
    return max(sum(rounds), 1) / threads / (time.perf_counter() - start)


def _mark(planned: Plan) -> Path:
    chain = planned.chain
    return folder() / f"{_of_sources()}-{_kind(chain) if planned.reconstructs else 'correlation'}{ENDING}"


def _kind(chain: Chain) -> str:
    """What makes a run use other kernels than another."""
    settings = chain.reconstruction
    words = settings.method, settings.candidates, settings.weights, chain.solid is None, chain.space is None
    return hashlib.sha256(repr(words).encode()).hexdigest()[:8]


def _age_s(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return np.inf


@cache
def _of_sources() -> str:
    """Hash of all that compiled code depends on."""
    digest = hashlib.sha256(repr([versions()[name] for name in ("python", "numba", "llvmlite", "numpy")]).encode())
    digest.update(repr((platform.machine(), platform.processor())).encode())
    root = Path(plenopiv.__file__).parent
    for path in sorted(root.rglob("*.py")):
        if MARK_OF in (text := path.read_bytes()):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:24]
