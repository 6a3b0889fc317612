"""``plenopiv correlate``: vectors from the volumes that a run kept, with other windows."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from plenopiv.cli.phases import phases_of
from plenopiv.cli.progress import Progress
from plenopiv.cli.run import check_device, told
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import PlenoPIVError

SIZE = r"\d{1,5}x\d{1,5}x\d{1,5}"


@dataclass(frozen=True)
class Together:
    """Options of ensembles."""

    ensemble: bool
    phase: Path | None
    bins: int | None
    period: float | None


def correlate(
    results: Path,
    windows: str | None,
    inner_window: str | None,
    out: Path | None,
    overwrite: bool,
    together: Together,
    device: str | None = None,
    **others: Any,
) -> Outcome:
    """Measure again, and say where the results are. ``device``: another than the run's; ``others``: keys of
    [correlation] that are numbers.

    Raises:
        PlenoPIVError: there are no volumes, they or the settings cannot be used, or the output folder holds results of
            other inputs; the file of phases cannot be used.
    """
    if together.phase is not None and not together.ensemble:
        raise PlenoPIVError("--phase: averages correlations; give --ensemble too (of fields: plenopiv statistics)")
    check_device(device)
    changed = {
        "windows": None if windows is None else sizes_of(windows, "--windows"),
        "inner_window": None if inner_window is None else sizes_of(inner_window, "--inner-window", 1)[0],
        **others,
    }
    from plenopiv.run.correlate import correlate as measure_again

    options: dict[str, Any] = {"out": out, "overwrite": overwrite, "ensemble": together.ensemble, "device": device}
    phases, bins = phases_of(together.phase, together.bins, together.period)
    if phases is not None:
        options |= {"phases": phases, "bins": bins}
    with Progress() as progress:
        result = measure_again(results, progress=progress, **options, **changed)
    outcome = told(result)
    if (summed := result.summary.get("ensemble")) is None:
        return outcome
    return replace(outcome, text=f"{_said(**summed)}\n{outcome.text}")


def _said(pairs: list[int], pairs_left_out: int, phase: list[float] | None = None) -> str:
    """How many pairs make the fields."""
    total, count = sum(pairs), len(pairs)
    each = ", ".join(f"{p:g}: {n}" for p, n in zip(phase or [], pairs, strict=False))
    of_phases = f"phase {each}; " if each else ""
    text = f"{total} pair{'s'[: total != 1]} in {count} ensemble{'s'[: count > 1]}"
    return f"{text} ({of_phases}{pairs_left_out} left out)"


def sizes_of(text: str, option: str, most: int | None = None) -> list[list[int]]:
    """Window sizes of text such as "64x64x16,48x48x12".

    Raises:
        PlenoPIVError: it is no such text, or lists more than ``most``.
    """
    parts = [part.strip().lower() for part in text.split(",")]
    if not all(re.fullmatch(SIZE, part) for part in parts) or (most is not None and len(parts) > most):
        example = "48x48x12" if most == 1 else "64x64x16,48x48x12"
        raise PlenoPIVError(f"{option} {text}: give voxels along x, y, z, as in {option} {example}")
    return [[int(side) for side in part.split("x")] for part in parts]
