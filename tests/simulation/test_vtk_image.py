"""Flows from VTK images in each of the ways in which they are stored."""

import base64
import lzma
import zlib

import numpy as np
import pytest
from simulation.flow_files import FIRST, POINTS, SPACING, grid, linear

from plenopiv.errors import PlenoPIVError
from plenopiv.simulation.flows import flow

MIDDLE = np.array([[-0.1, 1.3, 2.2], [0.4, 2.9, 2.4]])
UNITS = {"length_unit": "mm", "velocity_unit": "m/s"}
PACK = {"vtkZLibDataCompressor": zlib.compress, "vtkLZMADataCompressor": lzma.compress}


def stored(values, header="u4", compressor=None, encoded=True, blocks=3):
    """Bytes behind a header, as the format describes them."""
    data = values.tobytes()
    if compressor is None:
        head = np.array([len(data)], header).tobytes()
        return base64.b64encode(head + data) if encoded else head + data
    size = -(-len(data) // blocks)
    parts = [data[k : k + size] for k in range(0, len(data), size)]
    packed = [PACK[compressor](part) for part in parts]
    last = len(parts[-1]) if len(parts[-1]) != size else 0
    head = np.array([len(parts), size, last, *map(len, packed)], header).tobytes()
    body = b"".join(packed)
    return base64.b64encode(head) + base64.b64encode(body) if encoded else head + body


def vti(path, kind="Float64", form="ascii", order="LittleEndian", word="UInt32", compressor=None, attributes=""):
    """``linear`` as the array "velocity" of an XML image; a scalar goes before it. The extent begins at 2, 3, 4."""
    code = {"LittleEndian": "<", "BigEndian": ">"}[order]
    vector = linear(grid()).reshape(-1, 3).astype(code + {"Float64": "f8", "Float32": "f4"}[kind])
    scalar = np.arange(len(vector)).astype(code + "i4")
    header = code + {"UInt32": "u4", "UInt64": "u8"}[word]
    arrays, appended = b"", b""
    for name, type_name, values in (("number", "Int32", scalar), ("velocity", kind, vector)):
        tag = f'<DataArray type="{type_name}" Name="{name}" NumberOfComponents="{values[0].size}"'
        if form == "ascii":
            text = " ".join(map(repr, values.ravel().tolist())).encode()
            arrays += f'{tag} format="ascii">'.encode() + text + b"</DataArray>"
        elif form == "binary":
            text = stored(values, header, compressor)
            arrays += f'{tag} format="binary">\n  '.encode() + text + b"\n</DataArray>"
        else:
            arrays += f'{tag} format="appended" offset="{len(appended)}"/>'.encode()
            appended += stored(values, header, compressor, encoded=form == "base64")
    begin = np.array([2, 3, 4])
    origin = np.array(FIRST) - begin * SPACING
    extent = " ".join(f"{b} {b + n - 1}" for b, n in zip(begin, POINTS, strict=True))
    packed = f' compressor="{compressor}"' if compressor else ""
    tail = f'<AppendedData encoding="{form}">_'.encode() + appended + b"</AppendedData>" if appended else b""
    path.write_bytes(
        f'<?xml version="1.0"?>\n<VTKFile type="ImageData" byte_order="{order}" header_type="{word}"{packed}>'
        f'<ImageData WholeExtent="{extent}" Origin="{origin[0]} {origin[1]} {origin[2]}" '
        f'Spacing="{SPACING[0]} {SPACING[1]} {SPACING[2]}" {attributes}><Piece Extent="{extent}"><PointData>'.encode()
        + arrays
        + b"</PointData></Piece></ImageData>"
        + tail
        + b"</VTKFile>"
    )
    return str(path)


@pytest.mark.parametrize("form", ["ascii", "binary", "raw", "base64"])
@pytest.mark.parametrize("compressor", [None, "vtkZLibDataCompressor", "vtkLZMADataCompressor"])
@pytest.mark.parametrize(("order", "word"), [("LittleEndian", "UInt32"), ("BigEndian", "UInt64")])
def test_xml_in_every_form(tmp_path, form, compressor, order, word):
    path = vti(tmp_path / "flow.vti", form=form, order=order, word=word, compressor=compressor)
    assert flow("file", path=path, **UNITS)(MIDDLE) == pytest.approx(linear(MIDDLE))


def test_units_must_be_given(tmp_path):
    path = vti(tmp_path / "flow.vti", kind="Float32")
    with pytest.raises(PlenoPIVError, match="states no units for x; give length_unit"):
        flow("file", path=path)
    metres = flow("file", path=path, length_unit="m", velocity_unit="mm/s")
    assert metres(1e3 * MIDDLE) == pytest.approx(1e-3 * linear(MIDDLE), rel=1e-5)


def legacy(path, binary):
    velocity = linear(grid()).reshape(-1, 3)
    number = np.arange(len(velocity), dtype=float)
    sizes = [" ".join(map(str, v)) for v in (POINTS, FIRST, SPACING)]
    head = "# vtk DataFile Version 3.0\na flow\n" + ("BINARY" if binary else "ASCII") + "\nDATASET STRUCTURED_POINTS\n"
    head += f"DIMENSIONS {sizes[0]}\nORIGIN {sizes[1]}\nSPACING {sizes[2]}\n\nPOINT_DATA {len(velocity)}\n"

    def numbers(values):
        return values.astype(">f8").tobytes() if binary else " ".join(map(repr, values.ravel().tolist())).encode()

    path.write_bytes(
        head.encode() + b"SCALARS number double 1\nLOOKUP_TABLE default\n" + numbers(number)
        + b"\nMETADATA\nINFORMATION 0\n\nFIELD FieldData 1\nnumber2 1 %d double\n" % len(number) + numbers(number)
        + b"\nVECTORS velocity double\n" + numbers(velocity) + b"\nMETADATA\nINFORMATION 0\n\n"
    )  # fmt: skip
    return str(path)


@pytest.mark.parametrize("binary", [True, False])
def test_legacy_structured_points(tmp_path, binary):
    path = legacy(tmp_path / "flow.vtk", binary)
    assert flow("file", path=path, **UNITS)(MIDDLE) == pytest.approx(linear(MIDDLE))


def test_arrays_by_name(tmp_path):
    path = vti(tmp_path / "flow.vti")
    assert flow("file", path=path, variables="velocity", **UNITS)(MIDDLE) == pytest.approx(linear(MIDDLE))
    with pytest.raises(PlenoPIVError, match="no variable 'velocit'; did you mean 'velocity'"):
        flow("file", path=path, variables=["velocit"], **UNITS)
    with pytest.raises(PlenoPIVError, match="1 components in all, wanted three"):
        flow("file", path=path, variables=["number"], **UNITS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((b"ImageData", b"RectilinearGrid"), "of the kind RectilinearGrid, wanted ImageData"),
        ((b"<Piece Extent", b'<Piece Extent="0 1 0 1 0 1"/><Piece Extent'), "is in 2 pieces"),
        ((b"<PointData>", b"<PointData><"), "is no VTK image or is damaged"),
        ((b'"ascii">0.2 ', b'"ascii">NaN '), "grid points are NaN"),
        ((b'"Float64"', b'"Float16"'), "is no VTK image or is damaged"),
    ],
)
def test_what_cannot_be_used_is_one_line(tmp_path, change, said):
    path = tmp_path / "flow.vti"
    vti(path)
    content = path.read_bytes()
    assert change[0] in content
    path.write_bytes(content.replace(*change))
    with pytest.raises(PlenoPIVError, match=said) as told:
        flow("file", path=str(path), **UNITS)
    assert str(told.value).startswith(f"flow: {path}: ")
    assert "\n" not in str(told.value)


def test_a_time_of_an_image_is_refused(tmp_path):
    vti(tmp_path / "flow.vti")
    with pytest.raises(PlenoPIVError, match="a VTK image holds one time; leave out time = 7"):
        flow("file", path=str(tmp_path / "flow.vti"), time=7, **UNITS)


def test_turned_axes_are_refused(tmp_path):
    path = vti(tmp_path / "flow.vti", attributes='Direction="0 1 0 -1 0 0 0 0 1"')
    with pytest.raises(PlenoPIVError, match="axes are turned"):
        flow("file", path=path, **UNITS)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b"STRUCTURED_POINTS", b"POLYDATA", "of the kind POLYDATA, wanted STRUCTURED_POINTS"),
        (b"# vtk", b"# xyz", "does not begin with '# vtk"),
        (b"VECTORS", b"TENSORS", "holds TENSORS, which is not read"),
    ],
)
def test_other_legacy_files_are_refused(tmp_path, old, new, said):
    path = tmp_path / "flow.vtk"
    legacy(path, binary=False)
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(PlenoPIVError, match=said):
        flow("file", path=str(path), **UNITS)


def test_a_file_cut_short(tmp_path):
    for name, write in {"flow.vti": lambda p: vti(p, form="raw"), "flow.vtk": lambda p: legacy(p, binary=True)}.items():
        path = tmp_path / name
        write(path)
        path.write_bytes(path.read_bytes()[:-3000])
        with pytest.raises(PlenoPIVError, match="is no VTK image or is damaged"):
            flow("file", path=str(path), **UNITS)
