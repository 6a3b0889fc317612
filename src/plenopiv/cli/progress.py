"""Progress of long work: bars where a person watches, lines elsewhere, JSON for programs."""

from __future__ import annotations

import sys
from time import perf_counter
from typing import Any

from plenopiv.cli.terminal import terminal

QUIET_S = 2.0  # work shorter than this shows nothing
LINE_S = 30.0  # between two lines of one stage, off a terminal
EVENT_S = 1.0  # the same as JSON
MOST_BARS = 8  # at once; of a long series the bars of stages that ended make room


class Progress:
    """A callable ``progress(stage, done, total)`` that shows how far each stage is, and when it will be done.

    Use as a context manager. On a terminal every stage is a bar that appears once the work has taken two seconds, the
    last few of them; elsewhere (a log, a cluster) a line is printed when a stage ends that took longer than that, and
    every half minute before. ``--json`` makes events of it, ``--quiet`` leaves it out.
    """

    def __init__(self) -> None:
        self._bars: Any = None  # rich's, once there is something to show
        self._tasks: dict[str, int] = {}
        self._started: dict[str, float] = {}
        self._shown: dict[str, float] = {}
        self._ended: set[str] = set()
        self._on_terminal = sys.stderr.isatty()
        self._begin = perf_counter()

    def __enter__(self) -> Progress:
        self._begin = perf_counter()
        return self

    def __exit__(self, *failure: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """``done`` of ``total`` parts of a stage's work are done."""
        now = perf_counter()
        begin = self._started.setdefault(stage, now)
        if terminal.quiet:
            return
        if terminal.as_json:
            self._event(stage, done, total, now, now - begin)
        elif self._on_terminal:
            if done >= total:
                self._ended.add(stage)
            self._draw(now)
            if self._bars is not None:
                self._bars.update(self._tasks[stage], completed=done, total=total)
            self._make_room()
        else:
            self._line(stage, done, total, now, now - begin)

    def _line(self, stage: str, done: int, total: int, now: float, took: float) -> None:
        if stage in self._ended:
            return
        if done >= total:
            self._ended.add(stage)
            if took >= QUIET_S:
                print(f"plenopiv: {stage}: {took:.1f} s", file=sys.stderr, flush=True)
        elif now - self._shown.setdefault(stage, now) >= LINE_S:
            self._shown[stage] = now
            from plenopiv.run.duration import as_text  # here: the command line alone loads nothing of it

            left = left_s(done, total, took)
            ahead = "" if left is None else f", about {as_text(left)} left"
            print(f"plenopiv: {stage}: {100 * done / total:.0f} %{ahead}", file=sys.stderr, flush=True)

    def _event(self, stage: str, done: int, total: int, now: float, took: float) -> None:
        ends = done >= total and stage not in self._ended
        if ends or now - self._shown.get(stage, -EVENT_S) >= EVENT_S:
            self._shown[stage] = now
            self._ended |= {stage} if ends else set()
            left = left_s(done, total, took)
            eta = None if left is None else round(left, 1)
            terminal.event("progress", stage=stage, done=done, total=total, elapsed_s=round(took, 1), eta_s=eta)

    def _draw(self, now: float) -> None:
        if self._bars is None and now - self._begin >= QUIET_S:
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as Bars

            self._bars = Bars(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
            )
            self._bars.start()
        if self._bars is not None:
            for stage in self._started:
                if stage not in self._tasks:
                    self._tasks[stage] = self._bars.add_task(stage, total=1.0)

    def _make_room(self) -> None:
        """Forget the stages that ended first."""
        gone = [stage for stage in self._started if stage in self._ended][: max(len(self._started) - MOST_BARS, 0)]
        for stage in gone:
            del self._started[stage]
            self._ended.discard(stage)
            if (bar := self._tasks.pop(stage, None)) is not None:
                self._bars.remove_task(bar)


def left_s(done: int, total: int, took: float) -> float | None:
    """Seconds until a stage ends if it goes on as it did; None before anything is done."""
    return took * (total - done) / done if done > 0 else None
