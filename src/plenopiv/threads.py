"""Kernels on several threads.

A kernel takes the range of its rows, planes or items first, ``kernel(begin, end, ...)``, and lets go of Python's lock.
Each of Numba's number of threads (``NUMBA_NUM_THREADS``) takes one range; what a range writes must not depend on the
others. Handing one over takes 15 to 18 us, less than half a per cent of what a reconstruction or a correlation takes.
Numba's own parallel loops compile twice as long, and some of its thread pools may not be entered by two callers at
once, as those of a cluster's worker do.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Item = TypeVar("Item")
Made = TypeVar("Made")


@cache  # its threads wait for work until the process ends
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "plenopiv")


if hasattr(os, "register_at_fork"):  # a forked process has the pool without its threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def in_threads(kernel: Callable[..., Any], count: int, *arguments: Any, little: bool = False) -> None:
    """Call ``kernel(begin, end, *arguments)`` for ranges that cover 0 to ``count``; raise what one of them raises. Not
    to be called from within itself. ``little``: all of it takes less time than two hand-overs."""
    threads = numba.get_num_threads()
    if threads == 1 or count < 2 or little:
        kernel(0, count, *arguments)
        return
    bounds = [count * k // threads for k in range(threads + 1)]
    mine, *others = (part for part in pairwise(bounds) if part[0] < part[1])
    pool = _pool(threads - 1)
    futures = []
    try:
        for part in others:
            futures.append(pool.submit(kernel, *part, *arguments))
        kernel(*mine, *arguments)
    finally:
        raised = [future.exception() for future in futures]  # nothing is written any more once this returns, or raises
    for error in raised:
        if error is not None:
            raise error


def in_turn(count: int) -> NDArray[np.int64]:
    """The numbers 0 to ``count`` - 1 in an order of which each run is spread evenly over all of them, even ones first
    (by their bits in reverse): of planes of which those near focus take longest, each thread's range has its share."""
    return np.array(sorted(range(count), key=lambda k: f"{k:064b}"[::-1]), np.int64)


def each_in_threads(make: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
    """``make`` of each item, in order, on Numba's number of threads: for work in libraries that let go of Python's
    lock. Raises what one of them raises; what has not begun then is not begun."""
    with ThreadPoolExecutor(numba.get_num_threads(), "plenopiv") as pool:
        made = [pool.submit(make, item) for item in items]
        try:
            for each in made:
                yield each.result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def one_thread() -> Iterator[None]:
    """Kernels on the calling thread alone, which is one of several."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS and LAPACK on one thread each. Their own threads wait for one another at each step: where other work shares
    the cores, a banded Cholesky factor took 15 times as long with two as with one."""
    with _blas().limit(limits=1, user_api="blas"):
        yield


@cache
def _blas() -> Any:
    import scipy.linalg  # noqa: F401  # libraries are looked for once: they are loaded then
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
