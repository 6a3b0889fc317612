"""A plane of vectors as OpenPIV's tools read it: text columns x, y, u, v, flags, mask.

OpenPIV has two frames. That of its images counts y and v downward, rows from above. Its *physical* frame, to which
``transform_coordinates`` leads, keeps rows from above but counts y and v upward. Here rows also come from above; x, y
in mm and u, v in m/s are those of the object frame, y up, so they are in OpenPIV's physical frame and must not be
transformed again. Flags: 0 measured, 2 replaced; mask: 1 where no view sees.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plenopiv.io.aside import written_aside
from plenopiv.io.fields import at_time, frame_of, plane_at

if TYPE_CHECKING:
    import xarray

MEASURED, REPLACED = 0, 2


class OpenPIVField(NamedTuple):
    """Arrays (ny, nx), the first row at the top: places in mm, velocities in m/s, ``flags`` and ``mask``."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    flags: NDArray[np.int64]
    mask: NDArray[np.int64]


def as_openpiv(dataset: xarray.Dataset, z_mm: float, time: int = 0) -> OpenPIVField:
    """The plane of vectors of a velocity field (``io.read_velocity``) nearest to ``z_mm``, at one of its times.

    Raises:
        PlenoPIVError: ``z_mm`` is outside the field, or there is no such time.
    """
    plane = at_time(plane_at(dataset, z_mm), time).transpose("y", "x").sortby("y", ascending=False)
    x, y = np.meshgrid(plane.x.values, plane.y.values)
    u, v = (plane[c].values.astype(float) for c in "uv")
    unseen = ~(np.isfinite(u) & np.isfinite(v))
    flags = np.where(plane.valid.values.astype(bool), MEASURED, REPLACED)
    return OpenPIVField(x, y, np.where(unseen, 0.0, u), np.where(unseen, 0.0, v), flags, unseen.astype(np.int64))


def write_openpiv(path: str | Path, dataset: xarray.Dataset, z_mm: float, time: int = 0) -> None:
    """Write that plane as a text file.

    Raises:
        PlenoPIVError: as ``as_openpiv``; or the file cannot be written, and nothing is left behind.
    """
    columns = np.column_stack([values.ravel() for values in as_openpiv(dataset, z_mm, time)])
    units = f"x, y in mm, u, v in m/s at z = {float(plane_at(dataset, z_mm).z):g} mm; {frame_of(dataset)}"
    flags = "flags: 0 measured, 2 replaced; mask: 1 not there (pivpy takes these for the opposite: export .nc for it)"
    formats = ["%.6e"] * 4 + ["%d"] * 2
    with written_aside(path) as aside:
        np.savetxt(aside, columns, fmt=formats, delimiter="\t", header=f"x\ty\tu\tv\tflags\tmask\n{units}\n{flags}")
