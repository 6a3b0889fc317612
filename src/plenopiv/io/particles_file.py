"""The particles of one frame with their tracks, as a series of frames keeps them: what the next frame begins with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.io.netcdf import COMPRESSED, loaded, write_dataset

if TYPE_CHECKING:
    import xarray

AXES, OF_LIGHT = ("axis", "axis_2"), ("parameter", "parameter_2")
DIMENSIONS = {
    "position_mm": ("obs", "axis"),
    "light": ("obs",),
    "covariance": ("obs", *OF_LIGHT),
    "misfit": ("obs",),
    "information": ("obs", *AXES),
    "pull": ("obs", "axis"),
    "track": ("obs",),
}


def write_particles(path: str | Path, values: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
    """Write arrays by their names in ``DIMENSIONS``, and numbers besides, as netCDF4; replaced in one step.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    import xarray as xr

    dataset = xr.Dataset({name: (DIMENSIONS[name], each) for name, each in values.items()}, attrs=dict(facts))
    packed = [name for name, variable in dataset.data_vars.items() if variable.size]
    write_dataset(path, dataset, {name: dict(COMPRESSED) for name in packed})


def read_particles(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """What ``write_particles`` wrote.

    Raises:
        PlenoPIVError: it is damaged.
    """
    import xarray

    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False) as dataset:
        values: xarray.Dataset = loaded(path, dataset)
    return {str(name): values[name].values for name in DIMENSIONS}, dict(values.attrs)
