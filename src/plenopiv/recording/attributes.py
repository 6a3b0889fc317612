"""What files say of an image beside its counts: TIFF tags are in ``tiff``, here is what HDF5 and PNG files hold."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from plenopiv.errors import PlenoPIVError
from plenopiv.recording.sources import ImageSource

LARGEST_TEXT = 1 << 16  # bytes of a PNG file's text that are read
MOST_CHUNKS = 100_000  # of a PNG file: more are damage


def attributes_of(source: ImageSource) -> dict[str, Any]:
    """Values by their names in lower case, of an HDF5 data set (those of the file where it has none) or a PNG file.

    An attribute of an HDF5 stack that holds one value for each image counts as this image's. Empty for other files, and
    for what cannot be read.
    """
    ending = source.path.suffix.lower()
    if ending in (".h5", ".hdf5") and source.dataset:
        return _of_hdf5(source)
    return _of_png(source.path) if ending == ".png" else {}


def _of_hdf5(source: ImageSource) -> dict[str, Any]:
    import h5py

    found: dict[str, Any] = {}
    try:
        with h5py.File(source.path, "r") as file:
            for attributes in (file.attrs, file[source.dataset].attrs):
                for name, value in attributes.items():
                    shape = getattr(value, "shape", ())
                    if shape not in ((), (1,), (source.pages,)):
                        continue
                    one = value if shape == () else value[source.page if shape == (source.pages,) else 0]
                    found[name.lower()] = one.item() if hasattr(one, "item") else one
    except (OSError, RuntimeError, KeyError, TypeError) as error:
        raise PlenoPIVError(f"{source}: its attributes cannot be read ({type(error).__name__})") from None
    return found


def _of_png(path: Path) -> dict[str, Any]:
    """Texts (tEXt) and the time of the last change (tIME) before the pixels and behind them."""
    found: dict[str, Any] = {}
    with path.open("rb") as file:
        file.seek(8)
        for _ in range(MOST_CHUNKS):
            head = file.read(8)
            length, kind = struct.unpack(">I4s", head) if len(head) == 8 else (0, b"IEND")
            if kind == b"IEND":
                break
            if kind not in (b"tEXt", b"tIME") or length > LARGEST_TEXT:
                file.seek(length + 4, 1)
                continue
            content = file.read(length)
            file.seek(4, 1)
            if kind == b"tEXt":
                name, _, text = content.partition(b"\0")
                found[name.decode("latin-1").lower()] = text.decode("latin-1")
            elif length == 7:
                year, *rest = struct.unpack(">H5B", content)
                found["time of change"] = "{:04}-{:02}-{:02}T{:02}:{:02}:{:02}".format(year, *rest)
    return found
