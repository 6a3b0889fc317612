"""Velocities from VTK images: XML (``.vti``) and legacy structured points (``.vtk``), without VTK.

Read: values at points, ASCII, base64 and appended, raw or compressed with zlib or lzma. After "VTK File Formats" (VTK
documentation, docs.vtk.org). A VTK file states no units.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Callable
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, brief
from plenopiv.simulation.file_grid import FileGrid, missing_variable

XML_TYPES = {"Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8"}
XML_TYPES |= {"UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8"}
LEGACY_TYPES = {"float": ">f4", "double": ">f8", "char": ">i1", "short": ">i2", "int": ">i4", "long": ">i8"}
LEGACY_TYPES |= {"unsigned_char": ">u1", "unsigned_short": ">u2", "unsigned_int": ">u4", "vtktypeint64": ">i8"}
UNPACK: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}
MOST_POINTS = 1 << 28  # of an image: 6 GB of velocities
MOST_COMPONENTS = 9  # a tensor's
WORDS = 12  # of a line of keywords
# What parsers raise: LookupError is that of an unknown encoding too, ArithmeticError of numbers beyond Python's.
DAMAGED = (
    OSError, ValueError, LookupError, ArithmeticError, TypeError, EOFError, MemoryError,
    ElementTree.ParseError, zlib.error, lzma.LZMAError,
)  # fmt: skip
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def read_vtk_image(path: Path, variables: tuple[str, ...] = ()) -> FileGrid:
    """Velocities of an image's points.

    ``variables``: the name of a vector, or three of scalars; by default u, v, w, else the only vector.

    Raises:
        PlenoPIVError: damaged, another kind of VTK file, no such array, axes that are turned.
    """
    try:
        content = path.read_bytes()
        first, spacing, points, arrays = (_xml if path.suffix == ".vti" else _legacy)(content)
        return FileGrid(path, _velocity(arrays, variables).reshape(*points[::-1], 3), first, spacing)
    except PlenoPIVError as error:
        raise PlenoPIVError(f"flow: {path}: {error}") from None
    except DAMAGED as error:
        raise PlenoPIVError(f"flow: {path}: is no VTK image or is damaged ({brief(error)})") from None


def _checked(points: list[int]) -> list[int]:
    """Raise PlenoPIVError for numbers of points that no image has."""
    if len(points) != 3 or min(points) < 1 or prod(points) > MOST_POINTS:
        raise PlenoPIVError(f"holds {' x '.join(map(str, points[:4]))} points; wanted some along x, y and z")
    return points


def _velocity(arrays: dict[str, NDArray], variables: tuple[str, ...]) -> NDArray:
    """(points, 3) of the arrays named, each (points, components)."""
    vectors = [name for name, array in arrays.items() if array.shape[1] == 3]
    if not variables:
        if set("uvw") <= set(arrays):
            variables = ("u", "v", "w")
        elif len(vectors) == 1:
            variables = (vectors[0],)
        else:
            raise PlenoPIVError(f"holds {', '.join(arrays) or 'no point data'}; name the velocity with variables")
    for name in variables:
        if name not in arrays:
            raise PlenoPIVError(missing_variable(name, list(arrays)))
    columns = np.concatenate([arrays[name] for name in variables], 1)
    if columns.shape[1] != 3:
        raise PlenoPIVError(f"variables = {list(variables)}: {columns.shape[1]} components in all, wanted three")
    return columns.astype(float)


def _xml(content: bytes):
    """First point, spacing, points along x, y, z, and the arrays of an XML image."""
    head, appended, raw = _parted(content)
    root = ElementTree.fromstring(head)
    image = root.find("ImageData")
    if image is None:
        raise PlenoPIVError(f"is a VTK file of the kind {root.get('type')}, wanted ImageData")
    pieces = image.findall("Piece")
    extent = [int(v) for v in image.get("WholeExtent", "").split()]
    if len(pieces) != 1 or [int(v) for v in pieces[0].get("Extent", "").split()] != extent:
        raise PlenoPIVError(f"is in {len(pieces)} pieces; write it as one")
    if not np.allclose([float(v) for v in image.get("Direction", "").split()] or IDENTITY, IDENTITY):
        raise PlenoPIVError("its axes are turned (Direction); resample it along x, y, z")
    spacing = np.array([float(v) for v in image.get("Spacing", "1 1 1").split()])
    first = np.array([float(v) for v in image.get("Origin", "0 0 0").split()]) + spacing * extent[0::2]
    points = _checked([hi - lo + 1 for lo, hi in zip(extent[0::2], extent[1::2], strict=True)])
    arrays = {}
    for array in pieces[0].iterfind("PointData/DataArray"):
        components = int(array.get("NumberOfComponents", 1))
        if not 1 <= components <= MOST_COMPONENTS:
            raise PlenoPIVError(f"is damaged: it states arrays of {components} components")
        values = _values(array, root, appended, raw, prod(points) * components).reshape(-1, components)
        arrays[str(array.get("Name"))] = values
    return tuple(first.tolist()), tuple(spacing.tolist()), points, arrays


def _parted(content: bytes) -> tuple[bytes, bytes, bool]:
    """The XML, the appended data after their underscore, and whether those are raw: then the whole is no XML."""
    tag = re.search(rb"<AppendedData[^>]{0,400}>", content)
    if tag is None:
        return content, b"", False
    begin = content.index(b"_", tag.end()) + 1
    return content[: tag.start()] + b"</VTKFile>", content[begin:], b'"raw"' in tag[0]


def _values(array: ElementTree.Element, root: ElementTree.Element, appended: bytes, raw: bool, count: int) -> NDArray:
    """The ``count`` numbers of one array, in the order of the file."""
    kind = XML_TYPES[array.get("type", "")]
    if array.get("format", "ascii") == "ascii":
        return np.array((array.text or "").split(), kind)
    data = appended[int(array.get("offset", 0)) :] if array.get("format") == "appended" else None
    text = re.sub(rb"\s", b"", (array.text or "").encode()) if data is None else data
    order = "<" if root.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    header = np.dtype(order + XML_TYPES[root.get("header_type", "UInt32")])
    compressor = root.get("compressor")
    largest = count * np.dtype(kind).itemsize
    unpacked = _unpacked(text, header, compressor, data is None or not raw, largest)
    return np.frombuffer(unpacked, order + kind)


def _unpacked(data: bytes, header: np.dtype, compressor: str | None, encoded: bool, largest: int) -> bytes:
    """The bytes behind a header: their number, or with compression blocks, two block sizes and each packed size.
    More than ``largest`` are an error before they are unpacked."""

    def part(begin: int, size: int) -> bytes:
        """``size`` bytes of what is stored as one stretch, which begins at ``begin`` of the file's own bytes."""
        if not encoded:
            return data[begin : begin + size]
        return base64.b64decode(data[begin : begin + 4 * -(-size // 3)])[:size]

    word = header.itemsize
    if compressor is None:
        size = int(np.frombuffer(part(0, word), header)[0])
        return part(0, word + size)[word:]
    if compressor not in UNPACK:
        raise PlenoPIVError(f"is packed by {compressor}; write it with zlib or unpacked")
    blocks = int(np.frombuffer(part(0, word), header)[0])
    length = word * (3 + blocks)
    sizes = np.frombuffer(part(0, length), header)[3:].astype(int)
    begin = 4 * -(-length // 3) if encoded else length
    if sizes.size != blocks or (sizes < 0).any():
        raise PlenoPIVError(f"is damaged: the sizes of {blocks} packed blocks are not there")
    packed, out, at = part(begin, int(sizes.sum())), bytearray(), 0
    for size in sizes:
        out += UNPACK[compressor]().decompress(packed[at : at + size], largest + 1 - len(out))
        at += size
        if len(out) > largest:
            raise PlenoPIVError("is damaged: its packed data are more than its points")
    return bytes(out)


def _legacy(content: bytes):
    """As ``_xml``, from the older format: keywords in text, numbers in ASCII or big-endian."""
    lines = content.split(b"\n", 3)
    if not lines[0].startswith(b"# vtk"):
        raise PlenoPIVError("does not begin with '# vtk DataFile'")
    text = _Legacy(lines[3], binary=lines[2].strip().upper() == b"BINARY")
    header: dict[str, list[str]] = {}
    arrays: dict[str, NDArray] = {}
    while words := text.line():
        keyword = words[0].upper()
        if keyword == "DATASET" and words[1].upper() != "STRUCTURED_POINTS":
            raise PlenoPIVError(f"is a VTK file of the kind {words[1]}, wanted STRUCTURED_POINTS")
        if keyword == "CELL_DATA":
            break
        if keyword == "METADATA":
            text.skip_to_blank_line()
        elif keyword == "VECTORS":
            arrays[words[1]] = text.numbers(int(header["POINT_DATA"][0]), 3, words[2])
        elif keyword == "SCALARS":
            components = int(words[3]) if len(words) > 3 else 1
            text.line()  # LOOKUP_TABLE
            arrays[words[1]] = text.numbers(int(header["POINT_DATA"][0]), components, words[2])
        elif keyword == "FIELD":
            for _ in range(int(words[2])):
                name, width, tuples, kind = text.line()[:4]
                values = text.numbers(int(tuples), int(width), kind)
                if "POINT_DATA" in header:
                    arrays[name] = values
        elif keyword in ("DATASET", "DIMENSIONS", "ORIGIN", "SPACING", "ASPECT_RATIO", "POINT_DATA"):
            header[keyword] = words[1:]
        else:
            raise PlenoPIVError(f"holds {keyword}, which is not read; write VECTORS or SCALARS of points alone")
    spacing = header.get("SPACING") or header["ASPECT_RATIO"]
    first, steps = (tuple(float(v) for v in row[:3]) for row in (header["ORIGIN"], spacing))
    return first, steps, _checked([int(n) for n in header["DIMENSIONS"]]), arrays


class _Legacy:
    """A legacy file from its fourth line on, read from front to back."""

    def __init__(self, content: bytes, binary: bool) -> None:
        self.content, self.binary, self.at = content, binary, 0

    def line(self) -> list[str]:
        """Words of the next line that is not blank; none at the end."""
        while self.at < len(self.content):
            end = self.content.find(b"\n", self.at)
            end = len(self.content) if end < 0 else end
            words = self.content[self.at : end].split(None, WORDS)
            self.at = end + 1
            if words:
                return [word.decode("latin-1") for word in words]
        return []

    def skip_to_blank_line(self) -> None:
        """Past what describes the array before it."""
        while self.at < len(self.content):
            end = self.content.find(b"\n", self.at)
            end = len(self.content) if end < 0 else end
            blank = not self.content[self.at : end].strip()
            self.at = end + 1
            if blank:
                return

    def numbers(self, tuples: int, components: int, kind: str) -> NDArray:
        """(tuples, components) of a type by its name."""
        if min(tuples, components) < 0 or tuples * components > MOST_COMPONENTS * MOST_POINTS:
            raise PlenoPIVError(f"is damaged: it states an array of {tuples} x {components} numbers")
        count, dtype = tuples * components, np.dtype(LEGACY_TYPES[kind.lower()])
        if self.binary:
            values = np.frombuffer(self.content[self.at : self.at + count * dtype.itemsize], dtype)
            self.at += count * dtype.itemsize
        else:
            words = self.content[self.at :].split(None, count)
            self.at = len(self.content) - (len(words[count]) if len(words) > count else 0)
            values = np.array(words[:count], float)
        return values.reshape(tuples, components)
