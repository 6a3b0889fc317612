"""Frames that are one image: copied, written twice by the camera's software, or on another scale of counts.

No two exposures are alike bit by bit: where light falls, photons are counted anew. All files are compared at a few
places, which takes little more than opening them; the pixels of a few pairs are compared whole.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plenopiv.checks.findings import Finding
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.recording import Recording
from plenopiv.sensor import Sensor, middle, middle_of

SIDE_PX = 1600  # of the sensor's middle that is compared in pixels
PAIRS = 3  # compared in pixels
PIECE = 1 << 14  # bytes that are compared at each of some places of a file
PLACES = (0.2, 0.4, 0.6, 0.8)  # of its length
MOST_READ = 8  # files that look alike and are read whole, to be sure
LIT = 90.0  # per cent of the pixels below those that are compared: the brightest, where photons make most noise
NOISE = 1.5  # times what rounding leaves between two scales of one image; two exposures differ by more
FAINT = 20.0  # counts of spread below which the brightest pixels tell nothing

TWICE = "copy the recording again; where the camera wrote a frame twice, leave that pair out"
OF_OTHERS = "copy the recording again, or leave one of them out: its velocities would count twice"
LOST = (
    "copy the recording again; where the camera repeated a frame another one is lost, and the pair before or after, "
    "which spans two steps, is twice as fast: an empty file of its name sets a frame's pairs aside"
)


def findings(recording: Recording) -> list[Finding]:
    """Pairs whose frames are one image, and frames of different pairs that are.

    Raises:
        PlenoPIVError: a frame cannot be read.
    """
    same = _same_files(recording)
    within = [pair for pair, (a, b) in enumerate(recording.pairs) if (a, b) in same]
    count = len(recording.pairs)
    for pair in sorted({round(k) for k in np.linspace(0, count - 1, min(count, PAIRS))} - set(within)):
        a, b = recording.pairs[pair]
        try:
            same_pair = same_image(_middle(recording, a), _middle(recording, b), recording.sensor)
        except PlenoPIVError:  # a damaged frame is a finding of its own
            continue
        if same_pair:
            within.append(pair)
    out = []
    if within:
        names = [printable(recording.frames[k].name) for k in recording.pairs[within[0]]]
        more = f", and so are {len(within) - 1} more" if within[1:] else ""
        out.append(
            Finding(
                "same-frame",
                "unusable" if 2 * len(within) >= min(count, PAIRS) else "warning",
                f"{names[0]} and {names[1]} are one image, down to its noise{more}: nothing moves between them",
                float(len(within)),
                "pairs",
                LOST if recording.without_pulses else TWICE,
            )
        )
    others = sorted(same - set(recording.pairs))
    if others:
        a, b = (printable(recording.frames[k].name) for k in others[0])
        words = f"{a} and {b} are one image" + (f" ({len(others)} such frames)" if others[1:] else "")
        advice = LOST if recording.without_pulses else OF_OTHERS
        out.append(Finding("same-frame", "warning", words, float(len(others)), "frames", advice))
    return out


def same_image(a: NDArray, b: NDArray, sensor: Sensor) -> bool:
    """Whether counts are those of one exposure, equal or on another scale: b is a line of a, but for its rounding."""
    if np.array_equal(a, b):
        return True
    first, second = a.ravel().astype(float), b.ravel().astype(float)
    use = (first >= np.percentile(first, LIT)) & (first < sensor.full_scale) & (second < sensor.full_scale)
    first, second = first[use], second[use]
    if first.size < 100 or min(first.std(), second.std()) < FAINT:
        return False
    slope = np.cov(first, second)[0, 1] / first.var(ddof=1)
    rest = (second - second.mean()) - slope * (first - first.mean())
    rounding = np.sqrt((1 + slope**2) / 12)
    return bool(slope > 0 and np.median(np.abs(rest)) < NOISE * 0.6745 * rounding)


def _middle(recording: Recording, k: int) -> NDArray:
    return middle_of(recording.frame(k), middle(recording.sensor, SIDE_PX, SIDE_PX))


def _same_files(recording: Recording) -> set[tuple[int, int]]:
    """Numbers of frames, each a file of its own, whose counts are equal: neighbours in the order of the recording."""
    alike: dict[tuple[int, bytes], list[int]] = defaultdict(list)
    for k, frame in enumerate(recording.frames):
        if k in recording.damaged:
            continue
        if frame.pages == 1 and frame.half is None and not frame.dataset:
            alike[_pieces(frame.path)].append(k)
    found: set[tuple[int, int]] = set()
    read = 0
    for numbers in alike.values():
        for a, b in pairwise(numbers):
            if read >= MOST_READ and not found:
                return found  # images that are alike in most places, black ones: pixels decide
            try:
                same = read >= MOST_READ or np.array_equal(recording.frame(a), recording.frame(b))
            except PlenoPIVError:  # a blank frame, say: a finding of its own
                continue
            if same:
                found.add((a, b))
            read += 1
    return found


def _pieces(path: Path) -> tuple[int, bytes]:
    """A file's length, and some of it."""
    try:
        length = path.stat().st_size
        with path.open("rb") as file:
            pieces = []
            for place in PLACES:
                file.seek(int(place * length))
                pieces.append(file.read(PIECE))
    except OSError as error:
        raise PlenoPIVError(f"{path}: cannot be read ({error.strerror})") from None
    return length, b"".join(pieces)
