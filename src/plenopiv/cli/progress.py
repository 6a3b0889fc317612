"""Progress of long work: bars where a person watches, a line for each stage elsewhere."""

from __future__ import annotations

import sys
from time import perf_counter
from typing import Any

QUIET_S = 2.0  # work shorter than this shows nothing


class Progress:
    """A callable ``progress(stage, done, total)`` that shows how far each stage is.

    Use as a context manager. On a terminal every stage is a bar that appears once the work has taken two seconds;
    elsewhere (a log, a cluster) a line is printed when a stage ends that took longer than that.
    """

    def __init__(self) -> None:
        self._bars: Any = None  # rich's, once there is something to show
        self._tasks: dict[str, int] = {}
        self._started: dict[str, float] = {}
        self._ended: set[str] = set()
        self._terminal = sys.stderr.isatty()
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
        self._started.setdefault(stage, now)
        if self._terminal:
            self._draw(now)
            if self._bars is not None:
                self._bars.update(self._tasks[stage], completed=done, total=total)
        elif done >= total and stage not in self._ended:
            self._ended.add(stage)
            took = now - self._started[stage]
            if took >= QUIET_S:
                print(f"plenopiv: {stage}: {took:.1f} s", file=sys.stderr, flush=True)

    def _draw(self, now: float) -> None:
        if self._bars is None and now - self._begin >= QUIET_S:
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bars

            self._bars = Bars(
                TextColumn("{task.description}"),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                console=Console(stderr=True),
            )
            self._bars.start()
        if self._bars is not None:
            for stage in self._started:
                if stage not in self._tasks:
                    self._tasks[stage] = self._bars.add_task(stage, total=1.0)
