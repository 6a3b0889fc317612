"""The images of a folder, and what they are by their names, pages and sizes; for ``plenopiv init``."""

from __future__ import annotations

import unicodedata
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from plenopiv.cli.template import toml
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.recording import find_frames, naming, natural_order
from plenopiv.recording.formats import SEPARATOR, image_datasets, unlike_images
from plenopiv.recording.pairs import pairs as pairs_of
from plenopiv.recording.sources import ImageSource, only_source, sources_of

FORMATS = ((".tif", ".tiff"), (".im7",), (".h5", ".hdf5"), (".png",), (".npy",))  # the first that has frames is taken
NOT_USED = {
    "white": "one white image is enough",
    "dark": "one dark image is enough",
    "background": "one image of the background is enough, or one for each pulse of pairs",
    "target": "of a calibration target, by the name",
    "mask": "a mask, by the name",
}

Names = tuple[str, ...]
TALL = 1.5  # rows of a column: no sensor is so
NamesOfPairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Frames:
    """Frames as ``[recording]`` names them: a sequence (``frames``), or ``pairs``, perhaps ``stacked``.

    ``words``: what they were taken for; ``doubt``: how the experiment file says the other reading, "" without one.
    """

    words: str
    frames: str | Names | None = None
    pairs: str | NamesOfPairs | None = None
    stacked: bool = False
    doubt: str = ""


@dataclass(frozen=True)
class FolderImages:
    """A folder's images. ``columns`` and ``rows``: of one frame; ``lines``: what was taken for what."""

    white: str
    dark: str | None
    background: Names
    frames: Frames
    columns: int
    rows: int
    lines: tuple[tuple[str, str], ...]


def folder_images(folder: Path, sensor_rows: object = None) -> FolderImages:
    """Recognise a folder's images; ``sensor_rows`` as the optics sheet states them, None where it does not.

    Raises:
        PlenoPIVError: no white image or several, fewer than two frames, images of several sizes, a frame of a pair
            without the other, pages that are neither frames nor pairs, or a file that cannot be read.
    """
    by_format = _names(folder)
    everything = [name for names in by_format for name in names]
    if not everything:
        none = f"{folder}: holds no images; .tif, .png, .npy, .h5 and .im7 files are read"
        raise PlenoPIVError("; ".join([none, *_unlike_images(folder)]))
    with_frames = (names for names in by_format if any(naming.role(name) is None for name in names))
    names = next(with_frames, everything)
    roles: dict[str, list[str]] = defaultdict(list)
    for name in names:
        roles[naming.role(name) or "frame"].append(name)
    roles["white"] = roles["white"] or [name for name in everything if naming.role(name) == "white"]
    white = _white(folder, roles["white"], len(roles["frame"]))
    chosen = _alike(roles["frame"])

    dark, background = roles["dark"][:1], roles["background"][:2]
    sources: dict[str, tuple[ImageSource, ...]]
    sources = {name: (only_source(folder / name),) for name in (white, *dark, *background)}
    of_frames, damaged = _of_frames(folder, chosen)
    columns, rows, stacked = _sizes(sources | of_frames, white, list(of_frames), sensor_rows)
    like = next(iter(of_frames.values()), ())
    sources |= of_frames | dict.fromkeys(damaged, like)
    frames = _read(folder, sources, chosen, stacked, [white, *dark, *background])
    if len(background) == 2 and not (frames.pairs is not None and naming.are_pulses(*background)):
        del background[1]

    lines = [("white", white), *(("dark", name) for name in dark)]
    if background:
        lines.append(("background", " + ".join(background) + (", one for each pulse" if background[1:] else "")))
    lines.append(("frames" if frames.pairs is None else "pairs", frames.words))
    used = {white, *dark, *background, *chosen}
    unused: dict[str, list[str]] = defaultdict(list)
    for name in everything:
        role = naming.role(name)
        if name not in used:
            unused[NOT_USED[role] if role else "named or stored unlike the frames"].append(name)
    lines += [("not used", f"{_span(names)}: {why}") for why, names in unused.items()]
    odd = _unlike_most(chosen) if frames.pairs is None else []
    if odd:
        lines.append(
            ("look at", f"{_span(odd)}: among the frames, and named unlike the others; move away what is none")
        )
    if sensor_rows is None and not stacked and rows > TALL * columns:
        words = f"images are {columns} x {rows} pixels: do they hold two each, one above the other? The optics sheet's"
        lines.append(("look at", f"{words} sensor.rows would tell; save the half of {white} that is the white image"))
    lines += [("look at", f"{error}; a run sets aside what it belongs to") for error in damaged.values()]
    shown = tuple((what, printable(words)) for what, words in lines)
    return FolderImages(white, dark[0] if dark else None, tuple(background), frames, columns, rows, shown)


def _names(folder: Path) -> list[list[str]]:
    """Image files of each of ``FORMATS``, data sets of HDF5 files one by one, in natural order."""
    try:
        files = sorted((p for p in folder.iterdir() if p.is_file()), key=lambda p: natural_order(p.name))
    except OSError as error:
        raise PlenoPIVError(f"{folder}: cannot be read ({error.strerror})") from None
    found: list[list[str]] = []
    for endings in FORMATS:
        names = [p.name for p in files if p.suffix.lower() in endings and not p.name.startswith(".")]
        if ".h5" in endings and not any(naming.role(name) is None for earlier in found for name in earlier):
            names = [f"{name}{SEPARATOR}{inside}" for name in names for inside in image_datasets(folder / name)]
        found.append(names)
    for name in (name for names in found for name in names):
        if any(unicodedata.category(c) in ("Cc", "Cs") for c in name):
            raise PlenoPIVError(f"{folder / printable(name)}: its name holds characters that are no text; rename it")
    return found


def _unlike_images(folder: Path) -> list[str]:
    """What the first HDF5 file of a folder holds that might be images and is not, in words."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".h5", ".hdf5"))
    return [f"{files[0].name}{SEPARATOR}{words}" for words in unlike_images(files[0])[:1]] if files else []


def _sources(folder: Path, name: str) -> tuple[ImageSource, ...]:
    return sources_of(folder / name)


def _of_frames(folder: Path, names: list[str]) -> tuple[dict[str, tuple[ImageSource, ...]], dict[str, PlenoPIVError]]:
    """Images of each frame's file, and what is wrong with those that cannot be read.

    Raises:
        PlenoPIVError: half of them cannot be read.
    """
    sources, damaged = dict[str, tuple[ImageSource, ...]](), dict[str, PlenoPIVError]()
    for name in names:
        try:
            found = _sources(folder, name)
            found[0].size()
            sources[name] = found
        except PlenoPIVError as error:
            damaged[name] = error
    if damaged and 2 * len(damaged) >= len(names):
        raise next(iter(damaged.values()))
    return sources, damaged


def _white(folder: Path, found: list[str], frames: int) -> str:
    """The white image; of two for both pulses the first."""
    if len(found) == 1 or (len(found) == 2 and naming.are_pulses(*found)):
        return found[0]
    if not found:
        raise PlenoPIVError(f"{folder}: needs one white image (white*, calib* or flat*); found none")
    names = ", ".join(map(printable, found[:4])) + (f" and {len(found) - 4} more" if found[4:] else "")
    why = "keep one" if frames else "keep one, and rename those that are frames"
    raise PlenoPIVError(f"{folder}: needs one white image (white*, calib* or flat*); found {names}: {why}")


def _alike(names: list[str]) -> list[str]:
    """The names that are frames: all, or where some kind of them are evidently pairs, those alone."""
    if naming.looks_like_pairs(names) is not None:
        return names
    kinds: dict[naming.Words, list[str]] = defaultdict(list)
    for name in names:
        kinds[naming.kind(name)].append(name)
    return max((each for each in kinds.values() if naming.looks_like_pairs(each)), key=len, default=names)


def _unlike_most(names: Sequence[str]) -> list[str]:
    """Names of another kind than most, where most are of one."""
    kinds: dict[naming.Words, list[str]] = defaultdict(list)
    for name in names:
        kinds[naming.kind(name)].append(name)
    most = max(kinds.values(), key=len)
    return [name for name in names if name not in most] if len(most) > max(2, len(names) / 2) else []


def _sizes(
    sources: dict[str, tuple[ImageSource, ...]], white: str, frames: Sequence[str], sensor_rows: object
) -> tuple[int, int, bool]:
    """(columns, rows) of one frame, and whether files hold two, one above the other."""
    size = {name: found[0].size() for name, found in sources.items()}
    columns, rows = size[white]
    if rows == 2 * (sensor_rows if isinstance(sensor_rows, int) else 0):
        raise PlenoPIVError(
            f"{sources[white][0]}: has {rows} rows, twice those of the sensor; save the half that is the white image"
        )
    stacked = bool(frames) and size[frames[0]] == (columns, 2 * rows)
    doubled = set(frames) if stacked else set()
    for name, found in sources.items():
        wanted = (columns, 2 * rows) if name in doubled else (columns, rows)
        if size[name] != wanted:
            other = frames[0] if name in doubled else white
            raise PlenoPIVError(
                f"{found[0].path}: is {size[name][0]} x {size[name][1]} pixels, but {other} is "
                f"{size[other][0]} x {size[other][1]}; all images must come from one sensor; move others away"
            )
    return columns, rows, stacked


def _read(
    folder: Path,
    sources: dict[str, tuple[ImageSource, ...]],
    names: list[str],
    stacked: bool,
    others: Sequence[str],
) -> Frames:
    """Which frames belong together."""
    if not names:
        none = f"{folder}: holds 0 frames beside {others[0]}; a velocity needs two"
        raise PlenoPIVError("; ".join([none, *_unlike_images(folder)]))
    pages, leave_out = len(sources[names[0]]), [folder / name for name in others]
    for name in names:
        if len(sources[name]) != pages:
            held = len(sources[name])
            raise PlenoPIVError(f"{folder / name}: holds {held} images, {names[0]} {pages}; save as many in each")
    found = naming.looks_like_pairs(names)
    if found is not None:
        return _by_name(folder, found, 2 * pages if stacked else pages, leave_out)
    if len(names) == 2 and pages > 1 and SEPARATOR in names[0] and naming.are_pulses(*names):
        words = f"{pages} of a double-frame camera, the images of {names[0]} with those of {names[1]}"
        return Frames(words, pairs=((names[0], names[1]),))
    count, files = pages * len(names), _span(names)
    if count < 2 and not stacked:
        raise PlenoPIVError(f"{folder}: holds {count} frame beside {others[0]}; a velocity needs two")
    if pages == 1 and not stacked:
        return Frames(f"{count}, a sequence: {files}", frames=tuple(names))
    pattern = _pattern(folder, names, leave_out)
    if stacked:
        doubt = 'the upper half is taken for the first pulse; if it is the second, write stacked = "bottom-first"'
        words = f"{count} of a double-frame camera, two frames in each image of {files}; {doubt}"
        return Frames(words, pairs=pattern, stacked=True, doubt=doubt)
    if pages == 2:
        doubt = "" if len(names) == 1 else f"if they are one sequence, write frames = {toml(pattern)} instead of pairs"
        words = f"{len(names)} of a double-frame camera, the pages of {files}"
        return Frames("; ".join(filter(None, (words, doubt))), pairs=pattern, doubt=doubt)
    doubt = f"if pages 1 and 2, 3 and 4, ... are pairs, write pairs = {toml(pattern)} instead of frames"
    words, doubt = f"{count}, a sequence: the pages of {files}", "" if pages % 2 else doubt
    return Frames("; ".join(filter(None, (words, doubt))), frames=pattern, doubt=doubt)


def _by_name(folder: Path, found: naming.NamedPairs, images: int, leave_out: Sequence[Path]) -> Frames:
    """Pairs that names say; ``images``: in each file."""
    if found.alone:
        more = f" (so are {len(found.alone) - 1} more)" if found.alone[1:] else ""
        raise PlenoPIVError(
            f"{folder / found.alone[0]}: is one frame of a pair by its name, and the other is missing{more}; "
            "add or move it away"
        )
    first, last = (" + ".join(found.pairs[k]) for k in (0, -1))
    if images > 1:
        raise PlenoPIVError(
            f"{folder}: {first} are a pair by their names and hold {images} images each: which belong together cannot "
            "be told; save each image as a file of its own"
        )
    words = f"{len(found.pairs)} of a double-frame camera, {first} to {last}"
    return Frames(words, pairs=_pairs(folder, found, leave_out))


def _pairs(folder: Path, found: naming.NamedPairs, leave_out: Sequence[Path]) -> str | NamesOfPairs:
    """A pattern, where it finds these pairs and no others; else their names."""
    try:
        frames, numbers = pairs_of(folder, found.pattern, None, leave_out) if found.pattern else ((), ())
    except PlenoPIVError:
        return found.pairs
    same = sorted((frames[a].path.name, frames[b].path.name) for a, b in numbers) == sorted(found.pairs)
    return found.pattern if same else found.pairs


def _pattern(folder: Path, names: list[str], leave_out: Sequence[Path]) -> str:
    """A pattern of files that hold several images each."""
    pattern = naming.glob_of(names)
    if not pattern and len({name.partition(SEPARATOR)[2] for name in names}) > 1:
        raise PlenoPIVError(
            f"{folder / names[0]}: {names[1]} is another data set; store all images in data sets of one name, or name "
            "both pulses' by a and b"
        )
    if not pattern:
        raise PlenoPIVError(f"{folder / names[0]}: no pattern can name it and the like; rename without any of *?[]{{}}")
    found = [path.name for path in find_frames(folder, pattern, leave_out)]
    extra = sorted({*found} - {Path(name).name for name in names})
    if extra:
        raise PlenoPIVError(f"{folder / extra[0]}: cannot be told from the frames by a pattern; rename or move it away")
    return pattern


def _span(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) < 3 else f"{names[0]} to {names[-1]} ({len(names)} files)"
