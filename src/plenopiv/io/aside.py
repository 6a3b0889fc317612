"""A file that is whole or not there: written aside, then renamed."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from plenopiv.errors import told_of


@contextmanager
def written_aside(path: str | Path) -> Iterator[Path]:
    """Where to write what shall become ``path``, which is replaced in one step once all is on disk.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    path = Path(path)
    aside = path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}.part")
    try:
        with told_of(path):
            yield aside
            with aside.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(aside, path)
        sync_names(path.parent)
    finally:
        with suppress(OSError):
            aside.unlink()


def is_being_written(aside: Path) -> bool:
    """Whether a file of ``written_aside`` is one of a process of this machine that still goes on."""
    match = re.fullmatch(rf".*\.{re.escape(socket.gethostname())}-(\d+)\.part", aside.name)
    if match is None or int(match[1]) == os.getpid() or os.name == "nt":  # there signal 0 is not a question
        return False
    try:
        os.kill(int(match[1]), 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True


def sweep_asides(folder: Path, pattern: str = ".*.part") -> None:
    """Remove what killed processes left half written in a folder, if there is one."""
    for path in folder.glob(pattern):
        if not is_being_written(path):
            with suppress(OSError):
                path.unlink()


def moved(made: Path, place: Path) -> None:
    """Move a file in one step; by a copy where ``place`` lies on another disk, as where a folder is a link.

    Raises:
        OSError: it cannot be written.
        PlenoPIVError: so cannot the copy.
    """
    try:
        os.replace(made, place)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with written_aside(place) as aside:
            shutil.copyfile(made, aside)
        made.unlink()


class Unfailing(io.RawIOBase):
    """A new file for the HDF5 library, which crashes when it cannot write: it is told that all was written, and what
    went wrong is kept in ``error``."""

    def __init__(self, path: Path):
        self._file = path.open("w+b", buffering=0)
        self.error: OSError | None = None

    def write(self, content: Any) -> int:
        """Write all of ``content`` where the file stands; from the first failure on nothing."""
        left = memoryview(content).cast("B")
        size = len(left)
        try:
            while left and self.error is None:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.error = error
        return size

    def check(self) -> None:
        """Raise what went wrong, as an OSError."""
        if self.error is not None:
            raise self.error

    def readinto(self, buffer: Any) -> int:
        """Read into ``buffer``; zeros where nothing was written."""
        view = memoryview(buffer).cast("B")
        found = self._file.readinto(view)
        view[found:] = bytes(len(view) - found)
        return len(view)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """As of any file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """As of any file."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """As of any file, but without failing."""
        try:
            return self._file.truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0

    def readable(self) -> bool:
        """It is."""
        return True

    def writable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def close(self) -> None:
        """Close the file."""
        super().close()
        self._file.close()


@contextmanager
def hdf5_aside(path: str | Path) -> Iterator[Unfailing]:
    """``written_aside``, as a file object for h5py.

    Raises:
        PlenoPIVError: as there.
    """
    with written_aside(path) as aside, closing(Unfailing(aside)) as file:
        try:
            yield file
        except Exception:
            if file.error is None:
                raise
        file.check()


def sync_names(folder: Path) -> None:
    """Have the names in a folder on disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
