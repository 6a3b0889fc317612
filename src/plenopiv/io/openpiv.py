"""A plane of vectors as OpenPIV's tools read it: text columns x, y, u, v, flags, mask.

OpenPIV has two frames. That of its images counts y and v downward, rows from above. Its *physical* frame, to which
``transform_coordinates`` leads, keeps rows from above but counts y and v upward. Here rows also come from above; x, y
in mm and u, v in m/s are those of the object frame, y up, so they are in OpenPIV's physical frame and must not be
transformed again. Flags: 0 measured, 2 replaced; mask: 1 where no view sees.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.io.aside import written_aside
from plenopiv.io.fields import at_time, frame_of, plane_at

if TYPE_CHECKING:
    import xarray

MEASURED, REPLACED = 0, 2


def as_openpiv(dataset: xarray.Dataset, z_mm: float, time: int = 0) -> xarray.Dataset:
    """The plane of vectors of a velocity field (``io.read_velocity``) nearest to ``z_mm``, at one of its times.

    On (y, x), the first row at the top: u, v in m/s, 0 where there is no vector, ``flags`` and ``mask``.

    Raises:
        PlenoPIVError: ``z_mm`` is outside the field, or there is no such time.
    """
    plane = at_time(plane_at(dataset, z_mm), time).transpose("y", "x").sortby("y", ascending=False)
    unseen = ~(np.isfinite(plane.u) & np.isfinite(plane.v))
    found = plane[["u", "v"]].astype(float).where(~unseen, 0.0)
    flags = plane.valid.astype(bool).astype(np.int64) * (MEASURED - REPLACED) + REPLACED
    return found.assign(flags=flags, mask=unseen.astype(np.int64))


def write_openpiv(path: str | Path, dataset: xarray.Dataset, z_mm: float, time: int = 0) -> None:
    """Write that plane as a text file.

    Raises:
        PlenoPIVError: as ``as_openpiv``; or the file cannot be written, and nothing is left behind.
    """
    plane = as_openpiv(dataset, z_mm, time)
    held = [*np.meshgrid(plane.x, plane.y), *(plane[name].values for name in ("u", "v", "flags", "mask"))]
    columns = np.column_stack([values.ravel() for values in held])
    units = f"x, y in mm, u, v in m/s at z = {float(plane.z):g} mm; {frame_of(dataset)}"
    flags = "flags: 0 measured, 2 replaced; mask: 1 not there (pivpy takes these for the opposite: export .nc for it)"
    formats = ["%.6e"] * 4 + ["%d"] * 2
    with written_aside(path) as aside:
        np.savetxt(aside, columns, fmt=formats, delimiter="\t", header=f"x\ty\tu\tv\tflags\tmask\n{units}\n{flags}")
