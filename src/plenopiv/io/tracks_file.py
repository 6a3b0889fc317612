"""tracks.nc, and tracks for ParaView: VTKHDF files of points and lines (VTK file formats, VTKHDF 2.0, PolyData)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError
from plenopiv.io.aside import hdf5_aside
from plenopiv.io.netcdf import COMPRESSED, loaded, shapes_in, write_dataset

if TYPE_CHECKING:
    import xarray

VERSION = (2, 0)
VECTORS = {"velocity": "u v w", "velocity_std": "u_std v_std w_std", "position_std": "x_std y_std z_std"}
OF_SEQUENCES = {"acceleration": "ax ay az", "acceleration_std": "ax_std ay_std az_std"}
SCALARS = "light", "light_std", "misfit", "frame", "track_id"


def write_tracks(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write tracks, dimension obs, as compressed netCDF4; a file of that name is replaced in one step.

    Raises:
        PlenoPIVError: the folder cannot be written, or the disk is full; nothing is left behind.
    """
    numbers = [name for name, variable in dataset.data_vars.items() if variable.dtype.kind in "fi" and variable.size]
    write_dataset(path, dataset, {name: dict(COMPRESSED) for name in numbers})


def read_tracks(path: str | Path) -> xarray.Dataset:
    """The tracks of a file, in memory.

    Raises:
        PlenoPIVError: it is missing, damaged, or holds no tracks.
    """
    import xarray

    path = Path(path)
    if not path.is_file():
        raise PlenoPIVError(f"{path}: no such file; plenopiv track writes tracks.nc")
    if not holds_tracks(path):
        raise PlenoPIVError(f"{path}: is no file of tracks or is damaged")
    with xarray.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False) as dataset:
        return loaded(path, dataset)


def holds_tracks(path: Path) -> bool:
    """Whether a file is one of tracks, and can be opened."""
    wanted = ["track_id", "frame", "x", "y", "z", *" ".join(VECTORS.values()).split()]
    return len(set(shapes_in(path, wanted))) == 1


def write_tracks_vtkhdf(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write tracks for ParaView: a point for each particle of each frame, in mm, a line for each track.

    ``velocity``, ``velocity_std`` (m/s) and ``position_std`` (mm) have three components, and so have ``acceleration``
    and ``acceleration_std`` (m/s^2) of sequences; light, light_std, misfit, frame and track_id are as in tracks.nc.

    Raises:
        PlenoPIVError: the file cannot be written; nothing is left behind.
    """
    import h5py

    points = np.stack([dataset[axis].values for axis in "xyz"], -1).astype(np.float64)
    with hdf5_aside(path) as aside, h5py.File(aside, "w") as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = VERSION
        root.attrs.create("Type", np.bytes_("PolyData"))
        root["NumberOfPoints"] = np.array([len(points)], np.int64)
        root.create_dataset("Points", data=points, **_kept(points))
        alone = np.arange(len(points), dtype=np.int64)
        cells = {"Vertices": (np.arange(len(points) + 1, dtype=np.int64), alone), "Lines": _lines(dataset)}
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            offsets, connected = cells.get(name, (np.zeros(1, np.int64), np.empty(0, np.int64)))
            group = root.create_group(name)
            group["NumberOfCells"] = np.array([len(offsets) - 1], np.int64)
            group["NumberOfConnectivityIds"] = np.array([len(connected)], np.int64)
            group.create_dataset("Offsets", data=offsets)
            group.create_dataset("Connectivity", data=connected, **_kept(connected))
        data = root.create_group("PointData")
        for name, parts in (VECTORS | (OF_SEQUENCES if "ax" in dataset else {})).items():
            values = np.stack([dataset[part].values for part in parts.split()], -1).astype(np.float32)
            data.create_dataset(name, data=values, **_kept(values))
        for name in SCALARS:
            if name in dataset:
                values = dataset[name].values
                data.create_dataset(name, data=values, **_kept(values))


def _kept(values: NDArray) -> dict[str, Any]:
    """How an array is stored; HDF5 compresses none that is empty."""
    return {"compression": "gzip", "shuffle": True} if values.size else {}


def _lines(dataset: xarray.Dataset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each track's line begins in the list of points (tracks + 1,), and that list: a track's by frame."""
    track = dataset["track_id"].values
    order = np.lexsort((dataset["frame"].values, track))
    order = order[track[order] >= 0]
    begins = np.flatnonzero(np.diff(track[order], prepend=-1))
    return np.append(begins, len(order)).astype(np.int64), order.astype(np.int64)
