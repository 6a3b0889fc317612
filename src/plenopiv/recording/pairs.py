"""Which images belong together: frames of a sequence, and pairs of a double-frame camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from plenopiv.errors import PlenoPIVError
from plenopiv.recording import formats, naming
from plenopiv.recording.sources import ImageSource, frame_source, sources_of

Stacked = Literal["top-first", "bottom-first"]
BRACES = re.compile(r"\{([^{},]*),([^{},]*)\}")

Frames = tuple[ImageSource, ...]
Pairs = tuple[tuple[int, int], ...]


def sequence(folder: Path, named: str | Sequence[str], leave_out: Sequence[Path] = ()) -> Frames:
    """The frames of a pattern, or of a list of files, in the order of time; a file of several pages holds as many.

    Raises:
        PlenoPIVError: nothing matches, a file cannot be used, or files hold different numbers of images.
    """
    paths = find_frames(folder, named, leave_out) if isinstance(named, str) else [folder / name for name in named]
    files = _of_files(paths)
    for path, images in zip(paths, files, strict=True):
        if len(images) != len(files[0]):
            raise PlenoPIVError(
                f"{path}: holds {len(images)} images, {paths[0].name} {len(files[0])}; frames are a file each, or pages"
            )
    return tuple(source for images in files for source in images)


def _of_files(paths: Sequence[Path]) -> list[Frames]:
    """The images of each file. Where files hold one each, one that cannot be read counts as one too."""
    files: list[Frames] = []
    unread: list[PlenoPIVError] = []
    for path in paths:
        try:
            files.append(sources_of(path))
        except PlenoPIVError as error:
            unread.append(error)
            files.append((frame_source(path),))
    if unread and any(len(images) > 1 for images in files):
        raise unread[0]
    return files


def pairs(
    folder: Path,
    named: str | Sequence[tuple[str, str]],
    stacked: Stacked | None = None,
    leave_out: Sequence[Path] = (),
) -> tuple[Frames, Pairs]:
    """The frames of pairs, and which of them are one: (first, second) numbers.

    ``named``: a pattern with braces for the two pulses, ``"run_*_{a,b}.tif"``; one without, of files whose pages are
    the two pulses of a pair, or of several one after the other; or a list of two names each. Of two names each may hold
    many images, the first pulses and the second ones. ``stacked``: every image has double height and holds both pulses.

    Raises:
        PlenoPIVError: nothing matches, a file has no partner or one of another number of images, pages do not come in
            twos, or a file cannot be used.
    """
    if not isinstance(named, str):
        found = [pair for a, b in named for pair in _of_both(folder / a, folder / b)]
    elif stacked is not None:
        _without_braces(named, "stacked images hold both pulses")
        images = [source for path in find_frames(folder, named, leave_out) for source in sources_of(path)]
        found = [image.halves(stacked) for image in images]
    elif "{" in named:
        found = [pair for a, b in _partners(folder, named, leave_out) for pair in _of_both(a, b)]
    else:
        found = []
        for path in find_frames(folder, named, leave_out):
            pages = sources_of(path)
            if len(pages) % 2:
                raise PlenoPIVError(
                    f"{path}: holds {len(pages)} image(s), and pulses come in twos; name single images by braces, as "
                    'in recording.pairs = "run_*_{a,b}.tif", or as recording.frames'
                )
            found += list(zip(pages[::2], pages[1::2], strict=True))
    frames = tuple(frame for pair in found for frame in pair)
    return frames, tuple((2 * k, 2 * k + 1) for k in range(len(found)))


def _of_both(first: Path, second: Path) -> list[tuple[ImageSource, ImageSource]]:
    """The images of two files, each with the one that stands at the same place in the other."""
    one, other = _images(first), _images(second)
    if len(one) != len(other):
        counts = [len(sources_of(path)) for path in (first, second)]  # a damaged one is told of here
        raise PlenoPIVError(f"{second}: holds {counts[1]} image(s), {first.name} {counts[0]}; both pulses have as many")
    return list(zip(one, other, strict=True))


def _images(path: Path) -> Frames:
    """The images of a file; one that cannot be read counts as one image."""
    try:
        return sources_of(path)
    except PlenoPIVError:
        return (frame_source(path),)


def _partners(folder: Path, pattern: str, leave_out: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Files of a pattern with braces, each with the one that differs by what the braces say alone."""
    braces = BRACES.findall(pattern)
    if len(braces) != 1 or braces[0][0] == braces[0][1]:
        raise PlenoPIVError(
            f"recording.pairs: {pattern!r}: give one pair of braces with the two pulses' names, as in run_*_{{a,b}}.tif"
        )
    before, after = BRACES.sub("\0", pattern).split("\0")
    first, second = (before + word + after for word in braces[0])
    if "*" not in first and "?" not in first and "[" not in first:
        paths = [(folder / first, folder / second)]
    else:
        key = [_wildcards(one) for one in (first, second)]
        sides = [
            {key[n](path, folder): path for path in find_frames(folder, one, leave_out)}
            for n, one in enumerate((first, second))
        ]
        alone = [sides[n][k] for n in (0, 1) for k in sides[n].keys() - sides[1 - n].keys()]
        if alone:
            names = ", ".join(path.name for path in sorted(alone)[:3])
            more = f" and {len(alone) - 3} more" if len(alone) > 3 else ""
            raise PlenoPIVError(
                f"recording.pairs: {names}{more} has no partner by {pattern!r}; add or move it away, or list the pairs"
            )
        paths = [(sides[0][k], sides[1][k]) for k in sorted(sides[0], key=lambda k: [natural_order(w) for w in k])]
    return paths


def _wildcards(pattern: str) -> Callable[[Path, Path], tuple[str, ...]]:
    """A function that says what the wildcards of a pattern stand for in a path below a folder."""
    parts = re.split(r"(\*\*/|\*|\?|\[[^\]]*\])", Path(pattern).as_posix())
    said = {"**/": "((?:.*/)?)", "*": "([^/]*)", "?": "([^/])", "[[]": r"(\[)"}  # the last: of glob.escape
    expression = "".join(
        said.get(part, f"({part.replace('[!', '[^')})" if part.startswith("[") and n % 2 else re.escape(part))
        for n, part in enumerate(parts)
    )

    def words(path: Path, folder: Path) -> tuple[str, ...]:
        name = path.as_posix() if Path(pattern).is_absolute() else path.relative_to(folder).as_posix()
        found = re.fullmatch(expression, name)
        return found.groups() if found else (name,)

    return words


def _without_braces(pattern: str, why: str) -> None:
    if "{" in pattern:
        raise PlenoPIVError(f"recording.pairs: {pattern!r}: {why}, so there are no braces")


def find_frames(folder: str | Path, pattern: str, leave_out: Path | Sequence[Path] | None = None) -> tuple[Path, ...]:
    """Files of a glob in natural order (a2 before a10), without ``leave_out`` (white image, dark, background), and
    without hidden ones where the pattern begins with no dot.

    ``pattern`` may name a data set of HDF5 files: ``run_*.h5::frames``.

    Raises:
        PlenoPIVError: nothing matches, the pattern is none, or a file is a dark, background or white image by its name,
            which the pattern does not spell out.
    """
    folder = Path(folder)
    files, dataset = formats.split(Path(pattern))
    if not files.name:  # "." or "/", of which pathlib makes no pattern
        raise PlenoPIVError(
            f"recording.frames: {pattern!r} is no file pattern (it names a folder); add one, as in *.tif"
        )
    glob, inside = str(files), f"{formats.SEPARATOR}{dataset}" if dataset else ""
    try:
        # Path.glob takes no absolute patterns: split off the root.
        root = files.anchor
        found = Path(root).glob(str(files.relative_to(root))) if root else folder.glob(glob)
        hidden = files.name.startswith(".")  # "._a.tif" lies beside "a.tif" where a Mac was: no image
        shown = (p for p in found if hidden or not p.name.startswith("."))
        there = (p for p in shown if p.is_file() or (p.is_symlink() and not p.exists()))  # links to nothing are told of
        paths = sorted(there, key=lambda p: natural_order(p.as_posix()))
    except (ValueError, NotImplementedError) as error:
        raise PlenoPIVError(f"recording.frames: {pattern!r} is no file pattern ({error})") from None
    others = [leave_out] if isinstance(leave_out, Path) else list(leave_out or ())
    apart = {_place(other) for other in others}
    named = [Path(f"{path}{inside}") for path in paths]
    kept = tuple(p for p in named if _place(p) not in apart)
    if not kept:
        raise PlenoPIVError(f"recording.frames: no file matches {pattern!r} in {folder.resolve()}")
    _refuse_other_images(kept, pattern)
    return kept


def _place(path: Path) -> Path:
    """Where a file really lies; of a link to itself, where the link lies: it is told of when it is read."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # RuntimeError before Python 3.13
        return path.absolute()


def _refuse_other_images(paths: Sequence[Path], pattern: str) -> None:
    """Raise PlenoPIVError where a pattern takes an image for a frame that is none by its name."""
    asked = naming.spelled_out(Path(pattern).name)
    any_folder = bool(naming.SPECIAL & set(str(Path(pattern).parent)))
    others = [(path, role) for path in paths if (role := naming.role(path.name)) not in (None, asked)]
    others += [(path, role) for path in paths if any_folder and (role := naming.role(path.parent.name))]
    if others:
        (path, role), count = others[0], len(others) - 1
        assert role is not None
        more = f" ({count} more like it)" if count else ""
        raise PlenoPIVError(
            f"{path}: the pattern {pattern!r} takes it for a frame, and by its name it is "
            f"{naming.MEANT_AS[role]}{more}, or move it away; a list, or a pattern that begins with the name, takes it"
        )


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Sort key that reads digits as numbers: frame2 before frame10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part.casefold()) for part in re.split(r"(\d+)", name)]
