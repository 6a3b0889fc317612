"""The results folder: complete or untouched.

Files are written into a hidden folder beside their destination and moved into place together when the run has ended
well, ``summary.json`` last. A run that fails or is interrupted leaves the folder as it found it.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from plenopiv.errors import PlenoPIVError, told_of
from plenopiv.io.aside import moved
from plenopiv.io.lock import FolderLock
from plenopiv.io.made_folders import MadeFolders

STAGE_LOCK = "lock"
COMPLETE = ("velocity.nc", "summary.json")  # moved last, in this order; both there = a complete run


class OutputFolder:
    """Stage files, then move them into ``directory`` all together.

        with OutputFolder(experiment.output_directory, overwrite) as out:
            write_velocity(out.path("velocity.nc"), dataset)
            out.write_json("summary.json", summary)

    Files already in the folder stay unless one of the same name replaces them.

    Raises:
        PlenoPIVError: on entering, so before any computation: the folder holds a complete run and ``overwrite`` is
            False, is a file, or cannot be written.
    """

    def __init__(self, directory: str | Path, overwrite: bool = False):
        self.directory = Path(directory)
        self.overwrite = overwrite
        self._stage: Path | None = None
        self._lock: FolderLock | None = None
        self._made = MadeFolders()

    def __enter__(self) -> OutputFolder:
        if self.directory.exists() and not self.directory.is_dir():
            raise PlenoPIVError(f"{self.directory}: is a file; name a folder")
        if not self.overwrite and all((self.directory / name).exists() for name in COMPLETE):
            raise PlenoPIVError(f"{self.directory}: holds a complete run; use --overwrite, or another output.directory")
        try:
            self._made.make(self.directory)
            sweep_stages(self.directory)
            self._stage, self._lock = made_stage(self.directory)
        except OSError as error:
            self._remove_stage()
            raise PlenoPIVError(f"{self.directory}: cannot be written ({error.strerror})") from None
        return self

    def __exit__(self, kind: type[BaseException] | None, *failure: object) -> None:
        try:
            if kind is None:
                self._move()
                self._made.keep()
        finally:
            self._remove_stage()

    def path(self, name: str) -> Path:
        """Where to write a file, or make a folder of files, that shall become ``directory / name``."""
        assert self._stage is not None, "use OutputFolder in a with statement"
        return self._stage / name

    def write_text(self, name: str, text: str) -> None:
        """Stage a text file (UTF-8)."""
        self.write_bytes(name, text.encode())

    def write_bytes(self, name: str, content: bytes) -> None:
        """Stage a file.

        Raises:
            PlenoPIVError: it cannot be written, as on a full disk.
        """
        with told_of(self.directory / name):
            self.path(name).write_bytes(content)

    def write_json(self, name: str, content: dict[str, Any]) -> None:
        """Stage a JSON file; numpy values become numbers and lists, NaN and infinities null."""
        self.write_text(name, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")

    def _move(self) -> None:
        assert self._stage is not None
        names = [path.relative_to(self._stage) for path in sorted(self._stage.rglob("*")) if path.is_file()]
        names.remove(Path(STAGE_LOCK))
        staged = sorted(names, key=lambda name: COMPLETE.index(str(name)) if str(name) in COMPLETE else -1)
        try:
            for name in staged:
                with (self._stage / name).open("rb") as file:
                    os.fsync(file.fileno())
                (self.directory / name).parent.mkdir(exist_ok=True, parents=True)
            if any(str(name) in COMPLETE for name in staged):
                # Between the moves the folder must not pass for a complete run.
                (self.directory / COMPLETE[-1]).unlink(missing_ok=True)
            for name in staged:
                moved(self._stage / name, self.directory / name)
        except OSError as error:
            raise PlenoPIVError(f"{self.directory}: cannot be written ({error.strerror})") from None

    def _remove_stage(self) -> None:
        if self._stage is not None and self._lock is not None:
            self._lock.__exit__()
            shutil.rmtree(self._stage, ignore_errors=True)
            self._stage = None
        self._made.remove()


def made_stage(folder: Path, prefix: str = ".plenopiv-") -> tuple[Path, FolderLock]:
    """A new temporary folder in ``folder``, locked until the lock is given back or the process ends.

    Raises:
        OSError: it cannot be made.
    """
    stage = Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
    try:
        return stage, FolderLock(stage / STAGE_LOCK).__enter__()
    except BaseException:
        shutil.rmtree(stage, ignore_errors=True)
        raise


def sweep_stages(folder: Path, prefix: str = ".plenopiv-") -> None:
    """Remove the temporary folders that killed processes left in ``folder``."""
    for stage in folder.glob(f"{prefix}*"):
        if (stage / STAGE_LOCK).is_file():
            with suppress(PlenoPIVError), FolderLock(stage / STAGE_LOCK, tries=1):
                shutil.rmtree(stage, ignore_errors=True)


def plain(value: Any) -> Any:
    """The same content in JSON's types."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
