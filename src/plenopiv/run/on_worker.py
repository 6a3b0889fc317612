"""What a Dask worker does for a run: frames and pairs of its job, one at a time in a process.

The job comes by a file in the work folder, which all workers see, and is read once in a process, so that its projection
is made once. While the file is there, workers may write.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dask
import numba

from plenopiv.device.backend import Kind, device_of
from plenopiv.errors import PlenoPIVError
from plenopiv.run.frame import Frame, LostFrame
from plenopiv.run.inputs import computing_versions
from plenopiv.run.log import Clock
from plenopiv.run.memory import peak_so_far
from plenopiv.run.pair import PairRecord
from plenopiv.run.shown import FirstFrame

_ALONE = threading.Lock()
_JOBS: dict[Handle, Any] = {}  # the last one


@dataclass(frozen=True)
class Handle:
    """What goes with each task: where the job is and its hash, the folder that relative paths start from, the versions
    that its bits depend on ("device" among them), the threads of a task (None for as many as Dask gives the worker),
    and the kind of device."""

    job: Path
    digest: str
    folder: Path
    versions: tuple[tuple[str, str], ...]
    threads: int | None
    device: Kind = "cpu"


@dataclass(frozen=True)
class Measured:
    """A pair's record, and the largest memory of its worker so far, in bytes."""

    record: PairRecord
    peak: float | None


def frame(handle: Handle, number: int, first: Any = None) -> Any:
    """Frame ``number``, reconstructed, or tracked; it stays on the worker until its pairs are measured. ``first``: the
    first frame of its pair, where it needs that.

    Raises:
        PlenoPIVError: a file cannot be written, the run has ended, or the worker does not see the recording.
    """
    with _at_work(handle) as job:
        try:
            return job.frame(number, _silent) if first is None else job.second(number, first, _silent)
        except PlenoPIVError:
            folder = job.recording.frames[number].path.parent
            try:
                folder.stat()
            except OSError as error:
                raise _unseen(folder, error) from None
            raise


def pair(handle: Handle, number: int, before: Any, after: Any) -> Measured:
    """Pair ``number``, its field written.

    Raises:
        PlenoPIVError: a file cannot be written, or the run has ended.
    """
    with _at_work(handle) as job:
        return Measured(job.pair(number, before, after, _silent), peak_so_far())


def first_frame(handle: Handle, before: Frame | LostFrame) -> FirstFrame | None:
    """What the report shows of a frame; None of a lost one."""
    with _at_work(handle) as job:
        return FirstFrame.of(job.chain, before, Clock()) if isinstance(before, Frame) else None


def forget(handle: Handle) -> None:
    """Let a job go that has ended."""
    _JOBS.pop(handle, None)


@contextlib.contextmanager
def _at_work(handle: Handle) -> Iterator[Any]:
    """The job, alone in this process, in the main process' folder and with the threads that it may use.

    Raises:
        PlenoPIVError: the worker sees other folders, or has other versions.
    """
    with _ALONE, _in_folder(handle.folder), dask.config.set(scheduler="threads"):  # xarray's locks: of this process
        before = numba.get_num_threads()
        numba.set_num_threads(min(handle.threads or _threads_of_worker(), numba.config.NUMBA_NUM_THREADS))
        try:
            yield _job(handle)
        except RecursionError as error:  # Dask 2026.8 cannot report one, and the run would wait for ever
            raise RuntimeError(str(error)) from None
        finally:
            numba.set_num_threads(before)


def _threads_of_worker() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


@contextlib.contextmanager
def _in_folder(folder: Path) -> Iterator[None]:
    if Path.cwd() == folder:
        yield
        return
    before = Path.cwd()
    try:
        os.chdir(folder)
    except OSError as error:
        raise _unseen(folder, error) from None
    try:
        yield
    finally:
        os.chdir(before)


def _job(handle: Handle) -> Any:
    if handle not in _JOBS:
        here = _versions_here(handle)
        for name, wanted in handle.versions:
            if here.get(name) != wanted:
                raise PlenoPIVError(
                    f"the worker on {socket.gethostname()} has {name} {here.get(name)}, this run {wanted}, which may "
                    "change results; give both the same environment"
                )
        try:
            content = handle.job.read_bytes()
        except OSError as error:
            raise _unseen(handle.job, error) from None
        if hashlib.sha256(content).hexdigest() != handle.digest:
            raise PlenoPIVError(f"{handle.job}: is damaged, or another run's")
        job = pickle.loads(content)
        _JOBS.clear()
        _JOBS[handle] = replace(job, while_there=handle.job)
    return _JOBS[handle]


def _versions_here(handle: Handle) -> dict[str, str]:
    """This worker's versions, and its device.

    Raises:
        PlenoPIVError: the device of the run is not there.
    """
    try:
        device = device_of(handle.device)
    except PlenoPIVError as error:
        raise PlenoPIVError(f"the worker on {socket.gethostname()}: {error}") from None
    return computing_versions(device) | {"device": device.stated}


def _unseen(path: Path, error: OSError) -> PlenoPIVError:
    return PlenoPIVError(
        f"{path}: the worker on {socket.gethostname()} cannot read it ({error.strerror}); put recording and "
        "output.directory where all workers see them under one name"
    )


def _silent(stage: str, done: int, total: int) -> None:
    """No progress from within a worker."""
