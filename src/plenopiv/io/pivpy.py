"""A plane of vectors for pivpy (https://github.com/alexlib/pivpy): netCDF with u, v and ``chc`` on (y, x, t).

pivpy reads OpenPIV's text too, but takes its flag 0 and its mask 0, measured and seen, for invalid: each vector of a
whole field would be. In netCDF ``chc`` is 1 where a vector was measured and 0 where it was replaced or is not there.
pivpy's accessors write what they compute, vorticity for example, into a variable ``w``; so the component along z is
``velocity_z`` here, which they leave alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.errors import printable
from plenopiv.io.fields import frame_of, plane_at
from plenopiv.io.netcdf import COMPRESSED, write_dataset

if TYPE_CHECKING:
    import xarray

DIMS = ("y", "x", "t")
NAMES = {"u": "u", "v": "v", "w": "velocity_z", "u_std": "u_std", "v_std": "v_std", "w_std": "velocity_z_std"}
MEANING = "1 measured, 0 replaced by a fit to neighbours or not there"


def as_pivpy(dataset: xarray.Dataset, z_mm: float) -> xarray.Dataset:
    """The plane of vectors nearest to ``z_mm`` of a velocity field (``io.read_velocity``), at all of its times.

    Dims (y, x, t): x, y in mm, t in s; u, v and velocity_z in m/s, NaN where there is no vector, with their standard
    deviations; ``chc`` 1 where measured. The attribute ``z_mm`` is the depth of the plane, ``delta_t`` in s.

    Raises:
        PlenoPIVError: ``z_mm`` is outside the field.
    """
    plane = plane_at(dataset, z_mm)
    z = float(plane.z)
    measured = (plane.valid == 1) & np.isfinite(plane.u) & np.isfinite(plane.v)
    held = {name: new for name, new in NAMES.items() if name in plane}
    found = plane[list(held)].assign(chc=measured.astype(float).assign_attrs(long_name=MEANING))
    found = found.rename(held | {"time": "t"}).drop_vars("z").transpose(*DIMS)
    for variable in found.variables.values():
        texts = {key: variable.attrs.get(key) for key in ("units", "long_name")}
        variable.attrs = {key: printable(text) for key, text in texts.items() if isinstance(text, str)}
    dt_s = dataset.attrs.get("dt_s")
    delta_t = float(dt_s) if isinstance(dt_s, int | float | np.number) else 0.0
    found.attrs = {"z_mm": z, "delta_t": delta_t, "axes": frame_of(dataset)}
    return found


def write_pivpy(path: str | Path, dataset: xarray.Dataset, z_mm: float) -> None:
    """Write that plane as netCDF4.

    Raises:
        PlenoPIVError: as ``as_pivpy``; or the file cannot be written, and nothing is left behind.
    """
    plane = as_pivpy(dataset, z_mm)
    write_dataset(path, plane, dict.fromkeys(plane.data_vars, COMPRESSED))
