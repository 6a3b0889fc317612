"""Where compiled code is kept: one file for each function and signature, named by a hash of all that it depends on.

A file never changes, so that versions, clones and machines share a folder, and nothing is lost where two processes
write at once. One process compiles a function, others wait for its file (``fcntl.flock``, where there is one, and at
most ``PATIENCE_S``). Files that no process has read for ``KEPT_DAYS`` are removed by the next one that writes.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import time
import uuid
import warnings
from pathlib import Path
from types import FunctionType
from typing import IO, Any

from numba import config

from plenopiv.errors import PlenoPIVWarning
from plenopiv.kernels.fingerprint import fingerprint
from plenopiv.kernels.sources import Unknown

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

ENDING = ".kernel"
PATIENCE_S = 120.0
KEPT_DAYS = 60.0
DAY_S = 86400.0
DIGEST = hashlib.sha256().digest_size
done_once: set[str] = set()  # in this process


def folder() -> Path:
    """Numba's, where one is set (``NUMBA_CACHE_DIR``); else the user's."""
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR) / "plenopiv"
    return _own_folder() / "kernels"


def _own_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "plenopiv"


class Store:
    """The compiled code of one function."""

    def __init__(self, function: FunctionType, options: dict[str, Any]) -> None:
        self.function, self.options = function, options
        self.paths: dict[Any, Path | None] = {}  # of signatures
        self.locks: dict[Any, IO[bytes]] = {}

    def path(self, signature: Any, machine: Any) -> Path | None:
        """Where its code for a signature is, or would be; None where that cannot be told."""
        try:
            name = fingerprint(self.function, self.options, signature, machine)
        except Unknown:
            return None
        title = re.sub(r"[^\w.]+", "-", f"{self.function.__module__}.{self.function.__qualname__}")
        return folder() / f"{title[-120:]}-{name}{ENDING}"

    def load(self, signature: Any, machine: Any) -> bytes | None:
        """What is kept for a signature. None: the caller compiles, calls ``save``, and in any case ``release``."""
        path = self.paths[signature] = self.path(signature, machine)
        if path is None:
            return None
        data = _read(path)
        if data is None and (lock := _lock(path)) is not None:
            data = _read(path)  # another process may have made it meanwhile
            if data is None:
                self.locks[signature] = lock
            else:
                lock.close()
        return data

    def save(self, signature: Any, data: bytes) -> None:
        """Keep compiled code under the hash that ``load`` made, before it was compiled."""
        path = self.paths.get(signature)
        if path is None:
            return
        try:
            _write(path, data)
        except OSError as error:
            if "warned" not in done_once:
                done_once.add("warned")
                way_out = "name a folder in NUMBA_CACHE_DIR"
                warnings.warn(
                    f"compiled code cannot be kept, each run compiles anew ({error}): {way_out}",
                    PlenoPIVWarning,
                    stacklevel=2,
                )
            return
        if "swept" not in done_once:
            done_once.add("swept")
            sweep()

    def release(self, signature: Any) -> None:
        """Let other processes compile it, if it is not kept by now."""
        if (lock := self.locks.pop(signature, None)) is not None:
            with contextlib.suppress(OSError):
                os.unlink(lock.name)
            lock.close()

    def flush(self) -> None:
        """Remove the files that this process has read or written."""
        for path in self.paths.values():
            if path is not None:
                path.unlink(missing_ok=True)


def _read(path: Path) -> bytes | None:
    try:
        data = path.read_bytes()
        if time.time() - path.stat().st_mtime > DAY_S:
            os.utime(path)  # in use
    except OSError:
        return None
    return data[DIGEST:] if hashlib.sha256(data[DIGEST:]).digest() == data[:DIGEST] else None


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(f".{uuid.uuid4().hex[:16]}.tmp")
    try:
        unfinished.write_bytes(hashlib.sha256(data).digest() + data)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _lock(path: Path) -> IO[bytes] | None:
    """The right to make a file; None where there are no locks, or its owner takes too long."""
    if fcntl is None:
        return None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open(path.with_suffix(".lock"), "ab")  # noqa: SIM115 (closed by release)
    except OSError:
        return None
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() > until:
                break
            time.sleep(0.02)
        except OSError:  # no locks on this file system
            break
    file.close()
    return None


def sweep() -> None:
    """Remove what has not been in use for long, and folders of versions that had one for each of their states."""
    now = time.time()
    with contextlib.suppress(OSError):
        for path in folder().iterdir():
            days = KEPT_DAYS if path.suffix == ENDING else 1.0
            if path.suffix in (ENDING, ".tmp", ".lock") and now - path.stat().st_mtime > days * DAY_S:
                path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        for path in _own_folder().iterdir():
            if re.fullmatch("[0-9a-f]{16}", path.name) and now - path.stat().st_mtime > KEPT_DAYS * DAY_S:
                shutil.rmtree(path, ignore_errors=True)
