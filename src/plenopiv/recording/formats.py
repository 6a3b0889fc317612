"""Images in other files than TIFF: PNG, NumPy, HDF5, and LaVision's through the optional ``lvpyio``.

A format is told by the ending of the file's name. Arrays of three dimensions are stacks of images (image, row, column).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from math import prod
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, brief
from plenopiv.hdf5 import damage
from plenopiv.recording.tiff import COUNTS, Header

SEPARATOR = "::"  # between an HDF5 file and its data set
NAMES_DATASET = re.compile(rf"(.*?\.(?:h5|hdf5)){SEPARATOR}(.*)", re.IGNORECASE | re.DOTALL)
LARGEST = 1 << 30  # bytes of an image: more is a damaged header


class Reader(Protocol):
    """How one format is read. ``page`` counts images from 0, ``dataset`` is that of an HDF5 file."""

    def images(self, path: Path, dataset: str) -> int:
        """The number of images."""

    def header(self, path: Path, page: int, dataset: str) -> Header:
        """(columns, rows) and bits per pixel of one."""

    def counts(self, path: Path, page: int, dataset: str) -> NDArray:
        """Counts of one, (rows, columns)."""


def split(name: Path) -> tuple[Path, str]:
    """A file and the data set in it, "" where none is named."""
    found = NAMES_DATASET.match(str(name))
    return (Path(found[1]), found[2]) if found else (name, "")


def reader_of(path: Path) -> Reader | None:
    """How a file is read; None for TIFF files and those of no known format."""
    return READERS.get(path.suffix.lower())


def are_counts(dtype: np.dtype) -> bool:
    """Whether values are 8- or 16-bit counts, in any order of their bytes."""
    return dtype.newbyteorder("=") in (np.uint8, np.uint16)


def checked(array_shape: tuple[int, ...], dtype: np.dtype, path: Path) -> None:
    """Raise PlenoPIVError for what is no image, or stack of images, of 8- or 16-bit counts."""
    if len(array_shape) not in (2, 3) or 0 in array_shape:
        raise PlenoPIVError(f"{path}: holds an array of shape {array_shape}; wanted (rows, columns) or a stack of such")
    if len(array_shape) == 3 and array_shape[-1] in (3, 4) and array_shape[0] > 4:
        raise PlenoPIVError(f"{path}: is a colour image {array_shape}; only raw monochrome images are supported")
    if not are_counts(dtype):
        raise PlenoPIVError(f"{path}: holds {dtype} values; {COUNTS}")
    if prod(array_shape[-2:]) * dtype.itemsize > LARGEST:
        raise PlenoPIVError(f"{path}: holds images of {array_shape[-1]} x {array_shape[-2]} pixels: is it damaged?")


class Arrays(ABC):
    """Formats that hold one array: what they have in common."""

    @abstractmethod
    def array(self, path: Path, dataset: str) -> AbstractContextManager[Any]:
        """Something with ``shape``, ``dtype`` and slices."""

    def images(self, path: Path, dataset: str) -> int:
        """See ``Reader``."""
        with self.array(path, dataset) as found:
            checked(found.shape, found.dtype, path)
            return found.shape[0] if len(found.shape) == 3 else 1

    def header(self, path: Path, page: int, dataset: str) -> Header:
        """See ``Reader``."""
        with self.array(path, dataset) as found:
            checked(found.shape, found.dtype, path)
            return (int(found.shape[-1]), int(found.shape[-2])), 8 * found.dtype.itemsize

    def counts(self, path: Path, page: int, dataset: str) -> NDArray:
        """See ``Reader``."""
        with self.array(path, dataset) as found:
            checked(found.shape, found.dtype, path)
            return np.array(found[page] if len(found.shape) == 3 else found, found.dtype.newbyteorder("="))


class NumPyFile(Arrays):
    """A .npy file."""

    @contextmanager
    def array(self, path: Path, dataset: str) -> Iterator[Any]:
        """See ``Arrays``."""
        try:
            found = np.load(path, mmap_mode="r", allow_pickle=False)
            _ = found.shape  # an archive has none
        except Exception as error:  # its header is parsed as Python text
            raise PlenoPIVError(f"{path}: is no whole NumPy file ({brief(error)})") from None
        yield found


class HDF5File(Arrays):
    """A data set of an HDF5 file."""

    @contextmanager
    def array(self, path: Path, dataset: str) -> Iterator[Any]:
        """See ``Arrays``."""
        import h5py

        try:
            if wrong := damage(path):
                raise PlenoPIVError(f"{path}: is no whole HDF5 file ({wrong})")
            file = h5py.File(path, "r")
        except OSError as error:
            raise PlenoPIVError(f"{path}: is no whole HDF5 file ({brief(error)})") from None
        with file:
            found = file.get(dataset) if dataset else None
            if not isinstance(found, h5py.Dataset):
                names: list[str] = []
                file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
                held = ", ".join(names[:4]) or "none"
                wrong = f"has no data set {dataset!r}" if dataset else "names no data set"
                raise PlenoPIVError(f"{path}: {wrong}; write {path.name}{SEPARATOR}NAME, it holds {held}")
            try:
                yield found
            except (OSError, RuntimeError) as error:
                raise PlenoPIVError(f"{path}: data set {dataset} cannot be read ({brief(error)})") from None


def image_datasets(path: Path) -> list[str]:
    """Names of an HDF5 file's data sets that are images, or stacks of images, of counts.

    Raises:
        PlenoPIVError: the file cannot be read.
    """
    return [name for name, item in _datasets(path) if item[0] in (2, 3) and are_counts(item[1])]


def unlike_images(path: Path) -> list[str]:
    """Names of an HDF5 file's data sets that have two axes or more and are no images, with why and the way out.

    Raises:
        PlenoPIVError: the file cannot be read.
    """
    words = list[str]()
    for name, (axes, dtype) in _datasets(path):
        if axes > 3:
            words.append(f"{name} has {axes} axes; write (images, rows, columns), pulses in data sets of their own")
        elif axes > 1 and not are_counts(dtype):
            words.append(f"{name} holds {dtype} values; write 8- or 16-bit unsigned counts")
    return words


def _datasets(path: Path) -> list[tuple[str, tuple[int, np.dtype]]]:
    """Names, number of axes and type of an HDF5 file's data sets."""
    import h5py

    found: list[tuple[str, tuple[int, np.dtype]]] = []

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            found.append((name, (item.ndim, item.dtype)))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (OSError, RuntimeError) as error:
        raise PlenoPIVError(f"{path}: is no whole HDF5 file ({brief(error)})") from None
    return found


class PNGFile:
    """A monochrome PNG file of 8 or 16 bits."""

    def images(self, path: Path, dataset: str) -> int:
        """See ``Reader``."""
        self.header(path, 0, dataset)
        return 1

    def header(self, path: Path, page: int, dataset: str) -> Header:
        """See ``Reader``."""
        with path.open("rb") as file:
            start = file.read(29)
        if len(start) < 29 or start[:8] != b"\x89PNG\r\n\x1a\n" or start[12:16] != b"IHDR":
            raise PlenoPIVError(f"{path}: is no PNG file")
        columns, rows = (int.from_bytes(start[at : at + 4], "big") for at in (16, 20))
        bits, colour = start[24], start[25]
        if colour != 0:
            raise PlenoPIVError(f"{path}: is a colour image; only raw monochrome images are supported")
        if bits not in (8, 16):
            raise PlenoPIVError(f"{path}: holds {bits} bits per pixel; {COUNTS}")
        checked((rows, columns), np.dtype(np.uint8 if bits == 8 else np.uint16), path)
        return (columns, rows), bits

    def counts(self, path: Path, page: int, dataset: str) -> NDArray:
        """See ``Reader``."""
        import imagecodecs

        (columns, rows), _ = self.header(path, page, dataset)
        try:
            counts = imagecodecs.png_decode(path.read_bytes())
        except Exception as error:
            raise PlenoPIVError(f"{path}: its pixels do not decode, the file is damaged ({brief(error)})") from None
        if counts.shape != (rows, columns):
            raise PlenoPIVError(f"{path}: its pixels are not those of its header; the file is damaged")
        return counts


class LaVisionFile:
    """A .im7 buffer: each of its frames is an image."""

    def _frames(self, path: Path) -> list[NDArray]:
        try:
            import lvpyio
        except ImportError:
            raise PlenoPIVError(
                f"{path}: LaVision files need the package lvpyio: pip install plenopiv[lavision]; or export TIFF"
            ) from None
        try:
            buffer = lvpyio.read_buffer(str(path))
            return [np.asarray(np.ma.getdata(frame.as_masked_array())) for frame in buffer]
        except Exception as error:
            raise PlenoPIVError(f"{path}: cannot be read by lvpyio ({brief(error)})") from None

    def images(self, path: Path, dataset: str) -> int:
        """See ``Reader``."""
        return len(self._frames(path))

    def header(self, path: Path, page: int, dataset: str) -> Header:
        """See ``Reader``."""
        counts = self.counts(path, page, dataset)
        return (counts.shape[1], counts.shape[0]), 8 * counts.dtype.itemsize

    def counts(self, path: Path, page: int, dataset: str) -> NDArray:
        """See ``Reader``. Values are counts even where the buffer holds them as floats."""
        values = self._frames(path)[page]
        counts = values.astype(np.uint16)
        if not np.array_equal(counts, values):
            raise PlenoPIVError(f"{path}: holds values that are no counts; export the raw images")
        checked(counts.shape, counts.dtype, path)
        return counts


_HDF5 = HDF5File()
READERS: dict[str, Reader] = {
    ".png": PNGFile(),
    ".npy": NumPyFile(),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".im7": LaVisionFile(),
}
