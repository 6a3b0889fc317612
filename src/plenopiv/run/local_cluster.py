"""A Dask scheduler and its workers on this machine, in processes of their own that end with the one that asked.

Run as a program it takes one JSON object as its argument (``path``: Python's, ``count``, ``threads``, ``memory`` in
bytes or "auto", ``folder`` for Dask's files), prints the scheduler's address, and ends when its standard input does.
In a process of its own, the scheduler has what it needs while the main process computes, Dask's words reach no user,
Ctrl-C in a terminal reaches the main process alone, and a script need not guard its main module, which multiprocessing
imports in each worker.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
TERMINATED = 0.95  # of a worker's memory, from which it is ended
PATIENCE_S = 5.0
WATCH_S = 1.0  # between looks at the workers
LOST = "5 minutes"  # after which a worker that starts is given up: on a busy machine it takes long
DEATHS = 2  # of its worker, after which a task is not tried once more beside others
PROGRAM = "import json, sys; asked = json.loads(sys.argv[1]); sys.path[:] = asked['path']; "
PROGRAM += "from plenopiv.run.local_cluster import main; main(asked)"


def command(count: int, threads: int, memory: int | None, folder: Path) -> list[str]:
    """The command that starts it; ``memory``: bytes of a worker, None for its part of what the machine has."""
    asked = {"count": count, "threads": threads, "memory": memory or "auto", "folder": str(folder), "path": sys.path}
    return [sys.executable, "-c", PROGRAM, json.dumps(asked)]


def environment(threads: int) -> dict[str, str]:
    """Environment variables that give a process so many threads."""
    return dict.fromkeys(THREADS, str(threads))


def settings(threads: int, preloaded: Sequence[str] = (), folder: str | None = None) -> dict[str, Any]:
    """Dask's settings: threads are set before workers start, frames are not spilled to disk (few are held at a time),
    no worker pauses, none samples what it does, and each loads the kernels' modules at once, beside what a user has
    it load (``preloaded``). What Dask writes goes into a ``folder``."""
    return {
        "distributed.nanny.pre-spawn-environ": environment(threads),
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.deploy.lost-worker-timeout": LOST,
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": TERMINATED,
        "distributed.worker.profile.enabled": False,
        "distributed.worker.preload": ["plenopiv.run.on_worker", *preloaded],
        **({"temporary-directory": folder} if folder else {}),
    }


def main(asked: Mapping[str, Any]) -> None:
    """Start scheduler and workers, tell their address, and go on until standard input ends."""
    clusters: list[Any] = []
    ends = threading.Thread(target=_end_with_input, args=[clusters, asked["folder"]], daemon=True)
    ends.start()

    import dask
    from distributed import LocalCluster  # and Dask's settings with it

    with dask.config.set(settings(asked["threads"], dask.config.get("distributed.worker.preload"), asked["folder"])):
        cluster = LocalCluster(
            n_workers=asked["count"],
            threads_per_worker=1,
            memory_limit=asked["memory"],
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            local_directory=asked["folder"],
        )
        clusters.append(cluster)
        print(cluster.scheduler_address, flush=True)
        while ends.is_alive():
            ends.join(WATCH_S)
            _start_again(cluster, asked["count"])


def _start_again(cluster: Any, count: int) -> None:
    """Have as many workers again as were asked for: a nanny starts its worker anew, but gives up where that one dies
    while it starts."""
    from distributed import Status

    for name, nanny in list(cluster.workers.items()):
        if nanny.status in (Status.closed, Status.failed):
            cluster.workers.pop(name, None)
    cluster.scale(count)


def _end_with_input(clusters: Sequence[Any], folder: str) -> None:
    """End this process and its workers, whatever they do, when standard input ends; and remove Dask's ``folder``, which
    a main process that was killed leaves."""
    sys.stdin.read()
    import psutil

    for cluster in clusters:
        for nanny in list(cluster.workers.values()):
            nanny.auto_restart = False
    workers = psutil.Process().children(recursive=True)
    for worker in workers:
        with suppress(psutil.Error):
            worker.kill()
    psutil.wait_procs(workers, timeout=PATIENCE_S)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)  # a worker that has just been started ends with this process
