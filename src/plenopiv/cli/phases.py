"""The options --phase, --bins and --period, which averages over series and ensembles share."""

from __future__ import annotations

from pathlib import Path

from plenopiv.errors import PlenoPIVError
from plenopiv.statistics.phase import BINS, PERIOD, Phases


def phases_of(phase: Path | None, bins: int | None, period: float | None) -> tuple[Phases | None, int]:
    """Phases as the options have them, None without --phase, and the number of bins.

    Raises:
        PlenoPIVError: the file cannot be used; bins or a period without phases.
    """
    if phase is not None:
        return Phases.read(phase, PERIOD if period is None else period), BINS if bins is None else bins
    for option, value in (("--bins", bins), ("--period", period)):
        if value is not None:
            raise PlenoPIVError(
                f"{option} {value:g}: is of the phases that --phase names; give --phase, or leave it out"
            )
    return None, BINS
