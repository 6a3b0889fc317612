"""velocity.nc of a series, put together from the files of its pairs as they are on disk, one after the other.

A pair without a file is NaN and ``valid`` 0; flags of the grid are those of all pairs. The file holds all fields
itself: a virtual data set over the files of the pairs would take no space, but HDF5 opens all of them to read a
variable, and gives fill values without a word for those beyond the system's limit of open files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.errors import PlenoPIVError
from plenopiv.io.aside import hdf5_aside
from plenopiv.io.netcdf import COMPRESSED, DIMS

if TYPE_CHECKING:
    import xarray

OF_THE_GRID = "inside_body", "near_focus", "near_face"  # flags that are the same at all times


def pair_file(number: int) -> str:
    """Name of the file of a pair, from 0, in the results folder."""
    return f"pairs/pair-{number:04d}.nc"


def write_series(
    path: Path,
    like: xarray.Dataset,
    times: Mapping[str, Sequence[float]],
    files: Mapping[int, Path],
    attributes: Mapping[str, Any],
) -> None:
    """Write ``path`` from the ``files`` of pairs by their number; one field is in memory at a time.

    ``like``: the field of one of the pairs, all others have its grid and variables. ``times``: "time" of all pairs in
    s, and by name what ``like`` has of its time alone.

    Raises:
        PlenoPIVError: the file cannot be written, or that of a pair not be read.
    """
    import h5netcdf
    import h5py

    shape = tuple(like.sizes[axis] for axis in DIMS[1:])
    fields = [name for name, variable in like.data_vars.items() if variable.ndim == len(DIMS)]
    with hdf5_aside(path) as aside:
        with h5netcdf.File(aside, "w") as file:
            file.dimensions = {"time": len(times["time"]), **dict(zip(DIMS[1:], shape, strict=True))}
            file.attrs.update(dict(like.attrs) | dict(attributes))
            for axis in DIMS:
                values = np.asarray(times["time"], float) if axis == "time" else like[axis].values
                made = file.create_variable(axis, (axis,), values.dtype, values)
                made.attrs.update(like[axis].attrs)
            for axis in [name for name in times if name != "time"]:
                made = file.create_variable(axis, ("time",), like[axis].dtype, np.asarray(times[axis]))
                made.attrs.update({key: value for key, value in like[axis].attrs.items() if key != "_FillValue"})
            for name in fields:
                kind = like[name].dtype
                filled = {"fillvalue": kind.type(np.nan)} if kind.kind == "f" else {}  # else HDF5's own, which is 0
                made = file.create_variable(str(name), DIMS, kind, chunks=(1, *shape), **filled, **COMPRESSED)
                made.attrs.update({key: value for key, value in like[name].attrs.items() if key != "_FillValue"})
        aside.check()
        with h5py.File(aside, "r+") as file:
            for name in [name for name in OF_THE_GRID if name in like]:
                for number in sorted(set(range(len(times["time"]))) - set(files)):
                    file[name][number] = like[name].values[0]
            for number in sorted(files):
                _copy(files[number], file, [str(name) for name in fields], number)
                aside.check()


def _copy(path: Path, into: Any, names: Sequence[str], number: int) -> None:
    """Copy the fields of a pair, compressed as they are where both files have them in one piece."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            for name in names:
                source, out = file[name], into[name]
                piece = source.chunks == out.chunks and source.dtype == out.dtype
                if piece and [source.compression, source.shuffle] == [out.compression, out.shuffle]:
                    mask, content = source.id.read_direct_chunk((0, 0, 0, 0))
                    out.id.write_direct_chunk((number, 0, 0, 0), content, mask)
                else:
                    out[number] = source[0]
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise PlenoPIVError(f"{path}: cannot be read ({' '.join(str(error).split())[:100]})") from None


def open_series(path: Path) -> xarray.Dataset:
    """The fields of a results folder's velocity.nc, read from disk as they are asked for; its times in s as numbers."""
    import xarray

    return xarray.open_dataset(path, engine="h5netcdf", decode_times=False)
