"""velocity.nc of a series: an HDF5 virtual data set over one file a pair, which any reader of HDF5 opens as one.

The files of the pairs lie in ``pairs/`` beside it and are named by relative paths: move or copy the folder as a whole.
A pair without a file is NaN, and its integers (``valid``) are 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.io.aside import written_aside

if TYPE_CHECKING:
    import xarray

DIMS = ("time", "z", "y", "x")


def pair_file(number: int) -> str:
    """Name of the file of a pair, from 0, in the results folder."""
    return f"pairs/pair-{number:04d}.nc"


def write_series(
    path: Path, like: xarray.Dataset, times_s: Sequence[float], files: Mapping[int, str], attributes: Mapping[str, Any]
) -> None:
    """Write ``path`` over ``files`` by the number of their pair, relative to its folder; they need not be there yet.

    ``like``: the field of one of the pairs, all others have its grid and variables. ``times_s``: of all pairs.

    Raises:
        PlenoPIVError: the file cannot be written.
    """
    import h5netcdf
    import h5py

    sizes = {"time": len(times_s), **{axis: like.sizes[axis] for axis in DIMS[1:]}}
    with written_aside(path) as aside:
        with h5netcdf.File(aside, "w") as file:
            file.dimensions = sizes
            file.attrs.update(dict(like.attrs) | dict(attributes))
            for name in DIMS:
                values = np.asarray(times_s, float) if name == "time" else like[name].values
                axis = file.create_variable(name, (name,), values.dtype, values)
                axis.attrs.update(like[name].attrs)
        with h5py.File(aside, "r+") as file:
            for variable_name, variable in like.data_vars.items():
                _virtual(file, str(variable_name), variable, tuple(sizes.values()), files)


def _virtual(
    file: Any, name: str, variable: xarray.DataArray, shape: tuple[int, ...], files: Mapping[int, str]
) -> None:
    """A virtual data set (time, z, y, x) of the first time in each of ``files``, without a date in it."""
    from h5py import Dataset, h5d, h5p, h5s, h5t  # h5py's own function for it dates the file

    one = (1, *shape[1:])
    made = h5p.create(h5p.DATASET_CREATE)
    made.set_obj_track_times(False)
    real = variable.dtype.kind == "f"
    made.set_fill_value(np.array(np.nan if real else 0, variable.dtype))
    whole, source = h5s.create_simple(shape), h5s.create_simple(one)
    for number in sorted(files):
        whole.select_hyperslab((number, 0, 0, 0), one)
        made.set_virtual(whole, files[number].encode(), name.encode(), source)
    kind = h5t.py_create(variable.dtype, logical=True)
    data = Dataset(h5d.create(file.id, name.encode(), kind, h5s.create_simple(shape), made))
    if real:
        data.attrs["_FillValue"] = np.array([np.nan], variable.dtype)
    for key, value in variable.attrs.items():
        data.attrs[key] = value
    for axis, dimension in enumerate(DIMS):
        data.dims[axis].attach_scale(file[dimension])


def open_series(path: Path) -> xarray.Dataset:
    """The fields of a results folder's velocity.nc, read from disk as they are asked for; its times in s as numbers."""
    import xarray

    return xarray.open_dataset(path, engine="h5netcdf", decode_times=False)
