"""HDF5 and netCDF4 files that this program need not have written: tried in a child process before they are opened.

The HDF5 library does not return from some damaged files, or ends the process. So a child opens the file first, with a
limit of time and of memory: 0.3 s for a file that is as it should be.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

START_S = 120.0  # that a child may take in all: Python's own start on a busy machine is most of it
TRY_S, WAIT_S = 3, 90  # of it for the file: of the processor (256 MB take 1 s), and of the clock, as a disk may be busy
CHILD = Path(__file__).with_name("child.py")
REFUSED, TOO_LONG = 3, 1  # exit codes of the child


def damage(path: Path, netcdf: bool = False) -> str:
    """What is wrong with an HDF5 file, a few words; "" where a child process could read it.

    ``netcdf``: opened as netCDF4 too. A file is tried once, as long as it is not changed. Files of less than 256 MB of
    data are read whole, of others the headers. Without a Python to run (a program that embeds it) nothing is tried.

    Raises:
        OSError: there is no such file.
    """
    stat = path.stat()
    return _damage(str(path.resolve()), netcdf, stat.st_size, stat.st_mtime_ns) if sys.executable else ""


def contradiction(variables: Mapping[Any, Any]) -> str:
    """Where variables, each with ``dims`` and ``shape``, differ in the length of a dimension, a few words; "" where
    they do not. Libraries that read netCDF find that out when they compute with them."""
    lengths: dict[str, tuple[str, int]] = {}
    for name, variable in variables.items():
        for dimension, length in zip(variable.dims, variable.shape, strict=True):
            first, stated = lengths.setdefault(str(dimension), (str(name), length))
            if length != stated:
                return f"{name} has {length} values along {dimension}, {first} {stated}"
    return ""


@lru_cache(maxsize=100_000)
def _damage(path: str, netcdf: bool, size: int, changed_ns: int) -> str:
    command = [sys.executable, "-P", str(CHILD), path, "netcdf" if netcdf else "hdf5", str(TRY_S), str(WAIT_S)]
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_USE_FILE_LOCKING": "FALSE"}
    try:
        ended = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=alone,
            timeout=START_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"nothing was read of it in {START_S:.0f} s"
    if ended.returncode == 0:
        return ""
    if ended.returncode == REFUSED:
        return ended.stdout.decode("utf-8", "replace").strip() or "it cannot be read"
    if ended.returncode == TOO_LONG:
        return f"it was not read within {WAIT_S} s: a busy disk, or a network's? run again"
    if sys.platform != "win32" and ended.returncode == -signal.SIGXCPU:
        return f"HDF5 does not come back from it within {TRY_S} s"
    return "HDF5 crashes on it"
