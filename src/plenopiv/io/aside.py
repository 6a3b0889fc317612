"""A file that is whole or not there: written aside, then renamed."""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from plenopiv.errors import PlenoPIVError

HDF5_NUMBER = re.compile(r"errno = (\d+)")  # within the messages of the HDF5 library, which have no errno of their own


@contextmanager
def written_aside(path: str | Path) -> Iterator[Path]:
    """Where to write what shall become ``path``, which is replaced in one step once all is on disk.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    path = Path(path)
    aside = path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}.part")
    try:
        with told_of(path, RuntimeError):  # HDF5's, of a file that cannot be closed
            yield aside
            with aside.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(aside, path)
        sync_names(path.parent)
    finally:
        with suppress(OSError):
            aside.unlink()


@contextmanager
def told_of(path: Path, also: type[Exception] = OSError) -> Iterator[None]:
    """Turn errors of the system, and those of one kind more, into a line that names ``path``.

    Raises:
        PlenoPIVError: a file cannot be written.
    """
    try:
        yield
    except (OSError, also) as error:
        raise PlenoPIVError(f"{path}: cannot be written ({reason(error)})") from None


def reason(error: Exception) -> str:
    """Why a file could not be written, as the system says it."""
    said = getattr(error, "strerror", None) or " ".join(str(error).split())
    number = HDF5_NUMBER.search(said)
    return os.strerror(int(number[1])) if number else said[:200]


def sync_names(folder: Path) -> None:
    """Have the names in a folder on disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
