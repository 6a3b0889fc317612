"""Statistics of the fields of a results folder, a few times in memory at once; statistics.nc."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.errors import PlenoPIVError, brief
from plenopiv.hdf5 import contradiction, damage
from plenopiv.io.beside import VELOCITY, unfinished, warn_of_others
from plenopiv.io.netcdf import DIMS, check_velocity, write_dataset
from plenopiv.statistics import Phases, PhaseStatistics, SeriesStatistics

if TYPE_CHECKING:
    import xarray

BLOCK_BYTES = 32 << 20  # read at once: each read of a file takes some milliseconds
STATISTICS, BY_PHASE = "statistics.nc", "phase-statistics.nc"


def velocity_file(results: str | Path) -> Path:
    """velocity.nc of a results folder, or the file itself."""
    path = Path(results)
    return path / VELOCITY if path.is_dir() else path


def holds_statistics(path: Path) -> bool:
    """Whether a file is one of statistics, and can be opened."""
    import h5py

    try:
        if damage(path, netcdf=True):
            return False
        with h5py.File(path, "r") as file:
            return all(f"{name}_rms" in file for name in "uvw")
    except (OSError, ValueError, AttributeError):
        return False


def fields_of(results: str | Path) -> Iterator[tuple[int, int, xarray.Dataset]]:
    """(pair, number of pairs, field) of each time of a results folder's velocity.nc, or of such a file; a field has a
    time of length one. Not more than ``BLOCK_BYTES`` of them, or one, are in memory.

    Raises:
        PlenoPIVError: missing, damaged, or no velocity field.
    """
    import xarray

    path = velocity_file(results)
    try:
        wrong = damage(path, netcdf=True) if path.is_file() else None
    except (OSError, ValueError):  # a name that none can have
        wrong = None
    if wrong is None:
        raise PlenoPIVError(f"{path}: no such file; {unfinished(path.parent) or f'plenopiv run writes {VELOCITY}'}")
    warn_of_others(path)
    if wrong:
        raise PlenoPIVError(f"{path}: is no velocity file or is damaged ({wrong[:100]})")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of attributes that are not ours
            opened = xarray.open_dataset(path, engine="h5netcdf", decode_times=False)
    except Exception as error:  # HDF5, netCDF and decoding each fail in their own way
        raise PlenoPIVError(f"{path}: is no velocity file or is damaged ({brief(error)})") from None
    with opened as dataset:
        if wrong := contradiction(dataset.variables):
            raise PlenoPIVError(f"{path}: is no velocity file or is damaged ({wrong})")
        check_velocity(path, dataset)
        if "pairs" in dataset:
            raise PlenoPIVError(
                f"{path}: is of ensembles, means over the pairs of a phase or of all; give the results of plenopiv run"
            )
        wanted = [name for name in ("u", "v", "w", "u_std", "v_std", "w_std", "valid") if name in dataset]
        wanted += ["inside_body"] if "inside_body" in dataset else []
        fields, pairs = dataset[wanted].transpose(*DIMS), dataset.sizes["time"]
        together = max(1, int(BLOCK_BYTES * pairs / max(fields.nbytes, 1)))
        for first in range(0, pairs, together):
            try:
                block = fields.isel(time=slice(first, first + together)).load()
            except (OSError, RuntimeError, ValueError) as error:
                last = min(first + together, pairs) - 1
                raise PlenoPIVError(f"{path}: pairs {first} to {last} cannot be read ({brief(error)})") from None
            for k in range(block.sizes["time"]):
                yield first + k, pairs, block.isel(time=[k])


def statistics_of(
    results: str | Path,
    phases: Phases | None = None,
    bins: int = 8,
    progress: Callable[[str, int, int], None] | None = None,
    **options: float,
) -> xarray.Dataset:
    """Statistics of all pairs of a results folder, or of its velocity.nc; by phase where ``phases`` are given.

    ``options``: those of ``SeriesStatistics`` (``lags``, ``replaced``, ``error_bars``).

    Raises:
        PlenoPIVError: the fields cannot be read, no vector counts, or ``phases`` name a pair that is not there.
    """
    statistics: SeriesStatistics | PhaseStatistics | None = None
    for pair, pairs, field in fields_of(results):
        if statistics is None:
            if phases is not None:
                phases.check(pairs)
                statistics = PhaseStatistics(field, phases, bins, **options)  # type: ignore[arg-type]
            else:
                statistics = SeriesStatistics(field, **options)  # type: ignore[arg-type]
        if isinstance(statistics, PhaseStatistics):
            statistics.add(field, pair)
        else:
            statistics.add(field)
        if progress:
            progress("statistics", pair + 1, pairs)
    assert statistics is not None  # a file of no times is none of velocities
    found = statistics.result()
    if not int(found["samples"].max()):
        raise PlenoPIVError(f"{velocity_file(results)}: no vector counts, every pair is left out or replaced")
    return found


def write_statistics(path: str | Path, statistics: xarray.Dataset) -> None:
    """Write statistics as compressed netCDF4, in one step.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    compressed = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding = {name: compressed for name, variable in statistics.data_vars.items() if variable.ndim > 0}
    write_dataset(path, statistics, encoding)
