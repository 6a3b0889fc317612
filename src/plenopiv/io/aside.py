"""A file that is whole or not there: written aside, then renamed."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from plenopiv.errors import PlenoPIVError


@contextmanager
def written_aside(path: str | Path) -> Iterator[Path]:
    """Where to write what shall become ``path``, which is replaced in one step once all is on disk.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    path = Path(path)
    aside = path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}.part")
    try:
        yield aside
        with aside.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(aside, path)
        sync_names(path.parent)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with suppress(FileNotFoundError):
            aside.unlink()


def sync_names(folder: Path) -> None:
    """Have the names in a folder on disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
