"""What the user reads when an input cannot be used: one line, exit code 2, no traceback."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path


class PlenoPIVError(Exception):
    """Bad input. The message is one line that names the file, key or frame and the way out."""


def check_positive(of: str, **lengths: float) -> None:
    """Raises PlenoPIVError for one of the ``lengths`` (by name) of something that is not positive and finite."""
    for name, value in lengths.items():
        if not 0 < value < inf:
            raise PlenoPIVError(f"{of}: {name} = {value}, give a positive number")


@contextmanager
def told_of(path: Path) -> Iterator[None]:
    """Turn errors of the system into a line that names ``path``.

    Raises:
        PlenoPIVError: a file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be written ({error.strerror or error})") from None


class PlenoPIVWarning(UserWarning):
    """The run goes on, but the user should know; repeated in ``summary.json`` and the report."""


def brief(error: Exception) -> str:
    """What a library raised, on one line of at most 100 characters."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def printable(text: str) -> str:
    """Text on one line as a terminal and a figure may show it: escape codes, line ends and bytes of no encoding, which
    a file's name or tags may hold, become "?"."""
    return "".join(c if c.isprintable() else "?" for c in text)
