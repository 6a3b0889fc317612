"""A recording: raw frames of one camera and its white image, read from TIFF files and checked one by one.

A file that is truncated, coloured, of the wrong size or of the wrong depth is an error that names it, never a
picture with zeros in it: TIFF readers fill what is missing.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.sensor import Orientation, Sensor, upright

if TYPE_CHECKING:
    import tifffile

EXIF = 34665
BULKY_TAGS = {273, 279, 324, 325, EXIF}  # where the pixels lie
SATURATED_SHARE = 1e-4  # above this a recording is warned about
TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@dataclass(frozen=True)
class Recording:
    """Frames in the order of time, ``dt_s`` apart, and the white image that shows where the microlenses are.

    Raises:
        PlenoPIVError: fewer than two frames; the white image among them; or a file that is missing, empty, no TIFF,
            truncated, in colour, of several pages, or of another size or depth than the sensor. Only file headers are
            read for this.
    """

    sensor: Sensor
    frame_paths: tuple[Path, ...]
    white_path: Path | None
    dt_s: float
    orientation: Orientation

    def __post_init__(self) -> None:
        if len(self.frame_paths) < 2:
            names = ", ".join(path.name for path in self.frame_paths) or "none"
            raise PlenoPIVError(
                f"recording.frames: {len(self.frame_paths)} frame ({names}); a velocity needs at least two"
            )
        if self.white_path in self.frame_paths:
            raise PlenoPIVError(f"{self.white_path}: is named both in recording.white and in recording.frames")
        for path in (*self.frame_paths, *([self.white_path] if self.white_path else [])):
            with _opened(path, self.sensor):
                pass

    def __len__(self) -> int:
        return len(self.frame_paths)

    def frame(self, k: int) -> NDArray[np.uint16]:
        """Frame ``k`` as counts, upright, (rows, columns). Warns where more than 0.01 % of its pixels are saturated.

        Raises:
            PlenoPIVError: the pixels cannot be decoded, exceed the bit depth, or are all equal.
        """
        return self._image(self.frame_paths[k])

    def white(self) -> NDArray[np.uint16] | None:
        """The white image, like ``frame``; None where the recording has none."""
        return None if self.white_path is None else self._image(self.white_path)

    def _image(self, path: Path) -> NDArray[np.uint16]:
        counts = read_image(path, self.sensor)
        share = np.count_nonzero(counts >= self.sensor.full_scale) / counts.size
        if share > SATURATED_SHARE:
            warnings.warn(
                f"{path}: {100 * share:.2g} % of the pixels are saturated ({self.sensor.full_scale} counts); their "
                f"light is underestimated",
                PlenoPIVWarning,
                stacklevel=3,
            )
        return np.ascontiguousarray(upright(counts, self.orientation))


def find_frames(folder: Path, pattern: str, leave_out: Path | None = None) -> tuple[Path, ...]:
    """Files of a glob in natural order (a2 before a10), without ``leave_out`` (the white image).

    Raises:
        PlenoPIVError: nothing matches, or the pattern is none.
    """
    try:
        # Path.glob takes no absolute patterns: split off the root.
        root = Path(pattern).anchor
        found = Path(root).glob(str(Path(pattern).relative_to(root))) if root else folder.glob(pattern)
        paths = sorted((p for p in found if p.is_file()), key=lambda p: natural_order(p.as_posix()))
    except (ValueError, NotImplementedError) as error:
        raise PlenoPIVError(f"recording.frames: {pattern!r} is no file pattern ({error})") from None
    kept = tuple(p for p in paths if leave_out is None or p.resolve() != leave_out.resolve())
    if not kept:
        raise PlenoPIVError(f"recording.frames: no file matches {pattern!r} in {folder.resolve()}")
    return kept


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Sort key that reads digits as numbers: frame2 before frame10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part.casefold()) for part in re.split(r"(\d+)", name)]


def read_image(path: Path, sensor: Sensor | None = None) -> NDArray[np.uint16]:
    """Counts of one TIFF file as stored, (rows, columns). Without a sensor its size and depth are not compared.

    Raises:
        PlenoPIVError: as ``Recording`` does, and where the pixels do not decode, exceed the bit depth or are all equal.
    """
    with _opened(path, sensor) as page:
        try:
            counts = page.asarray()
        except Exception as error:  # every codec fails in its own way
            raise PlenoPIVError(f"{path}: its pixels do not decode, the file is damaged ({_brief(error)})") from None
    highest = int(counts.max())
    if sensor is not None and highest > sensor.full_scale:
        shift = 16 - sensor.bit_depth
        aligned = counts.dtype == np.uint16 and not (counts & ((1 << shift) - 1)).any()
        hint = (
            f"all values are multiples of {1 << shift}, so it is stored left-aligned: set bit_depth = 16 and scale "
            f"black_level by {1 << shift}"
            if aligned
            else "set camera.sensor.bit_depth to what the camera wrote"
        )
        raise PlenoPIVError(
            f"{path}: holds the value {highest}, above full scale of {sensor.bit_depth} bits, "
            f"{sensor.full_scale}; {hint}"
        )
    if highest == int(counts.min()):
        raise PlenoPIVError(f"{path}: every pixel is {highest}; the image is blank")
    return counts.astype(np.uint16, copy=False)


def image_size(path: Path) -> tuple[int, int]:
    """(columns, rows) of a TIFF file, from its header.

    Raises:
        PlenoPIVError: missing, empty, no TIFF, truncated, in colour or of several pages.
    """
    with _opened(path, None) as page:
        return int(page.imagewidth), int(page.imagelength)


def tiff_tags(path: Path) -> dict[int, object]:
    """Values of the tags of a TIFF file by their code, those of its EXIF block too.

    Raises:
        PlenoPIVError: as ``image_size`` does.
    """
    with _opened(path, None) as page:
        tags = {tag.code: tag.value for tag in page.tags if tag.code not in BULKY_TAGS}
        names = _exif_codes()
        for name, value in (page.tags.valueof(EXIF, {}) or {}).items():
            if name in names:
                tags.setdefault(names[name], value)
    return tags


def _exif_codes() -> dict[str, int]:
    import tifffile

    return {name: code for code, name in tifffile.TIFF.EXIF_TAGS.items()}


@contextmanager
def _page(path: Path) -> Iterator:
    """The only page of a TIFF file."""
    import tifffile

    try:
        with path.open("rb") as file:
            start = file.read(4)
    except FileNotFoundError:
        raise PlenoPIVError(f"{path}: no such file") from None
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
    if not start:
        raise PlenoPIVError(f"{path}: is empty (0 bytes); copy it again")
    if start not in TIFF_SIGNATURES:
        raise PlenoPIVError(f"{path}: is no TIFF file; only TIFF is read, so convert it without loss")
    logger = logging.getLogger("tifffile")
    was_disabled, logger.disabled = logger.disabled, True  # it logs what is raised here in one line
    try:
        try:
            tif = tifffile.TiffFile(path)
            pages = len(tif.pages)
        except Exception as error:
            raise PlenoPIVError(
                f"{path}: its TIFF header cannot be read, the file is damaged ({_brief(error)})"
            ) from None
        with tif:
            if pages != 1:
                way_out = "save each frame as a file of its own" if pages else "copy it again"
                raise PlenoPIVError(f"{path}: holds {pages} images, wanted one; {way_out}")
            yield tif.pages[0]
    finally:
        logger.disabled = was_disabled


@contextmanager
def _opened(path: Path, sensor: Sensor | None) -> Iterator:
    """The page of a file whose header fits the sensor. Nothing is decoded before its size is known to be right."""
    with _page(path) as page:
        photometric = getattr(page.photometric, "name", str(page.photometric))
        if page.samplesperpixel != 1 or photometric not in ("MINISBLACK", "MINISWHITE"):
            raise PlenoPIVError(
                f"{path}: is a colour image ({photometric}, {page.samplesperpixel} samples per pixel); Bayer and other "
                f"colour cameras are not supported, only raw monochrome images"
            )
        if photometric == "MINISWHITE":
            raise PlenoPIVError(f"{path}: stores white as 0 (MINISWHITE); save it with black as 0")
        size = (int(page.imagewidth), int(page.imagelength))
        if sensor is not None and size != (sensor.columns, sensor.rows):
            raise PlenoPIVError(
                f"{path}: is {size[0]} x {size[1]} pixels (columns x rows), but camera.sensor says "
                f"{sensor.columns} x {sensor.rows}"
            )
        if page.dtype not in (np.uint8, np.uint16):
            raise PlenoPIVError(f"{path}: holds {page.dtype} values; raw images hold 8- or 16-bit unsigned counts")
        if sensor is not None and page.bitspersample <= 8 < sensor.bit_depth:
            raise PlenoPIVError(
                f"{path}: holds {page.bitspersample} bits per pixel, but camera.sensor.bit_depth is {sensor.bit_depth}"
                f"; save the raw counts, or set bit_depth = {page.bitspersample} and its black_level"
            )
        _whole(path, page)
        yield page


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
    if page.compression == 1 and sum(counts) < wanted:
        raise PlenoPIVError(f"{path}: holds {sum(counts)} bytes of pixels, wanted {wanted}; the file is incomplete")


def _brief(error: Exception) -> str:
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return text if len(text) <= 100 else f"{text[:97]}..."
