"""Open one HDF5 file and read it: a program of its own, which may crash. ``plenopiv.hdf5`` runs it and says what came
of it. Arguments: file, "hdf5" or "netcdf", seconds of the processor, seconds in all. Exit code 0: whole; 3: not, why is
printed; 1: out of time; ended by SIGXCPU: out of the processor's."""

from __future__ import annotations

import faulthandler
import os
import sys
from contextlib import suppress
from math import ceil, prod
from typing import Any

MEMORY = 1 << 30  # bytes beyond those of the libraries
READ = 256 << 20  # bytes of all data sets together up to which they are read
SPARE = 100 << 20  # bytes that the data of any file may have, and times its size:
PACKED = {"netcdf": 200, "hdf5": 1100}  # the first are loaded whole, frames one by one; deflate packs 1030 to 1


class DamageError(Exception):
    """What is wrong, in a few words."""


def _limit_memory() -> None:
    if sys.platform == "win32":
        return
    import resource

    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))


def _limit_time(seconds: float) -> None:
    """Of the processor, which a library that does not return uses up; a busy machine and a slow disk only wait."""
    if sys.platform == "win32":
        return
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    most = ceil(used.ru_utime + used.ru_stime + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # what ends it leaves no file behind


def _datasets(file: Any) -> list[Any]:
    """All data sets, their attributes and those of groups once read."""
    import h5py

    found = []

    def visit(name: str, item: Any) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset):
            found.append(item)

    dict(file.attrs)
    file.visititems(visit)
    return found


def read(path: str, kind: str) -> None:
    """Open a file, look at all that is in it, and read its data where they are few.

    Raises:
        DamageError: the data are more than a file of its size can hold.
        Exception: whatever the libraries raise.
    """
    import h5py

    allowed = SPARE + PACKED[kind] * os.path.getsize(path)
    with h5py.File(path, "r") as file:
        datasets = _datasets(file)
        sizes = [prod(d.shape or (1,)) * d.dtype.itemsize for d in datasets]
        if sum(sizes) > allowed:
            raise DamageError(f"it states {sum(sizes) / 1e9:.3g} GB of data, more than it can hold")
        if sum(sizes) <= READ:
            for dataset in datasets:
                dataset[()]
    if kind == "netcdf":
        import h5netcdf

        with h5netcdf.File(path, "r") as file:
            for variable in file.variables.values():
                dict(variable.attrs)
                _ = variable.dimensions, variable.shape, variable.dtype


def main(path: str, kind: str, seconds: str, in_all: str) -> int:
    """Exit code."""
    import h5netcdf  # noqa: F401  the limits are those of the file, not of what loads
    import h5py  # noqa: F401

    with suppress(OSError):  # a system without /proc
        _limit_memory()
        _limit_time(float(seconds))
    faulthandler.dump_traceback_later(float(in_all), exit=True)
    try:
        read(path, kind)
    except Exception as error:
        what = str(error) if isinstance(error, DamageError) else f"{type(error).__name__}: {error}"
        print(" ".join(what.split())[:100])
        return 3
    return 0


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(code)  # at once: what a library does on its way out may crash as well
