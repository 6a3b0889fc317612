"""What is kept about a run while it goes on: seconds and memory by stage, and warnings."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from plenopiv.errors import PlenoPIVWarning
from plenopiv.run.memory import peak_so_far


class Clock:
    """Seconds of wall time by stage, and the peak of memory (GB) that the run had reached at its end."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_gb: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """What happens within belongs to ``stage``."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
            if (peak := peak_so_far()) is not None:
                self.peak_gb[stage] = round(peak / 1e9, 3)


@contextmanager
def kept_warnings() -> Iterator[list[warnings.WarningMessage]]:
    """Collect PlenoPIV's warnings, each once, and still show them where and when they occur."""
    caught: list[warnings.WarningMessage] = []
    show = warnings.showwarning
    with warnings.catch_warnings():
        warnings.simplefilter("always", PlenoPIVWarning)

        def keep(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, PlenoPIVWarning) and str(message) not in [str(w.message) for w in caught]:
                caught.append(warnings.WarningMessage(message, category, filename, lineno, file, line))
                show(message, category, filename, lineno, file, line)

        warnings.showwarning = keep
        yield caught
