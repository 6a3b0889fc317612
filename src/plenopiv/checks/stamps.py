"""Time stamps and camera names in the files' tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise

from plenopiv.checks.findings import Finding
from plenopiv.recording import ImageSource

TAKEN = ((36867, 37521), (306, 37520))  # DateTimeOriginal before DateTime, which software may renew; subseconds
CAMERA = ((271, "make"), (272, "model"), (50735, "serial number"))
UNEVEN = 0.1  # of dt_s by which steps between stamps may differ, where stamps are that fine


@dataclass(frozen=True)
class Stamp:
    """Time and camera (words by what they are) that a TIFF file names; None and empty where it does not."""

    taken: datetime | None
    camera: dict[str, str]


def stamp(source: ImageSource) -> Stamp:
    """Read the tags of one image; only TIFF files have any.

    Raises:
        PlenoPIVError: as ``ImageSource.size``.
    """
    tags = source.tags()
    camera = {name: _plain(str(tags[code])) for code, name in CAMERA if code in tags}
    return Stamp(_time(tags), {name: words for name, words in camera.items() if words})


def _time(tags: dict[int, object]) -> datetime | None:
    code, below = next((pair for pair in TAKEN if pair[0] in tags), (0, 0))
    text, fraction = (str(tags.get(tag, "")).strip("\0 ") for tag in (code, below))
    for form in ("%Y:%m:%d %H:%M:%S", "%Y:%m:%d %H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f"):
        try:
            taken = datetime.strptime(text, form)
        except ValueError:
            continue
        return taken + timedelta(seconds=float(f"0.{fraction}")) if fraction.isdecimal() else taken
    return None


def _plain(text: str) -> str:
    """Words of a file as a terminal may show them."""
    return "".join(c for c in text if c.isprintable()).strip()[:60]


def in_order(frames: Sequence[tuple[str, Stamp]], dt_s: float) -> Finding:
    """Whether the frames' times rise in the order in which they are named, evenly as far as stamps are given."""
    known = [(name, s.taken) for name, s in frames if s.taken is not None]
    if len(known) < 2:
        return Finding("order", "good", "the files name no times: the order of the frames is that of their names")
    steps = [(b - a).total_seconds() for (_, a), (_, b) in pairwise(known)]
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
            "name them in the order of time in recording.frames; if the times are those of a conversion, remove them",
        )
    fine = any(taken.microsecond for _, taken in known) and len(known) == len(frames)
    if fine and max(abs(step - dt_s) for step in steps) > UNEVEN * dt_s + 2e-6:
        words = f"frames are {min(steps):.6g} to {max(steps):.6g} s apart by their times, recording.dt_s is {dt_s:g}"
        advice = "correct recording.dt_s; frames must be evenly spaced: of double frames name one pair (docs/guide.md)"
        return Finding("uneven-times", "warning", words, max(steps), "s", advice)
    return Finding("order", "good", "frames are in the order of their times", float(len(known)), "times")


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
