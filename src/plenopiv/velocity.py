"""Displacements in voxels to velocities in the object frame: m/s on coordinates in mm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import VoxelGrid

if TYPE_CHECKING:
    import xarray as xr

_DIMS = ("time", "z", "y", "x")


def velocity_m_s(displacement: NDArray[np.float64], grid: VoxelGrid, dt_s: float) -> NDArray[np.float64]:
    """Velocity (3, nz, ny, nx) in m/s of a ``displacement`` (3, nz, ny, nx) in voxels of ``grid`` per ``dt_s``.

    Raises ``PlenoPIVError`` when ``dt_s`` is not positive.
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise PlenoPIVError(f"recording.dt_s: {dt_s} is no time between frames; give a positive number of seconds")
    return displacement * np.reshape(grid.voxel_mm, (3, 1, 1, 1)) * (1e-3 / dt_s)


def velocity_dataset(field: DisplacementField, grid: VoxelGrid, dt_s: float, time_s: float = 0.0) -> xr.Dataset:
    """One velocity field as an xarray Dataset with dims (time, z, y, x), time of length one.

    Coordinates x, y, z in mm in the object frame (z = 0 the focal plane, +z toward the camera), vectors at their
    mid-time positions; ``time_s`` the mid-time of the two frames. Variables: u, v, w in m/s after replacement; u_raw,
    v_raw, w_raw as the last pass measured them; u_std, v_std, w_std in m/s, the standard deviations of u, v, w; valid
    (int8, 1 = measured, 0 = replaced); peak_ratio.
    """
    import xarray as xr

    variables: dict = {}
    for suffix, text, voxels in (
        ("", "after replacement of outliers", field.displacement),
        ("_raw", "as the last correlation pass measured it", field.raw),
    ):
        for name, axis, values in zip("uvw", "xyz", velocity_m_s(voxels, grid, dt_s), strict=True):
            attributes = {"units": "m s-1", "long_name": f"velocity along {axis}, {text}"}
            if not suffix:
                attributes["ancillary_variables"] = f"{name}_std valid"  # CF 1.11, section 3.4
            variables[name + suffix] = (_DIMS, values[None], attributes)
    for name, axis, values in zip("uvw", "xyz", velocity_m_s(field.std, grid, dt_s), strict=True):
        attributes = {
            "units": "m s-1",
            "long_name": f"standard deviation of the velocity along {axis}",
            "comment": "scatter of the particles in the window and flow that the window does not resolve;"
            " without errors common to both frames",
        }
        variables[f"{name}_std"] = (_DIMS, values[None], attributes)
    variables["valid"] = (
        _DIMS,
        field.valid[None].astype(np.int8),
        {
            "long_name": "measured or replaced",
            "standard_name": "status_flag",
            "flag_values": np.array([0, 1], np.int8),
            "flag_meanings": "replaced measured",
        },
    )
    variables["peak_ratio"] = (
        _DIMS,
        field.peak_ratio[None].astype(np.float32),
        {"units": "1", "long_name": "highest correlation peak over the second highest"},
    )

    meaning = {"x": "to the right as the camera sees", "y": "up as the camera sees", "z": "toward the camera"}
    coordinates: dict = {
        "time": (
            "time",
            [float(time_s)],
            {
                "units": "s",
                "long_name": "mid-time of the two frames, from the first frame of the recording",
                "axis": "T",
            },
        )
    }
    for axis, index, first, voxel in zip("xyz", (field.x, field.y, field.z), grid.first_mm, grid.voxel_mm, strict=True):
        attributes = {"units": "mm", "long_name": f"{axis}, {meaning[axis]}", "axis": axis.upper()}
        coordinates[axis] = (axis, first + voxel * np.asarray(index, float), attributes)
    return xr.Dataset(
        variables,
        coordinates,
        {
            "Conventions": "CF-1.11",
            "title": "Volumetric velocity from one plenoptic camera",
            "source": "PlenoPIV, 3D cross-correlation with window deformation",
            "dt_s": float(dt_s),
        },
    )
