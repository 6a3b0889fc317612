"""velocity.nc: written aside and renamed, so that a file of that name is always whole."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.errors import PlenoPIVError
from plenopiv.hdf5 import contradiction, damage
from plenopiv.io.aside import hdf5_aside
from plenopiv.io.beside import unfinished, warn_of_others

if TYPE_CHECKING:
    import xarray

REQUIRED = ("u", "v", "w", "valid")
DIMS = ("time", "z", "y", "x")
COMPRESSED = {"compression": "gzip", "compression_opts": 4, "shuffle": True}


def write_velocity(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write a velocity field, dims (time, z, y, x), as compressed netCDF4 (deflate with byte shuffle).

    Any file of that name is replaced in one step, after the new one is complete and on disk.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    encoding = {
        name: {**COMPRESSED, "chunksizes": (1, *variable.shape[1:])}
        for name, variable in dataset.data_vars.items()
        if variable.ndim > 0
    }
    write_dataset(path, dataset, encoding)


def write_dataset(path: str | Path, dataset: xarray.Dataset, encoding: Mapping[Any, Mapping[str, Any]]) -> None:
    """Write a dataset as netCDF4, with xarray's ``encoding`` of its variables.

    Raises:
        PlenoPIVError: as ``write_velocity``.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    with hdf5_aside(path) as aside, h5netcdf.File(aside, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file), encoding=dict(encoding))


def read_velocity(path: str | Path) -> xarray.Dataset:
    """The velocity field of a file, loaded into memory and the file closed; its time in s as a number.

    Raises:
        PlenoPIVError: missing, damaged, or without numbers u, v, w and valid on (time, z, y, x), or without finite,
            rising coordinates of these.
    """
    with opened_velocity(path) as dataset:
        return loaded(path, dataset)


@contextmanager
def opened_velocity(path: str | Path) -> Iterator[xarray.Dataset]:
    """The velocity field of a file, which stays open; values are read where they are asked for, with ``loaded``.

    Raises:
        PlenoPIVError: as ``read_velocity``.
    """
    import xarray

    path = Path(path)
    try:
        wrong = damage(path, netcdf=True) if path.is_file() else None
    except (OSError, ValueError):  # a name that none can have
        wrong = None
    if wrong is None:
        raise PlenoPIVError(f"{path}: no such file; {unfinished(path.parent) or 'plenopiv run writes velocity.nc'}")
    warn_of_others(path)
    try:
        if wrong:
            raise ValueError(wrong)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of attributes that are not ours
            dataset = xarray.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False)
    except Exception as error:
        raise _damaged(path, error) from None
    with dataset:
        check_velocity(path, dataset)
        yield dataset


def loaded(path: str | Path, dataset: xarray.Dataset) -> xarray.Dataset:
    """A dataset, or the part of one, of the open file ``path`` in memory.

    Raises:
        PlenoPIVError: the file is damaged there.
    """
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            values = dataset.load()
        if wrong := contradiction(values.variables):
            raise ValueError(wrong)
    except Exception as error:
        raise _damaged(path, error) from None
    return values


def _damaged(path: str | Path, error: Exception) -> PlenoPIVError:
    """HDF5, netCDF and decoding each fail in their own way."""
    return PlenoPIVError(f"{path}: is no velocity file or is damaged ({' '.join(str(error).split())[:100]})")


def shapes_in(path: Path, names: Sequence[str]) -> list[tuple[int, ...]]:
    """Shapes of the variables ``names`` of a netCDF file; none where it does not hold all of them, or is damaged."""
    import h5py

    try:
        if damage(path, netcdf=True):
            return []
        with h5py.File(path, "r") as file:
            return [file[name].shape for name in names] if all(name in file for name in names) else []
    except (OSError, ValueError, AttributeError):
        return []


def check_velocity(path: Path, dataset: xarray.Dataset) -> None:
    """Raise PlenoPIVError for a dataset, opened from ``path``, that is no velocity field."""
    missing = [name for name in REQUIRED if name not in dataset]
    if missing:
        raise PlenoPIVError(f"{path}: has no {', '.join(missing)}, so it is no velocity field of plenopiv")
    for name in REQUIRED:
        variable = dataset[name]
        if variable.dims != DIMS:
            raise PlenoPIVError(f"{path}: {name} has dimensions {variable.dims}, wanted {DIMS}")
        if variable.dtype.kind not in "biuf":
            raise PlenoPIVError(f"{path}: {name} holds {variable.dtype} values, wanted numbers")
        if not variable.size:
            raise PlenoPIVError(f"{path}: {name} holds no vectors {variable.shape}")
    for axis in DIMS:
        if axis not in dataset.coords or dataset[axis].dims != (axis,) or dataset[axis].dtype.kind not in "iuf":
            raise PlenoPIVError(f"{path}: has no coordinate {axis} of numbers, so it is no velocity field of plenopiv")
        values = dataset[axis].values.astype(float)
        if not np.isfinite(values).all() or (axis != "time" and (np.diff(values) <= 0).any()):
            raise PlenoPIVError(f"{path}: its coordinate {axis} is not finite and rising; the file is damaged")
