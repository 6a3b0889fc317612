"""Who works on which pairs of a results folder: a lock that the system gives back when its process dies.

A POSIX record lock on a file, a byte for each pair. It holds across the nodes of a cluster, on NFS too, and a run that
was killed leaves none behind. Locks of pairs that do not overlap exist side by side: array jobs, each with its pairs.
"""

from __future__ import annotations

import errno
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from plenopiv.errors import PlenoPIVError, told_of

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows: one process alone, no lock between processes
    fcntl = None  # type: ignore[assignment]

GUARD, BEGUN = 1 << 40, 1 << 41  # bytes far beyond those of pairs: who is beginning, and which pairs have begun
TRIES, PAUSE_S = 10, 0.1  # a run that ends, or asks whether it is alone, holds all pairs for a moment
_HELD: set[tuple[int, int]] = set()  # files that this process has locked: record locks do not keep it from itself
_HELD_GUARD = threading.Lock()


class FolderLock:
    """A lock on the pairs ``first`` <= k < ``end`` of a folder, of all pairs without ``end``; taken on entering.

    ``path``: of the lock's file, which is made where it is missing and stays. It holds a line for each run that took
    it: host, process, time and pairs. ``tries``: how often to ask, 0.1 s apart.

    Raises:
        PlenoPIVError: on entering: another run holds one of the pairs, or the file cannot be written.
    """

    def __init__(self, path: Path, first: int = 0, end: int | None = None, tries: int = TRIES):
        self.path, self.first, self.end, self.tries = path, first, end, tries
        self._descriptor: int | None = None
        self._key = (0, 0)

    def __enter__(self) -> FolderLock:
        for left in reversed(range(self.tries)):
            try:
                descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
            except FileNotFoundError:  # an ended run has removed the folder meanwhile
                with told_of(self.path):
                    self.path.parent.mkdir(parents=True, exist_ok=True)
                continue
            except OSError as error:
                raise PlenoPIVError(f"{self.path}: cannot be written ({error.strerror})") from None
            found = os.fstat(descriptor)
            key = (found.st_dev, found.st_ino)
            with _HELD_GUARD:
                mine = key in _HELD
                if not mine:
                    _HELD.add(key)
            if mine:  # and the descriptor stays open: to close it would give the other run's lock back
                raise self._in_use()
            try:
                taken = self._take(descriptor)
            except BaseException:
                self._let_go(descriptor, key)
                raise
            if taken and self._is_current(found):
                self._descriptor, self._key = descriptor, key
                self._sign(descriptor)
                return self
            self._let_go(descriptor, key)  # in use, or an ended run has removed the file meanwhile
            if not taken and left:
                time.sleep(PAUSE_S)
        raise self._in_use()

    def __exit__(self, *failure: object) -> None:
        if self._descriptor is not None:
            self._let_go(self._descriptor, self._key)
            self._descriptor = None

    def is_there(self) -> bool:
        """Whether the file is still the one that was locked: not removed, with its folder say, or replaced."""
        return self._descriptor is not None and self._is_current(os.fstat(self._descriptor))

    def alone(self) -> bool:
        """Whether the folder is still this run's and no other holds any pair; then this one holds all from now on."""
        return self._descriptor is not None and self.is_there() and self._try(self._descriptor, 0, 0)

    @contextmanager
    def beginning(self) -> Iterator[bool]:
        """While it lasts, no other run begins; whether none has. This one has once it is over.

        A run that has begun relies on what the folder says that all of its pairs depend on.
        """
        if self._descriptor is None or fcntl is None or self.end is None:
            yield True
            return
        fcntl.lockf(self._descriptor, fcntl.LOCK_EX, 1, GUARD)
        try:
            if none := self._try(self._descriptor, GUARD, BEGUN):
                fcntl.lockf(self._descriptor, fcntl.LOCK_UN, GUARD, BEGUN)
            yield none
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX, self.end - self.first, BEGUN + self.first)
        finally:
            fcntl.lockf(self._descriptor, fcntl.LOCK_UN, 1, GUARD)

    def _take(self, descriptor: int) -> bool:
        """Take the pairs; whether nobody else has one of them."""
        count = 0 if self.end is None else self.end - self.first  # 0: to the end of all files
        try:
            return self._try(descriptor, count, self.first)
        except OSError as error:
            raise PlenoPIVError(
                f"{self.path}: cannot be locked ({error.strerror}); put output.directory on a file system with locks"
            ) from None

    def _try(self, descriptor: int, count: int, first: int) -> bool:
        """Take so many bytes from the ``first`` on; whether nobody else has one of them."""
        if fcntl is None:
            return True
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, count, first)
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):
                return False
            raise
        return True

    def _is_current(self, found: os.stat_result) -> bool:
        try:
            now = os.stat(self.path)
        except OSError:
            return False
        return (now.st_dev, now.st_ino) == (found.st_dev, found.st_ino)

    def _let_go(self, descriptor: int, key: tuple[int, int]) -> None:
        os.close(descriptor)
        with _HELD_GUARD:
            _HELD.discard(key)

    def _sign(self, descriptor: int) -> None:
        pairs = "all pairs" if self.end is None else f"pairs {self.first} to {self.end - 1}"
        line = f"{socket.gethostname()}, process {os.getpid()}, {time.strftime('%Y-%m-%d %H:%M:%S')}, {pairs}\n"
        with suppress(OSError):  # a word for whoever looks; on a full disk none
            os.lseek(descriptor, 0, os.SEEK_END)
            os.write(descriptor, line.encode())

    def _in_use(self) -> PlenoPIVError:
        return PlenoPIVError(
            f"{self.path.parent.parent}: another run works in this folder ({self.path} says which); wait for its end, "
            "or take another output.directory"
        )
