"""Kernels on several threads.

A kernel takes the range of its rows, planes or items first, ``kernel(begin, end, ...)``, and lets go of Python's lock.
Each of Numba's number of threads (``NUMBA_NUM_THREADS``) takes one range; what a range writes must not depend on the
others. Numba's own parallel loops compile twice as long, and some of its thread pools may not be entered by two callers
at once, as those of a cluster's worker do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


def _work(jobs: SimpleQueue) -> None:
    """Do jobs for ever: call, and say what was raised."""
    while True:
        kernel, part, arguments, done = jobs.get()
        try:
            kernel(*part, *arguments)
            done.put(None)
        except BaseException as error:
            done.put(error)
        del kernel, arguments, done  # arrays are not held while nothing is to do


@cache  # an evicted queue would leave its threads waiting for ever
def _jobs(threads: int) -> SimpleQueue:
    """The queue that so many threads of this process work off; handing over takes a tenth of what futures take."""
    jobs: SimpleQueue = SimpleQueue()
    for n in range(threads):
        Thread(target=_work, args=(jobs,), name=f"plenopiv-{n}", daemon=True).start()
    return jobs


if hasattr(os, "register_at_fork"):  # a forked process has the queue without its threads
    os.register_at_fork(after_in_child=_jobs.cache_clear)


def in_threads(kernel: Callable[..., Any], count: int, *arguments: Any, little: bool = False) -> None:
    """Call ``kernel(begin, end, *arguments)`` for ranges that cover 0 to ``count``; raise what one of them raises. Not
    to be called from within itself. ``little``: all of it takes less time than two hand-overs."""
    threads = numba.get_num_threads()
    if threads == 1 or count < 2 or little:
        kernel(0, count, *arguments)
        return
    bounds = [count * k // threads for k in range(threads + 1)]
    mine, *others = (part for part in pairwise(bounds) if part[0] < part[1])
    jobs, done = _jobs(threads - 1), SimpleQueue[BaseException | None]()
    for part in others:
        jobs.put((kernel, part, arguments, done))
    try:
        kernel(*mine, *arguments)
    finally:
        raised = [done.get() for _ in others]  # nothing is written any more once this returns, or raises
    for error in raised:
        if error is not None:
            raise error


def in_turn(count: int) -> NDArray[np.int64]:
    """The numbers 0 to ``count`` - 1 in an order of which each run is spread evenly over all of them, even ones first
    (by their bits in reverse): of planes of which those near focus take longest, each thread's range has its share."""
    return np.array(sorted(range(count), key=lambda k: f"{k:064b}"[::-1]), np.int64)
