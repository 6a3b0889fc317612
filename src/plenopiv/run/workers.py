"""Dask's workers that a run may use: its own on this machine, or those of a scheduler that is there."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plenopiv.errors import PlenoPIVError, brief
from plenopiv.run import local_cluster

if TYPE_CHECKING:
    from distributed import Client

MISSING = '--workers and --scheduler need Dask: pip install "plenopiv[cluster]"'
PATIENCE_S = 30.0  # for a scheduler
NOISY = ("distributed", "tornado", "asyncio")  # what they log is for whoever looks after a cluster


@dataclass(frozen=True)
class Workers:
    """``count`` processes on this machine; or those of the Dask scheduler at an address (``scheduler``), of a file that
    names it (``scheduler_file``), or of a ``client``. ``threads``: of each; by default the cores of this machine
    divided by ``count``, or as many as Dask gives a worker.

    Raises:
        PlenoPIVError: none or several of these are named, or numbers below 1.
    """

    count: int | None = None
    threads: int | None = None
    scheduler: str | None = None
    scheduler_file: Path | None = None
    client: Client | None = None

    def __post_init__(self) -> None:
        named = [self.count, self.scheduler, self.scheduler_file, self.client]
        if sum(each is not None for each in named) != 1:
            raise PlenoPIVError(
                "workers: name one of --workers, --scheduler and --scheduler-file; --threads goes with it"
            )
        if any(number is not None and number < 1 for number in (self.count, self.threads)):
            raise PlenoPIVError("workers: --workers and --threads take 1 and more")

    @property
    def threads_of_each(self) -> int | None:
        """Threads of a worker; None where Dask says it."""
        if self.threads or self.count is None:
            return self.threads
        import numba

        return max(numba.get_num_threads() // self.count, 1)


class Pool:
    """Workers that have been asked for. ``client`` connects to them, and waits for those of this machine."""

    def __init__(self, workers: Workers, process: subprocess.Popen[str] | None = None, words: Any = None) -> None:
        self.workers, self._process, self._words = workers, process, words
        self._client: Client | None = workers.client

    @property
    def name(self) -> str:
        """As messages have it."""
        if self.workers.client is not None:
            return str(getattr(self.workers.client.scheduler, "address", "the scheduler"))
        return str(self.workers.scheduler or self.workers.scheduler_file or "this machine")

    def client(self) -> Client:
        """A client of the scheduler.

        Raises:
            PlenoPIVError: it cannot be reached, or workers do not start.
        """
        if self._client is None:
            from distributed import Client

            given: dict[str, Any] = {"address": self.workers.scheduler}
            if self._process is not None:
                given = {"address": self._own_address()}
            elif self.workers.scheduler_file is not None:
                _wait_for(self.workers.scheduler_file)
                given = {"scheduler_file": str(self.workers.scheduler_file)}
            try:
                self._client = Client(**given, timeout=PATIENCE_S, set_as_default=False)
            except (OSError, ValueError, ImportError) as error:
                raise PlenoPIVError(f"{self.name}: no Dask scheduler answers there ({brief(error)})") from None
        return self._client

    def _own_address(self) -> str:
        assert self._process is not None
        assert self._process.stdout is not None
        address = self._process.stdout.readline().strip()
        if not address:
            self._words.seek(0)
            said = [line for line in self._words.read().decode(errors="replace").splitlines() if line.strip()]
            raise PlenoPIVError(f"the workers do not start: {said[-1][:200] if said else 'no word on why'}")
        return address

    def close(self) -> None:
        """Let the workers go; those of this machine are ended when this returns."""
        if self._client is not None and self.workers.client is None:
            with suppress(Exception):
                self._client.close(timeout=2)
        self._client = self.workers.client
        if self._process is not None:
            assert self._process.stdin is not None
            with suppress(OSError):
                self._process.stdin.close()
            try:
                self._process.wait(timeout=2 * local_cluster.PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


@contextmanager
def started(workers: Workers | int | None, memory: int | None = None) -> Iterator[Pool | None]:
    """Workers, those of this machine while they start; None without any. ``memory``: bytes of each on this machine.

    Raises:
        PlenoPIVError: Dask is not installed, or no scheduler answers.
    """
    if workers is None:
        yield None
        return
    if find_spec("distributed") is None:
        raise PlenoPIVError(MISSING)
    asked = Workers(count=workers) if isinstance(workers, int) else workers
    if asked.count is None:
        pool = Pool(asked)
        with _quiet(asked.client is None):
            try:
                pool.client()  # now: a mistake in the address is told before the checks
                yield pool
            finally:
                pool.close()
        return
    threads = asked.threads_of_each or 1
    temporary = tempfile.TemporaryDirectory(prefix="plenopiv-", ignore_cleanup_errors=True)
    with temporary as folder, tempfile.TemporaryFile() as words, _quiet(True):
        process = subprocess.Popen(
            local_cluster.command(asked.count, threads, memory, Path(folder)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            text=True,
            env=os.environ | local_cluster.environment(threads),
            start_new_session=True,  # Ctrl-C in a terminal is for the main process
        )
        pool = Pool(asked, process, words)
        try:
            yield pool
        finally:
            pool.close()


def _wait_for(file: Path) -> None:
    """A scheduler writes its file when it starts, which may take a while in a queue.

    Raises:
        PlenoPIVError: it does not.
    """
    until = time.monotonic() + PATIENCE_S
    while not _names_scheduler(file):
        if time.monotonic() > until:
            wrong = "names no scheduler, or is half written" if file.exists() else "is not there"
            raise PlenoPIVError(f"{file}: {wrong}; dask scheduler --scheduler-file {file} writes it")
        time.sleep(0.2)


def _names_scheduler(file: Path) -> bool:
    """Whether it is whole, with the address of a scheduler in it."""
    try:
        found = json.loads(file.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and isinstance(found.get("address"), str)


@contextmanager
def _quiet(wanted: bool) -> Iterator[None]:
    """Keep Dask's log lines and warnings from the user, who gets one line of what matters."""
    if not wanted:
        yield
        return
    import distributed  # noqa: F401  (sets levels of its own)

    known = list(logging.root.manager.loggerDict)
    loggers = [logging.getLogger(name) for name in {*NOISY, *known} if name.split(".")[0] in NOISY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="distributed")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
