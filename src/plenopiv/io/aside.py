"""A file that is whole or not there: written aside, then renamed."""

from __future__ import annotations

import os
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
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield aside
        with aside.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(aside, path)
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with suppress(FileNotFoundError):
            aside.unlink()
