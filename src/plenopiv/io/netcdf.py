"""velocity.nc: written aside and renamed, so that a file of that name is always whole."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from plenopiv.errors import PlenoPIVError
from plenopiv.io.aside import written_aside

if TYPE_CHECKING:
    import xarray

REQUIRED = ("u", "v", "w", "valid")


def write_velocity(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write a velocity field, dims (time, z, y, x), as compressed netCDF4 (deflate with byte shuffle).

    Any file of that name is replaced in one step, after the new one is complete and on disk.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    compressed = {"zlib": True, "complevel": 4, "shuffle": True}
    encoding = {name: compressed for name, variable in dataset.data_vars.items() if variable.ndim > 0}
    with written_aside(path) as aside:
        dataset.to_netcdf(aside, engine="h5netcdf", encoding=encoding)


def read_velocity(path: str | Path) -> xarray.Dataset:
    """The velocity field of a file, loaded into memory and the file closed.

    Raises:
        PlenoPIVError: missing, damaged, or without u, v, w and valid on (time, z, y, x).
    """
    import xarray

    path = Path(path)
    if not path.is_file():
        raise PlenoPIVError(f"{path}: no such file; plenopiv run writes velocity.nc")
    try:
        with xarray.open_dataset(path, engine="h5netcdf") as dataset:
            loaded = dataset.load()
    except Exception as error:  # HDF5, netCDF and decoding each fail in their own way
        raise PlenoPIVError(
            f"{path}: is no velocity file or is damaged ({' '.join(str(error).split())[:100]})"
        ) from None
    missing = [name for name in REQUIRED if name not in loaded]
    if missing:
        raise PlenoPIVError(f"{path}: has no {', '.join(missing)}, so it is no velocity field of plenopiv")
    if loaded["u"].dims != ("time", "z", "y", "x"):
        raise PlenoPIVError(f"{path}: u has dimensions {loaded['u'].dims}, wanted ('time', 'z', 'y', 'x')")
    return loaded
