"""What all files for other programs need of a velocity field: its variables, axes, units, a plane of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, printable

if TYPE_CHECKING:
    import xarray

DIMS = ("time", "z", "y", "x")
VECTORS = {"velocity": ("u", "v", "w"), "velocity_std": ("u_std", "v_std", "w_std")}
EVEN = 1e-4  # of a step, that steps may differ by


def variables_of(dataset: xarray.Dataset) -> list[str]:
    """Names of the variables that have a number for every vector and time."""
    return [str(n) for n, v in dataset.data_vars.items() if set(v.dims) == set(DIMS) and v.dtype.kind in "biuf"]


def variables_of_time(dataset: xarray.Dataset) -> list[str]:
    """Names of the variables that have one number for every time, such as ``phase`` of ensembles."""
    return [str(n) for n, v in dataset.data_vars.items() if v.dims == ("time",) and v.dtype.kind in "biuf"]


def point_arrays(dataset: xarray.Dataset) -> dict[str, tuple[str, ...]]:
    """Arrays as VTK has them, with the variables that are their components: ``velocity``, ``velocity_std``, others."""
    numbers = variables_of(dataset)
    arrays = {name: parts for name, parts in VECTORS.items() if set(numbers).issuperset(parts)}
    taken = {part for parts in arrays.values() for part in parts}
    return arrays | {name: (name,) for name in numbers if name not in taken}


def even_axes(dataset: xarray.Dataset) -> tuple[tuple[float, ...], tuple[float, ...], tuple[int, int, int]]:
    """First point and spacing (x, y, z) in mm, and shape (nz, ny, nx).

    Raises:
        PlenoPIVError: vectors are not evenly spaced along an axis, or it falls.
    """
    first, spacing = [], []
    for name in "xyz":
        values = dataset[name].values.astype(float)
        steps = np.diff(values)
        if steps.size and not (steps > 0).all():
            raise PlenoPIVError(f"{name} falls, images of VTK need rising axes; use dataset.sortby({name!r})")
        if steps.size and np.ptp(steps) > EVEN * steps.mean():
            raise PlenoPIVError(
                f"vectors are not evenly spaced along {name}, as images of VTK need; export .csv or .mat"
            )
        first.append(float(values[0]))
        spacing.append(float(steps.mean()) if steps.size else 1.0)
    shape = dataset.sizes["z"], dataset.sizes["y"], dataset.sizes["x"]
    return tuple(first), tuple(spacing), shape


def usual(values: NDArray) -> NDArray:
    """The same as numbers that all programs know: HDF5 files may hold floats of two or of sixteen bytes."""
    if values.dtype.kind == "f" and values.dtype.itemsize not in (4, 8):
        return values.astype(np.float32 if values.dtype.itemsize < 4 else np.float64)
    return values


def units_of(variable: xarray.DataArray) -> str:
    """As the file states them, "" where it does not."""
    found = variable.attrs.get("units", "")
    return printable(found) if isinstance(found, str) else ""


def frame_of(dataset: xarray.Dataset) -> str:
    """Where x, y, z point, in words."""
    if dataset.attrs.get("frame") == "laboratory":
        return "x, y, z of the laboratory"
    return "x right and y up as the camera sees, z toward the camera"


def at_time(dataset: xarray.Dataset, time: int) -> xarray.Dataset:
    """One time of a field, without that dimension.

    Raises:
        PlenoPIVError: there is no such time.
    """
    if not 0 <= time < dataset.sizes["time"]:
        raise PlenoPIVError(f"time {time}: the field has {dataset.sizes['time']}, numbered from 0")
    return dataset.isel(time=time)


def plane_at(dataset: xarray.Dataset, z_mm: float) -> xarray.Dataset:
    """The plane of vectors nearest to ``z_mm``, without the dimension z.

    Raises:
        PlenoPIVError: ``z_mm`` is outside the field.
    """
    z = dataset.z.values
    half = 0.5 * abs(z[1] - z[0]) if z.size > 1 else 0.5
    if not z.min() - half <= z_mm <= z.max() + half:
        raise PlenoPIVError(f"z = {z_mm:g} mm: vectors lie from z = {z.min():g} to {z.max():g} mm")
    return dataset.sel(z=z_mm, method="nearest")
