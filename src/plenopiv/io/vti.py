"""One time of a velocity field as a VTK image file, XML (``.vti``; VTK file formats, docs.vtk.org): ParaView, PyVista.

Points are at vectors, coordinates in mm; ``velocity`` and ``velocity_std`` have three components in m/s. Values are
kept in double precision, compressed. The format has no place for units but in field data: ``units`` there says them.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import printable
from plenopiv.io.aside import written_aside
from plenopiv.io.fields import at_time, even_axes, frame_of, point_arrays, units_of, usual

if TYPE_CHECKING:
    import xarray

TYPES = {"f": "Float", "i": "Int", "u": "UInt"}


def write_vti(path: str | Path, dataset: xarray.Dataset, time: int = 0) -> None:
    """Write one time of a velocity field, dims (time, z, y, x), with all variables; times count from 0.

    Raises:
        PlenoPIVError: there is no such time, vectors are unevenly spaced, or the file cannot be written; nothing is
            left behind.
    """
    field, arrays = at_time(dataset, time), point_arrays(dataset)
    first, spacing, shape = even_axes(dataset)
    header, packed, offset = [], [], 0
    for name, parts in arrays.items():
        values = usual(np.stack([field[part].transpose("z", "y", "x").values for part in parts], -1))
        header.append(_described(name, values, offset))
        packed.append(_packed(values))
        offset += len(packed[-1])
    said = [f"{printable(name)}: {units}" for name, parts in arrays.items() if (units := units_of(dataset[parts[0]]))]
    text = "; ".join(["coordinates: mm", *said, frame_of(dataset)])
    whole = " ".join(f"0 {n - 1}" for n in reversed(shape))
    vectors = ' Vectors="velocity"' if "velocity" in arrays else ""
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        ' compressor="vtkZLibDataCompressor">',
        f'<ImageData WholeExtent="{whole}" Origin="{_row(first)}" Spacing="{_row(spacing)}">',
        "<FieldData>",
        '<DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
        f"{float(field.time.values)!r}</DataArray>",
        '<DataArray type="String" Name="units" NumberOfTuples="1" format="ascii">'
        f"{' '.join(str(code) for code in text.encode())} 0</DataArray>",
        "</FieldData>",
        f'<Piece Extent="{whole}">',
        f"<PointData{vectors}>",
        *header,
        "</PointData>",
        "</Piece>",
        "</ImageData>",
        '<AppendedData encoding="raw">',
    ]
    with written_aside(path) as aside, aside.open("wb") as file:
        file.write("\n".join(lines).encode() + b"\n_")
        file.writelines(packed)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _row(values: tuple[float, ...]) -> str:
    return " ".join(repr(value) for value in values)


def _described(name: str, values: NDArray, offset: int) -> str:
    """The line of an array; ``offset``: where its bytes begin."""
    kind = "UInt8" if values.dtype == bool else f"{TYPES[values.dtype.kind]}{8 * values.dtype.itemsize}"
    parts = values.shape[-1]
    return (
        f'<DataArray type="{kind}" Name={quoteattr(printable(name))} NumberOfComponents="{parts}"'
        f' format="appended" offset="{offset}"/>'
    )


def _packed(values: NDArray) -> bytes:
    """Little-endian bytes, compressed as one block; before it number of blocks, sizes: whole, last partial, packed."""
    content = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
    small = zlib.compress(content, 4)
    return np.array([1, len(content), 0, len(small)], "<u8").tobytes() + small
