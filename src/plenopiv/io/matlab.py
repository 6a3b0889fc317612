"""A velocity field for MATLAB and Octave (MAT-files of version 5, by SciPy).

Arrays are (y, x, z, time), as ``meshgrid(x, y, z)`` has them, so that ``quiver3``, ``slice``, ``curl`` and
``streamline`` take them as they are; x, y, z in mm and time in s are columns, and so is what
there is of a time alone (``phase``). ``valid`` is logical. ``units`` and ``meaning`` have a field for each variable.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plenopiv.errors import PlenoPIVError, printable
from plenopiv.io.aside import written_aside
from plenopiv.io.fields import frame_of, units_of, usual, variables_of, variables_of_time

if TYPE_CHECKING:
    import xarray

ORDER = ("y", "x", "z", "time")
MOST_BYTES = 2**31 - 2**10  # of a variable
NAME = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)
FLAGS = ("valid", "inside_body")


def as_matlab(dataset: xarray.Dataset) -> dict[str, Any]:
    """What the file holds, by name: arrays (ny, nx, nz, nt), coordinates, and the structs ``units`` and ``meaning``."""
    held: dict[str, Any] = {name: dataset[name].values.astype(float) for name in ("x", "y", "z", "time")}
    for name in variables_of(dataset) + variables_of_time(dataset):
        if NAME.fullmatch(name):
            values = usual(dataset[name].transpose(*ORDER, missing_dims="ignore").values)
            held[name] = values == 1 if name in FLAGS else values
    texts = {name: printable(str(dataset[name].attrs.get("long_name", ""))) for name in held}
    units = {name: units_of(dataset[name]) for name in held}
    units |= dict.fromkeys("xyz", "mm") | {"time": "s"}
    return held | {
        "units": units,
        "meaning": texts | {"axes": frame_of(dataset), "order": "arrays are (y, x, z, time)"},
    }


def write_matlab(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write a velocity field, all variables and times.

    Raises:
        PlenoPIVError: a variable is larger than such files may hold, or the file cannot be written; nothing is left
            behind.
    """
    from scipy.io import savemat

    held = as_matlab(dataset)
    for name, values in held.items():
        if isinstance(values, np.ndarray) and values.nbytes > MOST_BYTES:
            raise PlenoPIVError(
                f"{path}: {name} has {values.nbytes / 1e9:.1f} GB, .mat files hold 2 GB a variable;"
                f" in MATLAB read velocity.nc: ncread(file, '{name}')"
            )
    with written_aside(path) as aside, aside.open("wb") as file:
        savemat(file, held, format="5", long_field_names=True, do_compression=True, oned_as="column")
