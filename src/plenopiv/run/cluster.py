"""Pairs measured by Dask: a task for each frame and each pair, a few pairs at a time.

Frames and their volumes stay on the workers; records of pairs, which are small, come back. Dask makes a frame again
where its worker has died, and hands it on to where its pair is measured.
"""

from __future__ import annotations

import hashlib
import itertools
import logging
import os
import pickle
import socket
import time
import uuid
from asyncio import CancelledError
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVError
from plenopiv.recording import Recording
from plenopiv.run.inputs import computing_versions
from plenopiv.run.log import Clock
from plenopiv.run.pair import PairRecord
from plenopiv.run.shown import Shown
from plenopiv.run.workers import Pool

log = logging.getLogger("plenopiv")
LOOK_S = 1.0  # between looks at how many workers there are
START_S = 600.0  # that workers on this machine may take to start again
AGAIN = "the next run tries it again"


class Job(Protocol):
    """What a pair is measured by: of ``run``, or of ``track``."""

    @property
    def chain(self) -> Chain:
        """Its settings, and the device."""

    @property
    def recording(self) -> Recording:
        """Its frames and pairs."""

    @property
    def folder(self) -> Path:
        """Where files go."""

    def follows(self, number: int) -> bool:
        """Whether the second frame of pair ``number`` needs the first."""

    def given_up(self, number: int, reason: str) -> PairRecord:
        """The record of a pair that is set aside for a ``reason`` that lies not in its frames."""


def on_cluster(
    job: Job, numbers: Sequence[int], pool: Pool, clock: Clock, shown: Shown | None
) -> Generator[PairRecord, None, None]:
    """The records of the pairs ``numbers``, as they come, their fields written.

    One pair more than there are workers is in work. A pair whose worker dies again and again, or has no memory left, is
    put off, tried alone when all others are done, and then set aside for the next run. ``shown`` takes the
    first frame.

    Raises:
        PlenoPIVError: the scheduler cannot be reached, or is gone; a worker cannot read or write files, or has other
            versions.
    """
    from distributed.scheduler import KilledWorker

    with _handed_over(job, pool) as handle, clock("pairs on workers"):
        flight = _Flight(job, handle, pool, shown)
        waiting, suspects, alone = deque(numbers), list[int](), False
        lost: dict[int, str] = {}  # frames that their workers died of
        try:
            while waiting or flight.pairs or suspects:
                if not waiting and not flight.pairs:
                    waiting, suspects, alone = deque(sorted(suspects)), [], True
                workers = flight.workers()
                while waiting and len(flight.pairs) < (1 if alone else workers + 1):
                    number = waiting.popleft()
                    of_frame = [lost[k] for k in job.recording.pairs[number] if k in lost]
                    if of_frame:
                        yield job.given_up(number, of_frame[0])
                    else:
                        flight.submit(number)
                for number in flight.ended():
                    try:
                        record = flight.take(number, clock)
                    except (KilledWorker, MemoryError) as error:
                        if not alone:
                            suspects.append(number)
                            continue
                        reason = _reason(error)
                        if (frame := flight.frame_of(error)) is not None:
                            lost[frame] = f"{job.recording.frames[frame].name}: {reason}"
                            reason = lost[frame]
                        record = job.given_up(number, reason)
                    yield record
                flight.release(waiting[0] if waiting else None)
        finally:
            flight.close()


class _Flight:
    """The pairs in work and their frames, by number."""

    def __init__(self, job: Job, handle: Any, pool: Pool, shown: Shown | None) -> None:
        self.job, self.handle, self.pool, self.shown = job, handle, pool, shown
        self.client = pool.client()
        self.pairs: dict[int, Any] = {}
        self._frames: dict[int, Any] = {}
        self._first: tuple[int, Any] | None = None
        self._run, self._count = uuid.uuid4().hex[:8], itertools.count()
        self._waited, self._seen = False, time.monotonic()

    def submit(self, number: int) -> None:
        """Put a pair in work, with those of its frames that are not."""
        from plenopiv.run import on_worker

        frames = list[Any]()
        for k in self.job.recording.pairs[number]:
            if k not in self._frames:
                first = frames[:1] if self.job.follows(number) else []
                self._frames[k] = self._submit(on_worker.frame, "frame", k, -number, k, *first)
            frames.append(self._frames[k])
        self.pairs[number] = self._submit(on_worker.pair, "pair", number, -number + 0.5, number, *frames)
        if self._first is None and self.shown is not None and self.shown.wants(number):
            self._first = number, self._submit(on_worker.first_frame, "first", number, -number - 0.5, frames[0])

    def _submit(self, function: Any, kind: str, number: int, priority: float, *arguments: Any) -> Any:
        key = (f"plenopiv-{kind}", self._run, number, next(self._count))
        with self._talking():
            return self.client.submit(function, self.handle, *arguments, key=key, priority=priority, pure=False)

    def workers(self) -> int:
        """How many there are now."""
        with self._talking():
            count = len(self.client.nthreads())
        now = time.monotonic()
        if count:
            self._seen = now
        elif self.pool.workers.count is not None and now - self._seen > START_S:
            raise PlenoPIVError("no worker starts on this machine any more; what is finished is kept")
        elif self.pool.workers.count is None and not self._waited:
            self._waited = True
            log.info("%s: has no worker at the moment; waiting for one", self.pool.name)
        return count

    def ended(self) -> list[int]:
        """Pairs that are measured or have failed; waits for one, or a moment."""
        from distributed import wait

        if not self.pairs:
            return []
        with self._talking(), suppress(TimeoutError), self.client.as_current():
            wait(list(self.pairs.values()), timeout=LOOK_S, return_when="FIRST_COMPLETED")
        with self._talking():
            if self.client.status not in ("running", "connecting"):
                raise ConnectionError
        return [number for number, future in self.pairs.items() if future.done()]

    def take(self, number: int, clock: Clock) -> PairRecord:
        """The record of a pair that has ended, which is no longer in work.

        Raises:
            KilledWorker: its workers died of it, or of one of its frames.
            MemoryError: a worker's memory does not suffice.
            PlenoPIVError: as the task did.
        """
        future = self.pairs.pop(number)
        with self._talking():
            failed = future.exception() if future.status == "error" else None
            measured = None if failed else future.result()
        if failed is not None:
            self._drop_failed()
            if isinstance(failed, ModuleNotFoundError) or "deserialization" in str(failed):
                raise PlenoPIVError(f"{self.pool.name}: its workers need what runs here: {failed}") from None
            raise failed
        assert measured is not None
        if measured.peak is not None:
            gigabytes = round(measured.peak / 1e9, 3)
            clock.peak_gb["a worker"] = max(gigabytes, clock.peak_gb.get("a worker", 0.0))
        if self._first is not None and self._first[0] == number:
            self._take_first(*self._first)
        return measured.record

    def _take_first(self, number: int, future: Any) -> None:
        """Without it the main process makes it itself."""
        with suppress(Exception), self._talking():
            if (first := future.result(timeout=30)) is not None and self.shown is not None:
                self.shown.take(number, first)
        self._first = -1, None

    def _drop_failed(self) -> None:
        failed = [k for k, future in self._frames.items() if future.status in ("error", "cancelled")]
        for k in failed:
            del self._frames[k]

    def frame_of(self, error: BaseException) -> int | None:
        """The frame at which a worker died; None of a pair's own task."""
        task = getattr(error, "task", None)
        return task[2] if isinstance(task, tuple) and task[0] == "plenopiv-frame" else None

    def release(self, upcoming: int | None) -> None:
        """Let go of the frames that no pair in work, nor the one to come, has."""
        numbers = [*self.pairs, *([] if upcoming is None else [upcoming])]
        needed = {k for number in numbers for k in self.job.recording.pairs[number]}
        self._frames = {k: future for k, future in self._frames.items() if k in needed}

    def close(self) -> None:
        """Have nothing in work any more."""
        left = [*self.pairs.values(), *self._frames.values()]
        with suppress(Exception):
            if left and self.client.status == "running":
                self.client.cancel(left)
        self.pairs.clear()
        self._frames.clear()
        self._first = None

    @contextmanager
    def _talking(self) -> Iterator[None]:
        """Talk to the scheduler.

        Raises:
            PlenoPIVError: it is gone.
        """
        from distributed import CancelledError as Cancelled

        try:
            yield
        except TimeoutError:
            raise
        except (OSError, CancelledError, Cancelled) as error:
            raise PlenoPIVError(
                f"{self.pool.name}: the Dask scheduler is gone; what is finished is kept, and the same command goes on "
                "from there"
            ) from error


@contextmanager
def _handed_over(job: Job, pool: Pool) -> Iterator[Any]:
    """The job in a file of the work folder that workers read, and may write while it is there; a killed run's is swept
    as a file half written.

    Raises:
        PlenoPIVError: it cannot be written.
    """
    from plenopiv.run import on_worker

    content = pickle.dumps(job, protocol=pickle.HIGHEST_PROTOCOL)
    path = Path.cwd() / job.folder / f".job.{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}.part"
    device = job.chain.device
    versions = (*computing_versions(device).items(), ("device", device.stated))
    digest = hashlib.sha256(content).hexdigest()
    handle = on_worker.Handle(path, digest, Path.cwd(), versions, pool.workers.threads_of_each, device.kind)
    try:
        with path.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        yield handle
    except OSError as error:
        if error.filename != str(path):
            raise
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        path.unlink(missing_ok=True)
        if pool.workers.count is None:
            with suppress(Exception):
                pool.client().run(on_worker.forget, handle, wait=False)


def _reason(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return f"not enough memory on a worker ({error or 'out of memory'}); {AGAIN}"
    return f"its worker died {getattr(error, 'allowed_failures', 0) + 1} times, as where memory runs out; {AGAIN}"
