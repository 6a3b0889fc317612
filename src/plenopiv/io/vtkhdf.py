"""Velocity fields and volumes for ParaView and PyVista: VTKHDF files of image data (VTK file formats, VTKHDF 2.0).

Points are at vectors or at the centres of voxels, coordinates in mm. Velocity is one array of three components in m/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from plenopiv.errors import PlenoPIVError, printable
from plenopiv.io.aside import hdf5_aside
from plenopiv.io.fields import DIMS, even_axes, frame_of, point_arrays, units_of, variables_of_time
from plenopiv.volume import Volume

if TYPE_CHECKING:
    import h5py
    import xarray

VERSION = (2, 0)  # ImageData of several times begins with it
SLAB = 8  # planes of a volume written at once


def write_vtkhdf(path: str | Path, dataset: xarray.Dataset) -> None:
    """Write a velocity field, dims (time, z, y, x), with all variables; several times as steps.

    Steps ascend; their values are phases where the field has them, else times in s.

    ``velocity`` (three components) and ``velocity_std`` hold u, v, w and their standard deviations in m/s, the other
    variables keep their names.

    Raises:
        PlenoPIVError: two steps have one value, or the file cannot be written; nothing is left behind.
    """
    fields = point_arrays(dataset)
    several = dataset.sizes["time"] > 1  # readers see no time axis in a single step
    first, spacing, shape = even_axes(dataset)
    named = "phase" if "phase" in variables_of_time(dataset) else "time"
    dataset = dataset.isel(time=np.argsort(dataset[named].values, kind="stable"))  # readers search steps by value
    steps = dataset[named].values.astype(float)
    if several and not np.all(np.diff(steps) > 0):
        twice = steps[:-1][~(np.diff(steps) > 0)][0]
        raise PlenoPIVError(
            f"{path}: {named} = {twice:g} is there twice, and VTK tells steps apart by it; export .csv or .mat"
        )
    with _image(path, first, spacing, shape, steps.tolist() if several else None) as points:
        for name, parts in fields.items():
            values = np.stack([dataset[part].transpose(*DIMS).values for part in parts], -1)
            small = np.uint8 if values.dtype == bool else np.float32 if values.dtype == np.float64 else values.dtype
            with np.errstate(over="ignore"):  # what is beyond single precision is infinite in it
                kept = values.astype(small) if several else values.astype(small)[0]
            kept = kept.reshape(*(kept.shape[:several] + _held(shape) or (1,)), kept.shape[-1])
            array = points.create_dataset(printable(name), data=kept, compression="gzip", shuffle=True)
            array.attrs["units"] = units_of(dataset[parts[0]])  # VTK has no place for them and reads past them
        points.parent.attrs["units"], points.parent.attrs["axes"] = "mm", frame_of(dataset)


def write_volume_vtkhdf(path: str | Path, volume: Volume, name: str = "intensity") -> None:
    """Write a reconstructed volume, every voxel of it, some planes at a time; empty voxels take next to no space.

    Raises:
        PlenoPIVError: the file cannot be written; nothing is left behind.
    """
    grid = volume.grid
    nz = grid.shape[0]
    with _image(path, grid.first_mm, grid.voxel_mm, grid.shape) as points:
        held = _held(grid.shape) or (1,)
        chunks = tuple(min(n, most) for n, most in zip(grid.shape, (1, 256, 1024), strict=True) if n > 1) or None
        out = points.create_dataset(name, held, np.float32, chunks=chunks, compression="gzip", compression_opts=1)
        for lo in range(0, nz, SLAB):
            hi = min(lo + SLAB, nz)
            if nz > 1:
                out[lo:hi] = volume.slab(lo, hi).reshape(hi - lo, *held[1:])
            else:
                out[...] = volume.slab(lo, hi).reshape(held)


def _held(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The axes of a grid that arrays have in the file: readers want none along which there is one point alone."""
    return tuple(n for n in shape if n > 1)


@contextmanager
def _image(
    path: str | Path,
    first: Sequence[float],
    spacing: Sequence[float],
    shape: tuple[int, int, int],
    steps: Sequence[float] | None = None,
) -> Iterator[h5py.Group]:
    """The group of a new file's point data; the file takes its name when it is whole."""
    import h5py

    with hdf5_aside(path) as aside, h5py.File(aside, "w") as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = VERSION
        root.attrs.create("Type", np.bytes_("ImageData"))
        root.attrs["WholeExtent"] = [0, shape[2] - 1, 0, shape[1] - 1, 0, shape[0] - 1]
        root.attrs["Origin"], root.attrs["Spacing"] = np.array(first, float), np.array(spacing, float)
        root.attrs["Direction"] = np.eye(3).ravel()
        points = root.create_group("PointData")
        yield points
        if steps is not None:
            _add_steps(root, points, np.asarray(steps, float))


def _add_steps(root: h5py.Group, points: h5py.Group, times_s: np.ndarray) -> None:
    """Say that the arrays' first axis is time."""
    group = root.create_group("Steps")
    group.attrs["NSteps"] = times_s.size
    group["Values"] = times_s
    offsets = group.create_group("PointDataOffsets")
    for name in points:
        offsets[name] = np.arange(times_s.size)
