"""Time stamps and camera names in the files: TIFF tags, attributes of HDF5 data sets, texts of PNG files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from typing import Any

from plenopiv.checks.findings import Finding
from plenopiv.recording import ImageSource
from plenopiv.recording.attributes import attributes_of

TAKEN = ((36867, 37521), (306, 37520))  # DateTimeOriginal before DateTime, which software may renew; subseconds
CAMERA = ((271, "make"), (272, "model"), (50735, "serial number"))
NAMES = ("acquisition_time", "timestamp", "time_stamp", "time", "creation time", "creation_time", "datetime", "t")
UNITS = {"": Decimal(1), "_s": Decimal(1), "_ms": Decimal("1e-3"), "_us": Decimal("1e-6"), "_ns": Decimal("1e-9")}
ORIENTATION, AS_STORED = 274, 1
LAST = ("time of change",)  # of a file, where it says nothing else
DATE = re.compile(
    r"(\d{4})[-:](\d\d)[-:](\d\d)[T ](\d\d):(\d\d):(\d\d)(?:[.,](\d{1,12}))?\s*(Z|[+-]\d\d:?\d\d)?", re.ASCII
)
NUMBER = re.compile(r"[+-]?\d{1,18}\.\d{1,18}", re.ASCII)
UNEVEN = 0.1  # of dt_s by which steps between stamps may differ, beside what stamps are rounded to
ON_AVERAGE = 0.02  # and their mean
FLOAT_DIGITS = 16  # of a time as a float
LONGER = 3.0  # times the steps within pairs that those between them are, at least, where times show pairs

Marks = Sequence[tuple[str, "Stamp"]]


@dataclass(frozen=True)
class Stamp:
    """What a file says of an image: its time in s, from 1970 or from a beginning of its own, exact; how finely it is
    given, in s; and the camera (words by what they are). None and empty where it does not."""

    taken_s: Decimal | None
    camera: dict[str, str]
    rounded_to_s: Decimal = Decimal(1)


def stamp(source: ImageSource) -> Stamp:
    """Read the tags or attributes of one image.

    Raises:
        PlenoPIVError: as ``ImageSource.size``.
    """
    tags = source.tags()
    camera = {name: _plain(str(tags[code])) for code, name in CAMERA if code in tags}
    taken = _time_of_tags(tags) if tags else _time_of(attributes_of(source))
    return Stamp(taken, {name: words for name, words in camera.items() if words}, _rounded_to(taken))


def _time_of_tags(tags: dict[int, object]) -> Decimal | None:
    code, below = next((pair for pair in TAKEN if pair[0] in tags), (0, 0))
    text, fraction = (str(tags.get(tag, "")).strip("\0 ") for tag in (code, below))
    taken = _time_of_text(text)
    return taken + Decimal(f"0.{fraction}") if taken is not None and re.fullmatch(r"[0-9]{1,12}", fraction) else taken


def _time_of(attributes: dict[str, Any]) -> Decimal | None:
    """The time that attributes say, by the first of ``NAMES`` that is one; whole numbers without a unit are none."""
    for name in NAMES:
        for ending, unit in UNITS.items():
            value = attributes.get(name + ending)
            if isinstance(value, bytes):
                value = value.decode("utf-8", "replace")
            taken = None
            if isinstance(value, str):
                taken = _time_of_text(value.strip("\0 "))
            elif isinstance(value, float) and abs(value) < 1e18:  # NaN is not
                taken = Decimal(f"{value:.{FLOAT_DIGITS}g}")
            elif isinstance(value, int) and not isinstance(value, bool) and ending:
                taken = Decimal(value)
            if taken is not None:
                return taken * unit
    return next((_time_of_text(str(attributes[name])) for name in LAST if name in attributes), None)


def _time_of_text(text: str) -> Decimal | None:
    """Seconds of an ISO date and time, or TIFF's; or of a number with a point."""
    if NUMBER.fullmatch(text):
        return Decimal(text)
    found = DATE.fullmatch(text)
    if found is None:
        return None
    *numbers, fraction, zone = found.groups()
    try:
        at = datetime(*map(int, numbers), tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return None
    hours = Decimal(0)
    if zone and zone != "Z":
        digits = zone[1:].replace(":", "")
        hours = (Decimal(digits[:2]) + Decimal(digits[2:]) / 60) * (1 if zone[0] == "+" else -1)
    return Decimal(int(at.timestamp())) + Decimal(f"0.{fraction or 0}") - 3600 * hours


def _rounded_to(taken: Decimal | None) -> Decimal:
    """The place of the last digit that a time has, at most a second."""
    exponent = 0 if taken is None else taken.normalize().as_tuple().exponent
    return Decimal(1).scaleb(min(0, exponent)) if isinstance(exponent, int) else Decimal(1)


def _plain(text: str) -> str:
    """Words of a file as a terminal may show them."""
    return "".join(c for c in text if c.isprintable()).strip()[:60]


def in_order(frames: Marks, dt_s: float, pairs: Sequence[tuple[int, int]] = ()) -> Finding:
    """Whether the frames' times rise in the order in which they are named, ``dt_s`` apart as far as stamps are so fine.

    ``pairs``: (first, second) numbers of frames, where these are no sequence: then ``dt_s`` is within each of them.
    """
    known = [(name, s.taken_s) for name, s in frames if s.taken_s is not None]
    if len(known) < 2:
        return Finding("order", "good", "the files name no times: the order of the frames is that of their names")
    steps = [float(b - a) for (_, a), (_, b) in pairwise(known)]
    back = [k for k, step in enumerate(steps) if step < 0]
    if back:
        first, second = known[back[0]], known[back[0] + 1]
        return Finding(
            "out-of-order",
            "unusable",
            f"frames are out of order by their times: {second[0]} was taken {-steps[back[0]]:g} s before {first[0]} "
            f"but comes after it ({len(back)} such step{'s'[: len(back) > 1]})",
            float(len(back)),
            "steps back",
            f"name them in the order of time in recording.{'pairs' if pairs else 'frames'}; if the times are those of "
            "a conversion, remove them",
        )
    in_time = Finding("order", "good", "frames are in the order of their times", float(len(known)), "times")
    finest = float(min(s.rounded_to_s for _, s in frames if s.taken_s is not None))
    if finest >= 1 or len(known) < len(frames) or not any(steps):
        return in_time
    return (_within_pairs(frames, dt_s, pairs, finest) if pairs else _evenly(steps, dt_s, finest)) or in_time


def _evenly(steps: list[float], dt_s: float, finest: float) -> Finding | None:
    """A finding where a sequence's frames are not ``dt_s`` apart."""
    odd, even = steps[::2], steps[1::2]
    for short, long in ((odd, even), (even, odd)):
        if len(steps) > 2 and min(long) > LONGER * max(*short, finest):
            words = (
                f"by their times frames are pairs, {max(short):.6g} s apart, with {min(long):.6g} s or more from one "
                "pair to the next, and they are read as one sequence"
            )
            advice = "name them in recording.pairs instead of recording.frames"
            return Finding("pairs-as-sequence", "unusable", words, max(short), "s", advice)
    mean = sum(steps) / len(steps)
    off = max(abs(step - dt_s) for step in steps)
    if off <= UNEVEN * dt_s + finest and abs(mean - dt_s) <= ON_AVERAGE * dt_s + finest / len(steps):
        return None
    words = f"frames are {min(steps):.6g} to {max(steps):.6g} s apart by their times, recording.dt_s is {dt_s:g}"
    advice = "correct recording.dt_s; frames must be evenly spaced: name double frames in recording.pairs"
    return Finding("uneven-times", "warning", words, max(steps), "s", advice)


def _within_pairs(frames: Marks, dt_s: float, pairs: Sequence[tuple[int, int]], finest: float) -> Finding | None:
    """A finding where the two frames of pairs are not ``dt_s`` apart; None where both bear one time."""
    times = [s.taken_s for _, s in frames]
    both = [(times[a], times[b]) for a, b in pairs]
    steps = [float(second - first) for first, second in both if first is not None and second is not None]
    if not any(steps) or max(abs(step - dt_s) for step in steps) <= UNEVEN * dt_s + finest:
        return None
    words = (
        f"the two frames of a pair are {min(steps):.6g} to {max(steps):.6g} s apart by their times, recording.dt_s is "
        f"{dt_s:g}"
    )
    advice = "correct recording.dt_s, the time between both pulses; if the times are those of writing, remove them"
    return Finding("uneven-times", "warning", words, max(steps), "s", advice)


def same_camera(frame: tuple[str, Stamp], white: tuple[str, Stamp]) -> Finding | None:
    """A finding where the files name two different cameras."""
    for what in frame[1].camera.keys() & white[1].camera.keys():
        one, other = frame[1].camera[what], white[1].camera[what]
        if one != other:
            return Finding(
                "other-camera",
                "unusable",
                f"{white[0]} names the camera {what} '{other}', {frame[0]} '{one}'",
                advice="take the white image with the camera of the frames",
            )
    return None


def orientation(source: ImageSource) -> int:
    """How a viewer should turn or mirror an image by its TIFF tag: 1 as it is stored, and where it says nothing.

    Raises:
        PlenoPIVError: as ``ImageSource.size``.
    """
    value = source.tags().get(ORIENTATION, AS_STORED)
    return value if isinstance(value, int) else AS_STORED


def turned(images: Sequence[tuple[str, int]]) -> Finding | None:
    """A finding where files say that they are to be shown turned or mirrored; ``images``: names and their tags."""
    named = [(name, tag) for name, tag in images if tag != AS_STORED]
    if not named:
        return None
    name, tag = named[0]
    return Finding(
        "orientation-tag",
        "warning",
        f"{name} is to be shown turned or mirrored by its TIFF tag (orientation {tag}); counts are taken as stored",
        float(tag),
        "",
        "check recording.orientation with a printed letter (docs/frame-and-units.md), then save without the tag",
    )
