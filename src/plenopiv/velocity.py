"""Displacements in voxels to velocities in the object frame, m/s on coordinates in mm, and what turns in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from plenopiv.displacement.field import DisplacementField
from plenopiv.errors import PlenoPIVError
from plenopiv.volume import VoxelGrid

if TYPE_CHECKING:
    import xarray as xr

Frame = Literal["camera", "laboratory"]
_DIMS = ("time", "z", "y", "x")
_OF_CAMERA = {"x": "to the right as the camera sees", "y": "up as the camera sees", "z": "toward the camera"}

OF_TRACKS = "divergence_free"  # attribute that fields of particle tracks have, and no others


def velocity_m_s(displacement: NDArray[np.float64], grid: VoxelGrid, dt_s: float) -> NDArray[np.float64]:
    """Velocity (3, nz, ny, nx) in m/s of a ``displacement`` (3, nz, ny, nx) in voxels of ``grid`` per ``dt_s``.

    Raises ``PlenoPIVError`` when ``dt_s`` is not positive.
    """
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise PlenoPIVError(f"recording.dt_s: {dt_s} is no time between frames; give a positive number of seconds")
    return displacement * np.reshape(grid.voxel_mm, (3, 1, 1, 1)) * (1e-3 / dt_s)


def velocity_dataset(
    field: DisplacementField,
    grid: VoxelGrid,
    dt_s: float,
    time_s: float = 0.0,
    frame: Frame = "camera",
    near_focus: NDArray[np.bool_] | None = None,
    near_face: NDArray[np.bool_] | None = None,
    title: str = "Volumetric velocity",
) -> xr.Dataset:
    """One velocity field as an xarray Dataset with dims (time, z, y, x), time of length one.

    Coordinates x, y, z in mm in the ``frame`` of the camera (z = 0 the focal plane, +z toward the camera) or in that of
    the laboratory, vectors at their mid-time positions; ``time_s`` the mid-time of the two images. Variables: u, v, w
    in m/s after replacement; u_raw, v_raw, w_raw before (``DisplacementField.raw``); u_std, v_std, w_std in m/s, the
    standard deviations of u, v, w; valid (int8, 1 = measured, 0 = replaced); peak_ratio; where a body was named
    inside_body (int8), 1 where the window lies more than half in it: all others are then NaN, and valid is 0; with
    ``near_focus`` (nz, ny, nx) near_focus (int8), 1 where much of a window has hardly any depth, and with ``near_face``
    (nz, ny, nx) near_face (int8), 1 where windows reach to the volume's front or back. ``title``: what it is, and of
    which cameras.
    """
    import xarray as xr

    variables: dict = {}
    for suffix, text, voxels in (
        ("", "after replacement of outliers", field.displacement),
        ("_raw", "before replacement of windows", field.raw),
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
        {
            "units": "1",
            "long_name": "highest correlation peak over the second highest",
            "comment": "of sub-windows the inverse of the mean inverse",
        },
    )
    for name, flags, meaning in (
        ("near_focus", near_focus, "window reaches far into focus, where displacements in depth may be biased"),
        ("near_face", near_face, "window at the volume's front or back, where displacements in depth may be biased"),
    ):
        if flags is not None:
            variables[name] = (
                _DIMS,
                flags[None].astype(np.int8),
                {
                    "long_name": meaning,
                    "standard_name": "status_flag",
                    "flag_values": np.array([0, 1], np.int8),
                    "flag_meanings": f"beyond {name}",
                },
            )
    if field.solid is not None:
        variables["inside_body"] = (
            _DIMS,
            field.solid[None].astype(np.int8),
            {
                "long_name": "window more than half in the solid body, not measured",
                "standard_name": "status_flag",
                "flag_values": np.array([0, 1], np.int8),
                "flag_meanings": "in_fluid inside_body",
            },
        )

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
        meaning = "in the laboratory" if frame == "laboratory" else _OF_CAMERA[axis]
        attributes = {"units": "mm", "long_name": f"{axis}, {meaning}", "axis": axis.upper()}
        coordinates[axis] = (axis, first + voxel * np.asarray(index, float), attributes)
    return xr.Dataset(
        variables,
        coordinates,
        {
            "Conventions": "CF-1.11",
            "title": title,
            "source": "PlenoPIV, 3D cross-correlation with window deformation",
            "dt_s": float(dt_s),
            "frame": frame,
        },
    )


def of_tracks(field: xr.Dataset) -> bool:
    """Whether a field is one of particle tracks, not of windows: its standard deviations are flow that tracks do not
    resolve, for the most part, no random errors that scatter from field to field."""
    return OF_TRACKS in field.attrs


def replaced(field: xr.Dataset) -> xr.DataArray:
    """Which vectors of a field were replaced: those that are not valid, without those that lie in a body or belong to a
    pair that was set aside."""
    return (field["valid"] != 1) & field["u"].notnull()


def vectors_inside_body(field: xr.Dataset) -> int | None:
    """How many vectors were not measured because they lie in a body; None where none was named."""
    return int((field["inside_body"] == 1).sum()) if "inside_body" in field else None


def replaced_share(field: xr.Dataset) -> float:
    """Share of the vectors that were replaced, without those in a body or of pairs that were set aside."""
    return float(replaced(field).sum()) / max(int(field["u"].notnull().sum()), 1)


def velocity_gradient(field: xr.Dataset) -> NDArray[np.float64]:
    """Velocity gradient G[i, j] = du_i / dx_j in 1/s, (3, 3, nz, ny, nx), i and j in the order x, y, z.

    ``field``: u, v, w in m/s on (z, y, x), evenly or unevenly spaced coordinates in mm. Central differences, second
    order at the faces too where an axis has three points; NaN vectors make their neighbours' derivatives NaN, and have
    none themselves.

    Raises:
        PlenoPIVError: an axis with a single vector.
    """
    import xarray as xr

    if not isinstance(field, xr.Dataset) or set(field["u"].dims) != set(_DIMS[1:]):
        raise PlenoPIVError("velocity gradient: wanted one field on (z, y, x); choose a time with isel(time=0)")
    short = [axis for axis in "xyz" if field.sizes[axis] < 2]
    if short:
        raise PlenoPIVError(f"velocity gradient: one vector along {', '.join(short)}, and no derivative without two")
    gradient = np.empty((3, 3, *(field.sizes[axis] for axis in _DIMS[1:])))
    for i, name in enumerate("uvw"):
        values = field[name].transpose(*_DIMS[1:]).values.astype(float)
        for j, axis in enumerate("xyz"):
            place = field[axis].values * 1e-3
            gradient[i, j] = np.gradient(values, place, axis=2 - j, edge_order=2 if place.size > 2 else 1)
        gradient[i][:, np.isnan(values)] = np.nan  # a body is no fluid, thin as it may be
    return gradient


def vorticity(gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vorticity (3, ...) in 1/s, along x, y, z, of a velocity gradient (3, 3, ...)."""
    g = gradient
    return np.stack([g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]])


def q_criterion(gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Q = (|W|^2 - |S|^2) / 2 in 1/s^2 of a velocity gradient (3, 3, ...), W and S its spin and strain.

    Positive where a flow turns more than it deforms (Hunt, Wray & Moin 1988, Eddies, streams, and convergence zones in
    turbulent flows, CTR-S88). |W|^2 - |S|^2 = -G_ij G_ji, whatever the divergence.
    """
    return -0.5 * np.einsum("ij...,ji...->...", gradient, gradient)
