"""TIFF files: headers checked before any pixel is decoded.

A page that is truncated, coloured, of the wrong size or of the wrong depth is an error that names its file, never a
picture with zeros in it: TIFF readers fill what is missing. Thumbnails that a file holds beside its images are no
pages of it.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, brief

if TYPE_CHECKING:
    import tifffile

EXIF = 34665
COUNTS = "raw images hold 8- or 16-bit unsigned counts; round those of a mean image, and save them as 16-bit unsigned"
BULKY_TAGS = {273, 279, 324, 325, EXIF}  # where the pixels lie
SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
Header = tuple[tuple[int, int], int]  # (columns, rows), bits per pixel
Fits = Callable[[Header], None]  # raises PlenoPIVError where an image is not one of the sensor
SPARE, PACKED = 64_000_000, 200  # bytes, and times its own size, that a compressed file may unpack to
REDUCED = 1  # bit of NewSubfileType that marks a thumbnail (TIFF 6.0, page 36)
MOST_PAGES = 100_000  # of a file: more are a damaged header


def pages(path: Path) -> int:
    """The number of images in a file.

    Raises:
        PlenoPIVError: no TIFF, its header cannot be read, or a stack of ImageJ of which it names but one image.
    """
    with _file(path) as tif:
        return len(_images(tif))


def header(path: Path, page: int, fits: Fits) -> Header:
    """(columns, rows) of a page, and its bits per pixel; ``fits`` is asked about them before where the pixels are.

    Raises:
        PlenoPIVError: in colour, no 8- or 16-bit counts, truncated, there is no such page, or what ``fits`` raises.
    """
    with _page(path, page, fits) as found:
        return _header(found)


def counts(path: Path, page: int, fits: Fits) -> NDArray:
    """Counts of a page as stored, (rows, columns).

    Raises:
        PlenoPIVError: as ``header``, or the pixels do not decode.
    """
    with _page(path, page, fits) as found:
        try:
            return found.asarray()
        except Exception as error:  # every codec fails in its own way
            raise PlenoPIVError(f"{path}: its pixels do not decode, the file is damaged ({brief(error)})") from None


def tiff_tags(path: Path, page: int = 0) -> dict[int, object]:
    """Values of the tags of a page by their code, those of its EXIF block too.

    Raises:
        PlenoPIVError: as ``header``.
    """
    with _page(path, page, lambda header: None) as found:
        tags = {tag.code: tag.value for tag in found.tags if tag.code not in BULKY_TAGS}
        names = _exif_codes()
        for name, value in (found.tags.valueof(EXIF, {}) or {}).items():
            if name in names:
                tags.setdefault(names[name], value)
        return tags


def _exif_codes() -> dict[str, int]:
    import tifffile

    return {name: code for code, name in tifffile.TIFF.EXIF_TAGS.items()}


@contextmanager
def _file(path: Path) -> Iterator[tifffile.TiffFile]:
    """A TIFF file, opened."""
    import tifffile

    logger = logging.getLogger("tifffile")
    was_disabled, logger.disabled = logger.disabled, True  # it logs what is raised here in one line
    try:
        try:
            tif = tifffile.TiffFile(path)
            count = len(tif.pages)
            of_imagej = _of_imagej(tif) if count == 1 else 1
        except Exception as error:
            raise PlenoPIVError(
                f"{path}: its TIFF header cannot be read, the file is damaged ({brief(error)})"
            ) from None
        with tif:
            if not 0 < count <= MOST_PAGES:
                raise PlenoPIVError(f"{path}: holds {count} images; copy it again")
            if of_imagej > 1:
                raise PlenoPIVError(
                    f"{path}: is a stack of {of_imagej} images as ImageJ writes above 4 GB, of which its directory "
                    "names the first alone; save it as separate images, or as a BigTIFF"
                )
            yield tif
    finally:
        logger.disabled = was_disabled


def _images(tif: tifffile.TiffFile) -> Sequence[int]:
    """Which of a file's pages are images, in their order. Cameras add a thumbnail to the first one or to each, so that
    the first two tell whether there are any; where all are marked, none is one."""
    every = range(len(tif.pages))
    if all(_is_image(tif, k) for k in every[:2]):
        return every
    return [k for k in every if _is_image(tif, k)] or every


def _is_image(tif: tifffile.TiffFile, number: int) -> bool:
    """Whether a page is no thumbnail; one whose header is damaged may be an image."""
    with suppress(Exception):  # each reader of the page says what is wrong with it
        return not cast("tifffile.TiffPage", tif.pages[number]).subfiletype & REDUCED
    return True


def _of_imagej(tif: tifffile.TiffFile) -> int:
    """How many images ImageJ says that a file of one page holds, if there are pixels of a second one; else 1."""
    page = tif.pages.first
    said = re.search(r"^images=(\d{1,9})\s*$", page.imagej_description or "", re.MULTILINE)
    if said is None or page.compression != 1:
        return 1
    second = min(page.dataoffsets, default=0) + 2 * page.nbytes <= tif.filehandle.size  # else it was cut out of a stack
    return int(said[1]) if second else 1


@contextmanager
def _page(path: Path, number: int, fits: Fits) -> Iterator[tifffile.TiffPage]:
    """A page whose header is that of raw monochrome counts and ``fits``, all of it in the file."""
    with _file(path) as tif:
        images = _images(tif)
        if number >= len(images):
            raise PlenoPIVError(f"{path}: holds {len(images)} images, there is no page {number + 1}")
        try:
            page = cast("tifffile.TiffPage", tif.pages[images[number]])
            _readable(path, page)
            fits(_header(page))
            _whole(path, page)
        except PlenoPIVError:
            raise
        except Exception as error:  # of numbers that contradict one another, each in its own way
            raise PlenoPIVError(
                f"{path}: the header of page {number + 1} cannot be read, the file is damaged ({brief(error)})"
            ) from None
        yield page


def _readable(path: Path, page: tifffile.TiffPage) -> None:
    """Raise PlenoPIVError for a page that does not hold raw monochrome counts."""
    if min(page.imagewidth, page.imagelength) < 1:
        raise PlenoPIVError(f"{path}: is {page.imagewidth} x {page.imagelength} pixels; the file is damaged")
    photometric = getattr(page.photometric, "name", str(page.photometric))
    if page.samplesperpixel != 1 or photometric not in ("MINISBLACK", "MINISWHITE"):
        raise PlenoPIVError(
            f"{path}: is a colour image ({photometric}, {page.samplesperpixel} samples per pixel); Bayer and other "
            f"colour cameras are not supported, only raw monochrome images"
        )
    if photometric == "MINISWHITE":
        raise PlenoPIVError(f"{path}: stores white as 0 (MINISWHITE); save it with black as 0")
    if page.imagedepth != 1:
        raise PlenoPIVError(f"{path}: is a volume of {page.imagedepth} slices (image depth), not an image")
    if page.dtype not in (np.uint8, np.uint16):
        raise PlenoPIVError(f"{path}: holds {page.dtype} values; {COUNTS}")


def _header(page: tifffile.TiffPage) -> Header:
    return (int(page.imagewidth), int(page.imagelength)), int(page.bitspersample)


def _whole(path: Path, page: tifffile.TiffPage) -> None:
    """Raise unless all of a page's strips or tiles are in the file: a reader would fill the rest with zeros."""
    file_bytes = path.stat().st_size
    offsets, counts = page.dataoffsets, page.databytecounts
    expected = int(np.prod(page.chunked))
    ends = [offset + count for offset, count in zip(offsets, counts, strict=False) if offset > 0 and count > 0]
    if len(ends) < expected:
        raise PlenoPIVError(
            f"{path}: {expected - len(ends)} of {expected} strips have no pixels; the file is incomplete"
        )
    if max(ends) > file_bytes:
        raise PlenoPIVError(f"{path}: is truncated: its pixels end at byte {max(ends)}, the file at {file_bytes}")
    wanted = page.imagewidth * page.imagelength * page.bitspersample // 8
    largest = max(wanted, expected * int(np.prod(page.chunks)) * page.bitspersample // 8)
    if page.compression != 1 and largest > SPARE + PACKED * file_bytes:
        raise PlenoPIVError(
            f"{path}: states {page.imagewidth} x {page.imagelength} pixels, {largest / 1e6:.3g} MB of strips or tiles, "
            f"in a file of {file_bytes / 1e6:.2g} MB; the file is damaged"
        )
    if page.compression == 1 and sum(counts) < wanted:
        raise PlenoPIVError(f"{path}: holds {sum(counts)} bytes of pixels, wanted {wanted}; the file is incomplete")
