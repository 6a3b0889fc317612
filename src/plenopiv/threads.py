"""Kernels on several threads.

A kernel takes the range of its rows, planes or items first, ``kernel(begin, end, ...)``, and lets go of Python's lock.
Each of Numba's number of threads (``NUMBA_NUM_THREADS``) takes one range; what a range writes must not depend on the
others. Numba's own parallel loops compile twice as long, and some of its thread pools may not be
entered by two callers at once, as those of a cluster's worker do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numba

RANGES = 1  # a thread: to call a kernel takes 0.1 ms


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "plenopiv")


if hasattr(os, "register_at_fork"):  # a forked process has the pool without its threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


def in_threads(kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
    """Call ``kernel(begin, end, *arguments)`` for ranges that cover 0 to ``count``; raise what one of them raises. Not
    to be called from within itself."""
    threads = numba.get_num_threads()
    if threads == 1 or count < 2:
        kernel(0, count, *arguments)
        return
    bounds = [count * k // (RANGES * threads) for k in range(RANGES * threads + 1)]
    ranges = [part for part in pairwise(bounds) if part[0] < part[1]]
    jobs = [_pool(threads - 1).submit(kernel, *part, *arguments) for part in ranges[1:]]
    try:
        kernel(*ranges[0], *arguments)
    finally:
        wait(jobs)  # nothing is written any more once this returns, or raises
    for job in jobs:
        job.result()
