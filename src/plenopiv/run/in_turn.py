"""Pairs measured one after the other in this process, each frame reconstructed once."""

from __future__ import annotations

import logging
from collections.abc import Generator, Sequence

from plenopiv.kernels import compile_seconds
from plenopiv.run import duration
from plenopiv.run.frame import Frame, LostFrame, Progress
from plenopiv.run.log import Clock
from plenopiv.run.pair import Job, PairRecord
from plenopiv.run.plan import Plan
from plenopiv.run.shown import Shown

log = logging.getLogger("plenopiv")


def in_turn(
    job: Job, numbers: Sequence[int], planned: Plan, clock: Clock, report: Progress, shown: Shown
) -> Generator[PairRecord, None, None]:
    """The records of the pairs ``numbers``, in their order, their fields written; after the first frame, what time is
    left is told."""
    pairs, held, told = job.recording.pairs, dict[int, Frame | LostFrame](), False
    frames = len({k for number in numbers for k in pairs[number]})
    for number in numbers:
        held = {k: frame for k, frame in held.items() if k in pairs[number]}
        for k in pairs[number]:
            if k in held or any(isinstance(held.get(other), LostFrame) for other in pairs[number]):
                continue
            before_it = compile_seconds()
            with clock("reconstruction"):
                held[k] = job.frame(k, report)
            if not told and isinstance(held[k], Frame):
                told = True
                took = clock.seconds["reconstruction"] - (compile_seconds() - before_it)
                left = planned.takes.left(frames, took, len(numbers), compile_seconds())
                log.info("%s reconstructed; about %s left", held[k].source.name, duration.as_text(left))
        before, after = (held.get(k) or job.not_asked(k) for k in pairs[number])
        shown.see(number, before)
        with clock("correlation"):
            record = job.pair(number, before, after, report)
        del before, after  # their volumes are not held while the next one is made
        yield record
