"""Velocities from netCDF4 files: u, v, w on x, y, z."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.hdf5 import contradiction, damage
from plenopiv.simulation.file_grid import FileGrid, missing_variable

if TYPE_CHECKING:
    import xarray

NUMBERS = "iuf"  # kinds of NumPy types
LARGEST = 1e12  # of a coordinate, in whatever unit
UNEVEN = 1e-3  # of the spacing: what rounding of coordinates to float32 may cost


def read_netcdf(
    path: Path, variables: tuple[str, ...] = (), time: int | None = None, *, ours: bool = False
) -> FileGrid:
    """Velocities on a regular grid from netCDF4: three variables on dimensions x, y, z, in any order.

    ``variables``: the names of u, v, w. ``time``: which one of several along a dimension ``time``. ``ours``: the file
    is known to be whole.

    Raises:
        PlenoPIVError: no netCDF4, other dimensions, missing variables, values that are no numbers, uneven coordinates.
    """
    import xarray

    try:
        if not ours and (wrong := damage(path, netcdf=True)):
            raise ValueError(wrong)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of attributes that are not ours
            with xarray.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
                loaded = dataset.load()
        if wrong := contradiction(loaded.variables):
            raise ValueError(wrong)
    except Exception as error:  # HDF5, netCDF and decoding each fail in their own way
        reason = " ".join(str(error).split())[:100]
        raise PlenoPIVError(f"flow: {path}: is no netCDF4 file or is damaged ({reason})") from None
    names = variables or ("u", "v", "w")
    if len(names) != 3:
        raise PlenoPIVError(f"flow: {path}: variables = {list(names)}; give the three names of u, v, w")
    for name in names:
        if name not in loaded:
            raise PlenoPIVError(f"flow: {path}: {missing_variable(name, [str(v) for v in loaded.data_vars])}")
    components = []
    for name in names:
        component = _at_time(path, loaded[name], time)
        if sorted(map(str, component.dims)) != ["x", "y", "z"]:
            raise PlenoPIVError(f"flow: {path}: {name} has dimensions {tuple(component.dims)}, wanted z, y, x")
        if component.dtype.kind not in NUMBERS:
            raise PlenoPIVError(f"flow: {path}: {name} holds {component.dtype} values, wanted numbers")
        for axis in "xyz":
            if axis not in component.coords:
                raise PlenoPIVError(f"flow: {path}: has no coordinate {axis}; write one with its units")
            if component.coords[axis].dims != (axis,) or component.coords[axis].dtype.kind not in NUMBERS:
                raise PlenoPIVError(f"flow: {path}: its coordinate {axis} is no row of numbers")
        components.append(component.transpose("z", "y", "x").sortby(["z", "y", "x"]))
    one = components[0]
    first, spacing = zip(*(_even(path, axis, one[axis].values) for axis in "xyz"), strict=True)
    return FileGrid(
        path,
        np.stack([c.values for c in components], -1),
        first,
        spacing,
        tuple(_stated(one[axis]) for axis in "xyz"),
        tuple(_stated(c) for c in components),
    )


def _stated(variable: xarray.DataArray) -> str | None:
    """A variable's units, None where it has none."""
    return str(variable.attrs["units"]) if "units" in variable.attrs else None


def _at_time(path: Path, component: xarray.DataArray, time: int | None) -> xarray.DataArray:
    """One time of a variable that has several."""
    if "time" not in component.dims:
        return component
    count = component.sizes["time"]
    if time is None and count > 1:
        raise PlenoPIVError(f"flow: {path}: holds {count} times; give time, 0 for the first")
    if not 0 <= (time or 0) < count:
        raise PlenoPIVError(f"flow: {path}: time = {time}, it holds 0 to {count - 1}")
    return component.isel(time=time or 0)


def _even(path: Path, axis: str, values: NDArray) -> tuple[float, float]:
    """First value and spacing of a coordinate whose values rise evenly."""
    values = np.asarray(values, float)
    if len(values) < 2:
        raise PlenoPIVError(f"flow: {path}: one point along {axis}; a volume is needed")
    if not (np.abs(values) <= LARGEST).all():
        raise PlenoPIVError(f"flow: {path}: {axis} is not finite, or beyond all lengths")
    spacing = float(values[-1] - values[0]) / (len(values) - 1)
    off = float(np.abs(values - values[0] - spacing * np.arange(len(values))).max())
    if not off <= UNEVEN * spacing or spacing <= 0:
        raise PlenoPIVError(
            f"flow: {path}: {axis} is not evenly spaced (off by {off:.3g} at a mean spacing of {spacing:.3g}); "
            "interpolate it onto a regular grid first"
        )
    return float(values[0]), spacing
