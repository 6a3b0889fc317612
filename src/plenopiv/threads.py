"""Kernels on several threads.

A kernel takes the range of its rows, planes or items first, ``kernel(begin, end, ...)``, and lets go of Python's lock.
Ranges are dealt out to Numba's number of threads (``NUMBA_NUM_THREADS``) as these get free; what a range writes must
not depend on the others. Numba's own parallel loops compile twice as long, and some of its thread pools may not be
entered by two callers at once, as those of a cluster's worker do.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numba


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "plenopiv")


def in_threads(kernel: Callable[..., Any], count: int, *arguments: Any, at_once: int = 1) -> None:
    """Call ``kernel(begin, end, *arguments)`` for ranges of ``at_once`` that cover 0 to ``count``; raise what one of
    them raises. Not to be called from within itself."""
    ranges = [(begin, min(begin + at_once, count)) for begin in range(0, count, at_once)]
    threads = numba.get_num_threads()
    if threads == 1 or len(ranges) < 2:
        for begin, end in ranges:
            kernel(begin, end, *arguments)
        return
    kernel(*ranges[0], *arguments)  # compiles, if need be, where a traceback can be read
    jobs: list[Future[Any]] = [_pool(threads).submit(kernel, *part, *arguments) for part in ranges[1:]]
    for job in jobs:
        job.result()
