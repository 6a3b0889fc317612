"""Reconstructed volumes kept on disk: voxels that are not empty, read back bit for bit.

An HDF5 file of two lists, packed with byte shuffle and deflate. ``intensity``: float32, of the voxels in the order
z, y, x (x fastest). ``step``: uint16, how many voxels each lies after the one before it in that order, the first one
after -1; 0 stands for 65535 empty voxels. Attributes: ``origin_mm`` and ``voxel_mm`` (x, y, z), ``shape`` (nz, ny, nx).
Of a volume in lens space a third list, ``to_laboratory`` (terms, 3), is the polynomial that carries it to the
laboratory, with the attributes of ``Polynomial`` and those of the laboratory's grid.

What it takes a voxel, beside dense VTKHDF: docs/decisions/0038-kept-volumes.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from plenopiv.cameras.space_map import Polynomial, powers
from plenopiv.errors import PlenoPIVError, brief
from plenopiv.hdf5 import damage
from plenopiv.io.aside import hdf5_aside
from plenopiv.reconstruction.resampling import resampled
from plenopiv.volume import SparseVolume, Volume, VoxelGrid

if TYPE_CHECKING:
    import xarray

Content = TypeVar("Content")
TO_LABORATORY, MOST_DEGREE = "to_laboratory", 20
FORMAT, VERSION = b"PlenoPIV volume", 1
LIBRARY = "v110"  # of HDF5: its headers have check sums, and are short
BLOCK = 1 << 18  # voxels of a chunk, and handled at once
SKIP = 65535  # empty voxels of a step 0
LARGEST_SIDE, MOST_ROWS = 65535, 1 << 28  # of a grid: a row's columns are uint16, its start takes 8 bytes


class Laboratory(NamedTuple):
    """Where a volume of lens space lies in the laboratory: the polynomial that carries it there, and the grid of the
    velocity field."""

    map: Polynomial
    grid: VoxelGrid


def write_volume(path: str | Path, volume: SparseVolume, laboratory: Laboratory | None = None) -> None:
    """Write the voxels of a volume; the same volume makes the same bytes. ``laboratory``: of one in lens space.

    Raises:
        PlenoPIVError: the file cannot be written; nothing is left behind.
    """
    import h5py

    grid, count = volume.grid, volume.values.size
    packed: dict[str, Any] = {"compression": "gzip", "compression_opts": 6, "shuffle": True}
    with (
        hdf5_aside(path) as aside,
        h5py.File(aside, "w", libver=(LIBRARY, LIBRARY), rdcc_nbytes=16 * BLOCK, meta_block_size=512) as file,
    ):
        file.attrs["format"], file.attrs["version"] = np.bytes_(FORMAT), VERSION
        _write_grid(file.attrs, grid)
        if laboratory is not None:
            mapped = file.create_dataset(TO_LABORATORY, data=np.array(laboratory.map.coefficients, float))
            mapped.attrs["centre_mm"], mapped.attrs["half_mm"] = laboratory.map.centre_mm, laboratory.map.half_mm
            mapped.attrs["degree"] = laboratory.map.degree
            _write_grid(mapped.attrs, laboratory.grid)
        sizes = {"step": count + _skips(volume), "intensity": count}
        for (name, size), kind in zip(sizes.items(), (np.uint16, np.float32), strict=True):
            chunks = {"chunks": (min(size, BLOCK),)} | packed if size else {}
            file.create_dataset(name, (size,), kind, **chunks)
        written = 0
        for low, steps in _steps(volume):
            file["step"][written : written + steps.size] = steps
            written += steps.size
            file["intensity"][low : low + BLOCK] = volume.values[low : low + BLOCK]


def read_volume(path: str | Path, known: bool = False) -> SparseVolume:
    """The volume of a file that ``write_volume`` made, bit for bit. ``known``: its hash is known to be right, and it
    need not be tried in another process first.

    Raises:
        PlenoPIVError: missing, damaged, or another file.
    """
    return _read(path, known, _volume)


def as_xarray(volume: Volume) -> xarray.DataArray:
    """A reconstructed volume, every voxel of it, float32 on (z, y, x) in mm: four bytes a voxel of memory."""
    import xarray

    grid = volume.grid
    x, y, z = grid.axes()
    axes = {name: (name, values, {"units": "mm"}) for name, values in (("z", z), ("y", y), ("x", x))}
    return xarray.DataArray(volume.slab(0, grid.shape[0]), axes, ("z", "y", "x"), "intensity")


def volume_in_laboratory(path: str | Path) -> SparseVolume:
    """The same on the grid of the velocity field: a volume of lens space is carried to the laboratory.

    Raises:
        PlenoPIVError: as ``read_volume``.
    """

    def both(file: Any) -> tuple[SparseVolume, Laboratory | None]:
        return _volume(file), _laboratory(file)

    volume, laboratory = _read(path, False, both)
    return volume if laboratory is None else resampled(volume, laboratory.map, laboratory.grid)


def _read(path: str | Path, known: bool, content: Callable[[Any], Content]) -> Content:
    """The ``content`` of a file, tried first where it is not ``known``."""
    import h5py

    path = Path(path)
    try:
        wrong = ("" if known else damage(path)) if path.is_file() else None
    except (OSError, ValueError):  # a name that none can have
        wrong = None
    if wrong is None:
        raise PlenoPIVError(f"{path}: no such file; a run with output.volumes = true keeps volumes")
    try:
        if wrong:
            raise ValueError(wrong)
        with h5py.File(path, "r") as file:
            return content(file)
    except Exception as error:  # HDF5 fails in many ways
        why = str(error) if type(error) is ValueError else brief(error)
        raise PlenoPIVError(f"{path}: is no volume of plenopiv or is damaged ({' '.join(why.split())[:100]})") from None


def _places(volume: SparseVolume, low: int, high: int) -> NDArray[np.int64]:
    """Where the listed voxels low <= n < high lie among all voxels of the grid."""
    start = volume.row_start
    first = int(np.searchsorted(start, low, side="right")) - 1
    last = int(np.searchsorted(start, high, side="left"))
    inside = np.clip(start[first : last + 1], low, high)
    counts = inside[1:] - inside[:-1]
    return np.repeat(np.arange(first, last), counts) * volume.grid.shape[2] + volume.column[low:high]


def _steps(volume: SparseVolume) -> Iterator[tuple[int, NDArray[np.uint16]]]:
    """Steps of so many voxels at a time, from which one on."""
    before = -1
    for low in range(0, volume.column.size, BLOCK):
        places = _places(volume, low, min(low + BLOCK, volume.column.size))
        gaps = np.diff(places, prepend=before)
        skips = (gaps - 1) // SKIP
        steps = (gaps - skips * SKIP).astype(np.uint16)
        before = int(places[-1])
        yield low, np.insert(steps, np.repeat(np.arange(steps.size), skips), 0)


def _skips(volume: SparseVolume) -> int:
    """How many steps 0 a volume takes: between rows only, which are at most that long."""
    start, nx = volume.row_start, volume.grid.shape[2]
    rows = np.flatnonzero(np.diff(start))
    first = rows * nx + volume.column[start[rows]]
    last = rows * nx + volume.column[start[rows + 1] - 1]
    return int(((first - np.concatenate([[-1], last[:-1]]) - 1) // SKIP).sum()) if rows.size else 0


def _write_grid(attributes: Any, grid: VoxelGrid) -> None:
    attributes["origin_mm"] = np.array(grid.first_mm, float)
    attributes["voxel_mm"] = np.array(grid.voxel_mm, float)
    attributes["shape"] = np.array(grid.shape, np.int64)


def _laboratory(file: Any) -> Laboratory | None:
    """Where an open file's volume lies in the laboratory; None of one that is not in lens space.

    Raises:
        ValueError: the map is none.
    """
    if TO_LABORATORY not in file:
        return None
    mapped, terms = file[TO_LABORATORY].attrs, file[TO_LABORATORY][:].astype(float)
    degree = int(mapped["degree"])
    centre, half = (np.asarray(mapped[name], float).ravel() for name in ("centre_mm", "half_mm"))
    if not (0 <= degree <= MOST_DEGREE and terms.shape == (len(powers(degree)), 3) and centre.size == half.size == 3):
        raise ValueError("its map to the laboratory is none")
    if not (np.isfinite(terms).all() and np.isfinite([*centre, *half]).all() and (half > 0).all()):
        raise ValueError("its map to the laboratory is none")
    (cx, cy, cz), (hx, hy, hz) = centre.tolist(), half.tolist()
    rows = tuple((x, y, z) for x, y, z in terms.tolist())
    return Laboratory(Polynomial((cx, cy, cz), (hx, hy, hz), degree, rows), _grid(mapped))


def _checked(attributes: Any) -> Any:
    """The attributes of a volume's file.

    Raises:
        ValueError: it is another file.
    """
    if attributes.get("format") != FORMAT:
        raise ValueError("it does not say that it is one")
    if attributes["version"] != VERSION:
        raise ValueError(f"its version is {attributes['version']}; this program reads {VERSION}")
    return attributes


def _grid(attributes: Any) -> VoxelGrid:
    """A grid as a file has it.

    Raises:
        ValueError: it is one that there cannot be.
    """
    origin, voxel = (np.asarray(attributes[name], float).ravel() for name in ("origin_mm", "voxel_mm"))
    shape = np.asarray(attributes["shape"]).ravel()
    if (
        not (origin.size == voxel.size == shape.size == 3 and shape.dtype.kind == "i")
        or not (np.isfinite([*origin, *voxel]).all() and (voxel > 0).all())
        or not ((shape > 0).all() and (shape <= LARGEST_SIDE).all() and shape[0] * shape[1] <= MOST_ROWS)
    ):
        raise ValueError("its grid is none")
    (x, y, z), (dx, dy, dz), (nz, ny, nx) = origin.tolist(), voxel.tolist(), shape.tolist()
    return VoxelGrid((x, y, z), (dx, dy, dz), (nz, ny, nx))


def _volume(file: Any) -> SparseVolume:
    """The volume of an open file.

    Raises:
        ValueError: its lists contradict one another or the grid.
    """
    grid = _grid(_checked(file.attrs))
    step, intensity = file["step"], file["intensity"]
    for name, listed, kind in (("step", step, np.uint16), ("intensity", intensity, np.float32)):
        if listed.ndim != 1 or listed.dtype != kind:
            raise ValueError(f"{name} is no list of {np.dtype(kind).name}")
    nz, ny, nx = grid.shape
    values, column = np.empty(intensity.shape, np.float32), np.empty(intensity.shape, np.uint16)
    row_start = np.zeros(nz * ny + 1, np.int64)
    listed, before = 0, -1
    for low in range(0, step.size, BLOCK):
        steps = step[low : low + BLOCK]
        places = before + np.cumsum(np.where(steps == 0, SKIP, steps), dtype=np.int64)
        before = int(places[-1])
        places = places[steps != 0]
        if before >= grid.size or listed + places.size > values.size:
            raise ValueError("it lists more voxels than there are")
        row, column[listed : listed + places.size] = np.divmod(places, nx)
        if row.size:
            row_start[row[0] + 1 : row[-1] + 2] += np.bincount(row - row[0])
        listed += places.size
    if listed != values.size:
        raise ValueError(f"it has {values.size} intensities of {listed} voxels")
    np.cumsum(row_start, out=row_start)
    for low in range(0, values.size, BLOCK):
        values[low : low + BLOCK] = intensity[low : low + BLOCK]
    return SparseVolume(grid, row_start, column, values)
