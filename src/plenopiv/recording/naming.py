"""What the names of image files say: which are dark, background and white images, and which two are one pair.

Names are read word by word: runs of digits, of letters (``frameA`` is two words) and single separators.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

Role = Literal["white", "dark", "background", "target", "mask"]
Words = tuple[str, ...]

BEGINNINGS: dict[Role, Words] = {
    "target": ("target",),
    "white": ("white", "calib", "flat"),
    "dark": ("dark",),
    "background": ("background", "bg", "static"),
    "mask": ("mask",),
}  # of a name's first word, or of its last one beside the pulse and numbers
MEANT_AS = {
    "white": "a white image: name it in recording.white",
    "dark": "a dark image: name it in recording.dark",
    "background": "an image of the background: name it in recording.background",
    "target": "an image of a calibration target: no frame",
    "mask": "a mask: no frame",
}
WORD = re.compile(r"\d+|[A-Z]+(?![a-z])|[A-Z]?[^\W\dA-Z_]+|[A-Z]|[\W_]")
PULSE_LETTERS = tuple((p + "a", p + "b") for p in ("", "l", "laser", "pulse", "frame", "image", "img", "exposure"))
PULSE_WORDS = (*PULSE_LETTERS, ("first", "second"))
PULSE_NUMBERS = ((0, 1), (1, 2))
LASERS = {"la", "laser", "pulse"}  # words whose number says the pulse, wherever they stand
NUMBERED = {*LASERS, "frame", "exposure"}
SPECIAL = set("*?[]{}")  # in patterns


@dataclass(frozen=True)
class NamedPairs:
    """Names of double frames. ``pattern``: as ``recording.pairs`` takes it, "" where none can be written; ``pairs`` in
    natural order; ``alone``: names without a partner."""

    pattern: str
    pairs: tuple[tuple[str, str], ...]
    alone: Words


def role(name: str) -> Role | None:
    """What else than a frame a file is by its name (``dark_01.tif``, ``run7_white.tif``); None for all others."""
    words = [word.lower() for word in WORD.findall(_stem(name)) if word[0].isalpha()]
    while len(words) > 1 and any(words[-1] in pulses for pulses in PULSE_WORDS):
        words.pop()  # background_a; white_frameA is "white", "frame", "a"
    if len(words) > 2 and words[-1] in NUMBERED:
        words.pop()
    return next(
        (
            found
            for found, beginnings in BEGINNINGS.items()
            if words and (words[0].startswith(beginnings) or words[-1].startswith(beginnings))
        ),
        None,
    )


def spelled_out(pattern: str) -> Role | None:
    """The role that the letters of a pattern itself say: ``flat_plate_*.tif`` asks for such names."""
    return role(re.sub(r"\[[^\]]*\]|\{[^}]*\}|[*?]", "0", pattern))


def are_pulses(first: str, second: str) -> bool:
    """Whether two names are those of both pulses, first and second: they differ in one word that says so."""
    a, b = (WORD.findall(_stem(name)) for name in (first, second))
    return len(a) == len(b) and [_pulses(u, v) for u, v in zip(a, b, strict=True) if u != v] == [True]


def looks_like_pairs(names: Sequence[str]) -> NamedPairs | None:
    """The pairs that names of three files or more are evidently made of, or None where they may be a sequence.

    ``names``: with ``/`` between folders, in natural order. Known are A/B, a/b, 0/1, 1/2, LaserPulse0/1, frameA/frameB,
    first/second, and the like, where all other words of two names are the same. Numbers say a pulse only in the last
    word or after one such as "pulse": ``frame_1, frame_2, frame_3`` and ``frame_1, frame_2`` are sequences. Where names
    say a pulse by letters or a laser's number, one whole pair is enough; else as many as names without a partner.
    """
    if len(names) < 3:
        return None
    words = [WORD.findall(_stem(name)) for name in names]
    shortest = min(map(len, words))
    places = [*range(-1, -shortest - 1, -1), *(range(shortest) if shortest < max(map(len, words)) else ())]
    found = (
        _pairs_at(names, words, place, accepts)
        for accepts in (_by_letters, _by_laser, _by_last_number, _by_number)
        for place in places
    )
    possible = [each for each in found if each is not None]
    # Most names in pairs are the better reading: a_1_La0, a_1_La1, b_1_La0, ... of two cameras are pairs of pulses.
    likely = (each for each, _ in possible if len(each.alone) <= len(each.pairs))
    return next(likely, next((each for each, one_is_enough in possible if one_is_enough), None))


def glob_of(names: Sequence[str]) -> str:
    """A pattern of what names have in common at their beginning and end; "" where none can be written."""
    datasets = {name.partition("::")[2] for name in names}
    files = [PurePosixPath(name.partition("::")[0]) for name in names]
    endings = {file.suffix for file in files}
    if len(datasets) > 1 or len(endings) > 1 or any(SPECIAL & set(name) for name in names):
        return ""
    dataset = datasets.pop()
    stems = [WORD.findall(str(file).removesuffix(file.suffix)) for file in files]
    return _common(stems) + endings.pop() + (f"::{dataset}" if dataset else "")


def kind(name: str) -> Words:
    """A name's words without numbers and pulses: alike for the frames of a recording."""
    pulses = {word for both in PULSE_WORDS for word in both}
    words = ["0" if word.isdecimal() else word for word in WORD.findall(_stem(name))]
    return tuple("pulse" if word.lower() in pulses else word for word in words)


def _stem(name: str) -> str:
    """A name without its ending, data sets of HDF5 files included."""
    file, separator, dataset = name.partition("::")
    ending = PurePosixPath(file).suffix
    return (file.removesuffix(ending) if ending else file) + separator + dataset


def _pulses(first: str, second: str) -> bool:
    """Whether two words say first and second pulse."""
    if first.isdecimal() and second.isdecimal():
        return len(first) == len(second) and (int(first), int(second)) in PULSE_NUMBERS
    return first.isupper() == second.isupper() and (first.lower(), second.lower()) in PULSE_WORDS


def _by_letters(words: list[list[str]], place: int) -> bool:
    return not words[0][place].isdecimal()


def _by_laser(words: list[list[str]], place: int) -> bool:
    return _word_before(words[0], place) in LASERS


def _by_last_number(words: list[list[str]], place: int) -> bool:
    return place == -1 and words[0][place].isdecimal()


def _by_number(words: list[list[str]], place: int) -> bool:
    return _word_before(words[0], place) in NUMBERED


def _word_before(words: list[str], place: int) -> str:
    """The word that a number belongs to; "" where there is none."""
    before = [word.lower() for word in words[:place] if word[0].isalnum()]
    return before[-1] if before and words[place].isdecimal() else ""


def _pairs_at(
    names: Sequence[str], words: list[list[str]], place: int, accepts: Callable[[list[list[str]], int], bool]
) -> tuple[NamedPairs, bool] | None:
    """Pairs that differ in the word at a place alone, and whether one of them says that all names are of pairs; None
    where there is none."""
    said = sorted({w[place] for w in words})
    if len(said) != 2 or not accepts(words, place):
        return None
    first, second = said if _pulses(*said) else said[::-1]
    if not _pulses(first, second):
        return None
    sides: dict[tuple[Words, Words, str], dict[str, int]] = defaultdict(dict)
    for k, w in enumerate(words):
        after = () if place == -1 else tuple(w[place + 1 :])
        sides[tuple(w[:place]), after, PurePosixPath(names[k].partition("::")[0]).suffix][w[place]] = k
    whole = {key: side for key, side in sides.items() if len(side) == 2}
    alone = tuple(names[k] for side in sides.values() if len(side) == 1 for k in side.values())
    if not whole:
        return None
    pairs = tuple((names[side[first]], names[side[second]]) for side in whole.values())
    pattern, endings = "", {key[2] for key in sides}
    if len(endings) == 1 and not any(SPECIAL & set(name) or "::" in name for name in names):
        around = [_common([list(key[side]) for key in sides]) for side in (0, 1)]
        pattern = f"{around[0]}{{{first},{second}}}{around[1]}{endings.pop()}"
    return NamedPairs(pattern, pairs, alone), accepts in (_by_letters, _by_laser)


def _common(lists: list[list[str]]) -> str:
    """Words that all lists begin and end with, and a star between them where they differ."""
    if all(words == lists[0] for words in lists):
        return "".join(lists[0])
    shortest = min(map(len, lists))
    begin = next((k for k in range(shortest) if len({w[k] for w in lists}) > 1), shortest)
    end = next((k for k in range(shortest - begin) if len({w[-1 - k] for w in lists}) > 1), shortest - begin)
    return "".join(lists[0][:begin]) + "*" + "".join(lists[0][len(lists[0]) - end :])
