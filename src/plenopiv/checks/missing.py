"""Frames of a sequence that are missing by the numbers in their names: what lies between their neighbours is longer."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

from plenopiv.checks.findings import Finding
from plenopiv.checks.reversal import file_names
from plenopiv.errors import printable
from plenopiv.recording import Recording

FEWEST = 3  # frames that tell by how much numbers grow
MOST = 0.25  # of the steps that are longer: more, and the numbers count something else


def of_names(recording: Recording) -> Finding | None:
    """A finding where numbers of a sequence's frames leave some out."""
    names = file_names(recording) if recording.is_sequence else ()
    if not (after := left_out(names)):
        return None
    first, second = (printable(names[k]) for k in (after[0], after[0] + 1))
    more = f", and {len(after) - 1} more such steps" if after[1:] else ""
    return Finding(
        "missing-frame",
        "warning",
        f"by their numbers frames are missing between {first} and {second}{more}: what moved there in several steps "
        "counts as one, and later times are too early",
        float(len(after)),
        "steps",
        "put the missing frames back; where they are lost, an empty file of each one's name sets the pairs aside",
    )


def left_out(names: Sequence[str]) -> list[int]:
    """The frames, from 0, after which numbers in the ``names`` leave some out; none where the names do not count."""
    parts = [re.split(r"(\d+)", name) for name in names]
    if len(names) < FEWEST or len({len(part) for part in parts}) > 1:
        return []
    vary = [column for column in zip(*parts, strict=True) if len(set(column)) > 1]
    if len(vary) != 1 or not all(word.isdecimal() for word in vary[0]):
        return []
    numbers = [int(word) for word in vary[0]]
    steps = [b - a for a, b in pairwise(numbers)]
    usual = Counter(steps).most_common(1)[0][0]
    longer = [k for k, step in enumerate(steps) if step != usual]
    counted = usual > 0 and all(steps[k] > usual and steps[k] % usual == 0 for k in longer)
    return longer if counted and len(longer) <= max(MOST * len(steps), 1) else []
