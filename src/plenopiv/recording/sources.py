"""Where an image is, and its counts: whatever the file, the same checks and the same messages."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, printable
from plenopiv.recording import formats, tiff
from plenopiv.sensor import Sensor

Half = Literal["top", "bottom"]
FORMATS = "TIFF, PNG, NumPy (.npy), HDF5 (file.h5::dataset) and LaVision (.im7) files are read"
LOOKED_AT = 5000  # names in a folder, for one that was meant


@dataclass(frozen=True)
class ImageSource:
    """One image: ``page`` (from 0) of a file of ``pages``, in data set ``dataset`` of an HDF5 file, or a ``half`` of an
    image of double height."""

    path: Path
    page: int = 0
    pages: int = 1
    dataset: str = ""
    half: Half | None = None

    @property
    def name(self) -> str:
        """As messages and summary.json name it; the file's name where it holds nothing else."""
        inside = f"::{self.dataset}" if self.dataset else ""
        page = f" page {self.page + 1}" if self.pages > 1 else ""
        return f"{self.path.name}{inside}{page}{f' {self.half}' if self.half else ''}"

    @property
    def stem(self) -> str:
        """A name for files that are made of it."""
        page = f"-{self.page + 1}" if self.pages > 1 else ""
        return f"{self.path.stem}{page}{f'-{self.half}' if self.half else ''}"

    def __str__(self) -> str:
        return str(self.path.parent / self.name)

    def halves(self, stacked: Literal["top-first", "bottom-first"]) -> tuple[ImageSource, ImageSource]:
        """Both pulses of an image of double height, in the order of time."""
        top, bottom = replace(self, half="top"), replace(self, half="bottom")
        return (top, bottom) if stacked == "top-first" else (bottom, top)

    def size(self) -> tuple[int, int]:
        """(columns, rows), from the file's header.

        Raises:
            PlenoPIVError: see ``sources_of``; in colour, not 8- or 16-bit counts, or truncated.
        """
        (columns, rows), _ = self._header(None)
        return columns, rows // 2 if self.half else rows

    def check(self, sensor: Sensor) -> None:
        """Raise PlenoPIVError, from the header alone, where the image is not one of this sensor."""
        self._header(sensor)

    def counts(self, sensor: Sensor | None = None, *, even: bool = False, mean: bool = False) -> NDArray[np.uint16]:
        """Counts, (rows, columns), in the file's orientation. Without a sensor size and depth are not compared.
        ``even``: all pixels may be equal, as of a dark image of a camera that clips at zero, but not at full scale.
        ``mean``: it may be the mean of many images, which fills the bits below those of the camera; it is rounded.

        Raises:
            PlenoPIVError: as ``check``; the pixels do not decode, exceed the bit depth, or are all equal.
        """
        counts = _aligned(self.values(sensor), sensor, str(self), mean)
        highest = int(counts.max())
        may_be = even and (sensor is None or highest < sensor.full_scale)
        if highest == int(counts.min()) and not may_be:
            raise PlenoPIVError(f"{self}: every pixel is {highest}; the image is blank")
        return counts.astype(np.uint16, copy=False)

    def values(self, sensor: Sensor | None = None) -> NDArray:
        """What the file holds of the image, (rows, columns), of which the header alone is checked.

        Raises:
            PlenoPIVError: as ``check``; the pixels do not decode.
        """
        reader, fits = formats.reader_of(self.path), partial(self._compare, sensor)
        with _told_if_missing(self.path):
            if reader is None:
                counts = tiff.counts(self.path, self.page, fits)
            else:
                fits(reader.header(self.path, self.page, self.dataset))
                counts = reader.counts(self.path, self.page, self.dataset)
        if self.half:
            middle = counts.shape[0] // 2
            counts = counts[:middle] if self.half == "top" else counts[middle:]
        return counts

    def tags(self) -> dict[int, object]:
        """Tags of a TIFF file by their code (``tiff.tiff_tags``); none of others.

        Raises:
            PlenoPIVError: as ``size``.
        """
        with _told_if_missing(self.path):
            return {} if formats.reader_of(self.path) else tiff.tiff_tags(self.path, self.page)

    def _header(self, sensor: Sensor | None) -> tiff.Header:
        """What the file's header says, compared with a sensor."""
        reader, fits = formats.reader_of(self.path), partial(self._compare, sensor)
        with _told_if_missing(self.path):
            if reader is None:
                try:
                    return tiff.header(self.path, self.page, fits)
                except PlenoPIVError:
                    _check_readable(self.path)  # empty, or no TIFF file at all?
                    raise
            header = reader.header(self.path, self.page, self.dataset)
        fits(header)
        return header

    def _compare(self, sensor: Sensor | None, header: tiff.Header) -> None:
        """Raise PlenoPIVError where a header is not that of an image of the sensor."""
        if sensor is None:
            return
        (columns, rows), bits = header
        if (columns, rows) != (sensor.columns, sensor.rows * (2 if self.half else 1)):
            double = " (both pulses stacked)" if self.half else ""
            raise PlenoPIVError(
                f"{self}: is {columns} x {rows} pixels (columns x rows), but camera.sensor says "
                f"{sensor.columns} x {sensor.rows}{double}"
            )
        if bits <= 8 < sensor.bit_depth:
            raise PlenoPIVError(
                f"{self}: holds {bits} bits per pixel, but camera.sensor.bit_depth is {sensor.bit_depth}"
                f"; save the raw counts, or set bit_depth = {bits} and its black_level"
            )


@contextmanager
def _told_if_missing(path: Path) -> Iterator[None]:
    """Say that a file is missing which was there when the recording was opened: readers call it damaged."""
    try:
        yield
    except (PlenoPIVError, OSError):
        if path.exists():
            raise
        raise PlenoPIVError(f"{path}: is missing") from None


def _aligned(counts: NDArray, sensor: Sensor | None, name: str, mean: bool) -> NDArray:
    """Counts in the lower bits, compared with the sensor's full scale. ``mean``: as in ``ImageSource.counts``."""
    if sensor is None:
        return counts
    spare = 16 - sensor.bit_depth
    low_bits_empty = counts.dtype == np.uint16 and spare > 0 and not (counts & ((1 << spare) - 1)).any()
    if sensor.alignment == "high":
        if mean and counts.dtype == np.uint16:
            return np.minimum((counts.astype(np.uint32) + (1 << spare >> 1)) >> spare, sensor.full_scale)
        if not low_bits_empty and spare > 0:
            raise PlenoPIVError(
                f"{name}: its values are no multiples of {1 << spare}, so they are not {sensor.bit_depth} bits in the "
                'upper part of 16; remove camera.sensor.alignment = "high", and save all images alike'
            )
        return counts >> spare
    highest = int(counts.max())
    if highest > sensor.full_scale:
        hint = (
            f"all values are multiples of {1 << spare}, so they are in the upper bits: set "
            'camera.sensor.alignment = "high"; all images are to be saved so'
            if low_bits_empty
            else "set camera.sensor.bit_depth to what the camera wrote"
        )
        raise PlenoPIVError(
            f"{name}: holds the value {highest}, above full scale of {sensor.bit_depth} bits, "
            f"{sensor.full_scale}; {hint}"
        )
    return counts


def sources_of(name: Path) -> tuple[ImageSource, ...]:
    """The images of a file in their order: pages of a TIFF file, entries of a stack. ``file.h5::dataset`` names a data
    set of an HDF5 file.

    Raises:
        PlenoPIVError: missing, a folder, empty, of an unknown format, or its header cannot be read.
    """
    path, dataset = formats.split(name)
    _check_readable(path)
    reader = formats.reader_of(path)
    count = reader.images(path, dataset) if reader else tiff.pages(path)
    return tuple(ImageSource(path, page, count, dataset) for page in range(count))


def only_source(name: Path) -> ImageSource:
    """The one image of a file.

    Raises:
        PlenoPIVError: as ``sources_of``; it holds several.
    """
    found = sources_of(name)
    if len(found) > 1:
        raise PlenoPIVError(f"{name}: holds {len(found)} images, wanted one; save it as a file of its own")
    return found[0]


def frame_source(name: Path) -> ImageSource:
    """The same of a frame, which may be damaged: a file that is there and cannot be read counts as one image, and is
    told of when its header is checked.

    Raises:
        PlenoPIVError: there is no such file, or it holds several images.
    """
    path, dataset = formats.split(name)
    try:
        found = sources_of(name)
    except PlenoPIVError:
        if not path.is_file():
            raise
        return ImageSource(path, dataset=dataset)
    return found[0] if len(found) == 1 else only_source(name)


def read_image(path: str | Path, sensor: Sensor | None = None) -> NDArray[np.uint16]:
    """Counts of the one image of a file (``ImageSource.counts``)."""
    return only_source(Path(path)).counts(sensor)


def image_size(path: Path) -> tuple[int, int]:
    """(columns, rows) of the first image of a file, from its header (``ImageSource.size``)."""
    return sources_of(path)[0].size()


def _meant(path: Path) -> str:
    """What to do about a file that is not there. One of another number is another frame, not meant."""
    try:
        there = sorted(each.name for each in islice(path.parent.iterdir(), LOOKED_AT))
    except OSError:
        return f"; there is no folder {path.parent}: correct its name"
    others = [name for name in there if re.sub(r"\d+", "", name) != re.sub(r"\d+", "", path.name)]
    near = get_close_matches(path.name, others, n=1)
    return f"; did you mean {printable(near[0])}?" if near else "; correct its name, or put it there"


def _check_readable(path: Path) -> None:
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # opening a pipe waits for whoever writes into it
            raise PlenoPIVError(f"{path}: is a pipe or a device; copy the image into a file")
        with path.open("rb") as file:
            start = file.read(8)
    except FileNotFoundError:
        raise PlenoPIVError(f"{path}: no such file{_meant(path)}") from None
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:  # a NUL in the name
        raise PlenoPIVError(f"{str(path)!r}: is no file name") from None
    if not start:
        raise PlenoPIVError(f"{path}: is empty (0 bytes); copy it again")
    if start[:4] not in tiff.SIGNATURES and formats.reader_of(path) is None:
        raise PlenoPIVError(f"{path}: is no image file that is known; {FORMATS}")
