"""What each of several processes on a machine may take of its memory, and what they take in all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isinf

import numba

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError
from plenopiv.run import memory
from plenopiv.run.memory import MemoryEstimate
from plenopiv.run.plan import Plan, plan
from plenopiv.run.workers import Workers

DASK = 60e6  # bytes of Dask in a worker, and of a client in the main process
SCHEDULER = 200e6  # bytes of the process that holds Dask's scheduler, on this machine
HELD = 2  # frames that a worker holds beside those of the pair that it measures
SLACK = 1.1  # of its part: a worker that takes more is ended


@dataclass(frozen=True)
class Share:
    """Bytes of the main process, of each worker, and of all on this machine; ``count``: 0 where workers are those of
    a scheduler."""

    main: float
    worker: float
    count: int

    @property
    def text(self) -> str:
        """For the user."""
        main, worker = f"{self.main / 1e9:.2g} GB", f"{self.worker / 1e9:.2g} GB"
        if self.count == 0:
            return f"about {main}, and {worker} of each worker"
        total = self.main + SCHEDULER + self.count * self.worker
        return f"about {total / 1e9:.2g} GB: {main}, Dask's {SCHEDULER / 1e9:.2g} GB, {worker} of each worker"


def limit_of_worker(workers: Workers | int | None, memory_gb: float | None) -> int | None:
    """Bytes at which Dask ends a worker on this machine; None where none are set, or infinitely many."""
    count = workers if isinstance(workers, int) else workers.count if workers else None
    if count is None or memory_gb is None:
        return None
    limit = SLACK * (1e9 * memory_gb - memory.REPORT - SCHEDULER) / count
    return None if isinf(limit) else max(int(limit), 1)


def shared_plan(chain: Chain, memory_gb: float | None, workers: Workers) -> tuple[Plan, Share]:
    """The plan of a run on workers, in tiles where ``memory_gb`` does not suffice: of all processes on this machine, or
    of each worker of a scheduler.

    Raises:
        PlenoPIVError: that does not suffice, in tiles either.
    """
    whole, count = plan(chain), workers.count or 0
    main = memory.REPORT + DASK + whole.needed.images
    more = DASK + HELD * (whole.needed.images / 2 + memory.KEPT * whole.needed.volumes) - _of_report(whole.needed)
    planned = whole
    if memory_gb is not None:
        each = 1e9 * memory_gb if count == 0 else (1e9 * memory_gb - main - SCHEDULER) / count
        try:
            planned = plan(chain, max(each - more, 0.0) / 1e9)
        except PlenoPIVError as error:
            raise PlenoPIVError(f"{error} (each of {count} workers)" if count > 1 else f"{error} (a worker)") from None
    if count:
        faster = count * (workers.threads_of_each or 1) / numba.get_num_threads()
        takes = replace(planned.takes, frame=planned.takes.frame / faster, pair=planned.takes.pair / faster)
        planned = replace(planned, takes=takes)
    return planned, Share(main, planned.needed.peak + more, count)


def _of_report(needed: MemoryEstimate) -> float:
    """Bytes of a whole run's peak that drawing the report takes, which no worker does."""
    without = memory.BASE + max(needed.light_field + needed.volumes, needed.layers + needed.measured) + needed.images
    return needed.peak - without
