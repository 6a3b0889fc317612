"""A pretended series of a few pairs in a process of its own, ended at a step of its work on files.

A step is a file opened, renamed, removed or locked, a folder made or removed, or data forced to disk, below the results
folder. HDF5's own are not seen: it writes only into files aside.
"""

from __future__ import annotations

import errno
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

from plenopiv.errors import PlenoPIVError
from plenopiv.io.netcdf import write_velocity
from plenopiv.io.series_file import pair_file, write_series
from plenopiv.io.series_folder import SeriesFolder

EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "fcntl.lockf")
PAIRS = 3


def count_steps(folder: Path, act: Callable[[int, str], None]) -> None:
    """Call ``act(number, what)`` before each step below ``folder``, from now on and to the end of this process."""
    number, within = [0], str(folder)

    def step(what: str) -> None:
        number[0] += 1
        act(number[0], what)

    def hook(event: str, given: tuple[object, ...]) -> None:
        if event in EVENTS and (event == "fcntl.lockf" or str(given[0]).startswith(within)):
            step(f"{event} {given[0]}")

    sync = os.fsync

    def fsync(descriptor: int) -> None:
        step(f"fsync {os.readlink(f'/proc/self/fd/{descriptor}')}")
        sync(descriptor)

    os.fsync = fsync
    sys.addaudithook(hook)


def session(directory: Path, like: object, setting: float = 0.5, overwrite: bool = False) -> list[int]:
    """A run as ``run.series`` has it, with pretended pairs; the numbers of those that it measured."""
    inputs = {"settings": {"overlap": setting}}
    with SeriesFolder(directory, overwrite) as folder:
        folder.begin(inputs)
        now = {**inputs, "calibration": 1.0}
        folder.settle(now)
        if folder.is_complete:
            folder.discard()
            return []
        measured = [number for number in range(PAIRS) if number not in folder.finished]
        for number in measured:
            write_velocity(folder.path(pair_file(number)), like + number + setting)
            folder.store({"pair": number, "set_aside": None}, [pair_file(number)])
        files = {number: folder.there(pair_file(number)) for number in range(PAIRS)}
        write_series(folder.path("velocity.nc"), like, {"time": [0.0, 1.0, 2.0]}, files, {})
        folder.write_text("summary.json", json.dumps({"inputs_sha256": folder.depends}))
        folder.write_text("figures/a.txt", "a figure")
        folder.publish(["velocity.nc", "summary.json", "figures/a.txt"], now)
        return measured


def contents(directory: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(p.relative_to(directory)): p.read_bytes() for p in sorted(directory.rglob("*")) if p.is_file()}


def child(work: Callable[[], object]) -> tuple[int, str]:
    """Exit status of ``work`` in a process of its own, negative for a signal, and what it returned or raised."""
    receiver, sender = os.pipe()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.write(sender, str(work()).encode())
            code = 0
        except PlenoPIVError as error:
            os.write(sender, str(error).encode())
            code = 2
        except BaseException:
            os.write(sender, traceback.format_exc()[-3000:].encode())
        finally:
            os._exit(code)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        said = pipe.read().decode()
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), said


def steps_of(folder: Path, work: Callable[[], object]) -> int:
    """How many steps ``work`` takes."""
    seen: list[str] = []
    return int(child(lambda: (count_steps(folder, lambda number, what: seen.append(what)), work(), len(seen))[2])[1])


def killed_at(n: int, folder: Path, work: Callable[[], object]) -> tuple[int, str]:
    """``work``, killed before step ``n``."""

    def act(number: int, what: str) -> None:
        if number == n:
            os.kill(os.getpid(), signal.SIGKILL)

    return child(lambda: (count_steps(folder, act), work())[1])


def failing_from(n: int, folder: Path, work: Callable[[], object], once: bool = False) -> tuple[int, str]:
    """``work`` on a disk that is full from step ``n`` on, ``once``: at it alone; what is removed can be."""

    def act(number: int, what: str) -> None:
        free = what.startswith(("os.remove", "os.rmdir", "fcntl", "open"))  # what a full disk does not hinder
        if (number == n and once and not what.startswith("fcntl")) or (number >= n and not once and not free):
            raise OSError(errno.ENOSPC, "No space left on device", what.split(" ", 1)[1])

    return child(lambda: (count_steps(folder, act), work())[1])
