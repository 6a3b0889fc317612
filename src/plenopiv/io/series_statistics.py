"""Statistics of the fields of a results folder, a few times in memory at once; statistics.nc."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from plenopiv.errors import PlenoPIVError
from plenopiv.io.beside import VELOCITY
from plenopiv.io.netcdf import DIMS, loaded, opened_velocity, shapes_in, write_dataset
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
    return bool(shapes_in(path, [*"xyz", *(f"{name}_{what}" for name in "uvw" for what in ("mean", "rms"))]))


def fields_of(results: str | Path) -> Iterator[tuple[int, int, xarray.Dataset]]:
    """(pair, number of pairs, field) of each time of a results folder's velocity.nc, or of such a file; a field has a
    time of length one. Not more than ``BLOCK_BYTES`` of them, or one, are in memory.

    Raises:
        PlenoPIVError: missing, damaged, or no velocity field.
    """
    path = velocity_file(results)
    with opened_velocity(path) as dataset:
        if "pairs" in dataset:
            raise PlenoPIVError(
                f"{path}: is of ensembles, means over the pairs of a phase or of all; give the results of plenopiv run"
            )
        wanted = [name for name in ("u", "v", "w", "u_std", "v_std", "w_std", "valid") if name in dataset]
        wanted += ["inside_body"] if "inside_body" in dataset else []
        fields, pairs = dataset[wanted].transpose(*DIMS), dataset.sizes["time"]
        together = max(1, int(BLOCK_BYTES * pairs / max(fields.nbytes, 1)))
        for first in range(0, pairs, together):
            block = loaded(path, fields.isel(time=slice(first, first + together)))
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
