"""``plenopiv run``: the whole chain, as ``plenopiv.run`` has it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import Outcome, command_line
from plenopiv.errors import PlenoPIVError, printable
from plenopiv.experiment import Experiment
from plenopiv.experiment.compute import ComputeTable
from plenopiv.run.workers import Workers

if TYPE_CHECKING:
    from plenopiv.run.series import RunResult

LISTED = 20  # pairs set aside that are named on the terminal
SET_ASIDE = 3  # exit code of a run that measured some of the pairs
DEVICES = get_args(ComputeTable.model_fields["device"].annotation)
Where = tuple[int | None, int | None, str | None, Path | None]


def run(
    file: Path,
    overwrite: bool,
    memory_gb: float | None = None,
    force: bool = False,
    pairs: str | None = None,
    where: Where = (None, None, None, None),
    device: str | None = None,
) -> Outcome:
    """Run an experiment file and say where the results are; ``where``: number of workers, threads of each, address of
    a scheduler, its file. ``device``: another than the file's.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, the recording is unusable, or the output folder
            holds results of other inputs.
    """
    experiment, chosen = of_option(Experiment.load(file), device), None if pairs is None else pairs_of(pairs)
    workers = workers_of(where)
    from plenopiv.run.series import run as run_series  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        result = run_series(
            experiment, progress, overwrite, memory_gb=memory_gb, force=force, pairs=chosen, workers=workers
        )
    if chosen is not None:
        (done, count), aside = result.measured, result.summary["set_aside"]
        then = " and put together" if result.is_together else f"; {command_line('run', file)} puts them together"
        text = f"{done} of {count} pairs are finished{then}"
        lines = [*set_aside(aside, min(chosen[1] + 1, count) - chosen[0]), text]
        return Outcome("\n".join(lines), {"finished": done, "pairs": count}, SET_ASIDE if aside else 0)
    return told(result)


def workers_of(where: Where) -> Workers | None:
    """The workers that options name, None where they name none.

    Raises:
        PlenoPIVError: as ``Workers``.
    """
    return Workers(*where) if any(each is not None for each in where) else None


def of_option(experiment: Experiment, device: str | None) -> Experiment:
    """An experiment on the device that ``--device`` names.

    Raises:
        PlenoPIVError: there is no such kind.
    """
    check_device(device)
    return experiment.on_device(device)


def check_device(device: str | None) -> None:
    """Raise PlenoPIVError where ``--device`` names no kind."""
    if device is not None and device not in DEVICES:
        raise PlenoPIVError(f"--device {printable(device)}: give cpu, gpu or auto")


def told(result: RunResult) -> Outcome:
    """What a finished run prints."""
    folder, summary = result.directory, result.summary
    replaced, warned = f"{100 * summary['replaced_share']:.1f} %", len(summary["warnings"])
    facts, aside = summary["not_in_images"], summary["set_aside"]
    lines = [not_in_images(facts), *set_aside(aside, summary["pairs"])]
    inside = summary.get("vectors_inside_body")
    in_body = "" if inside is None else f" ({inside} inside the body, not measured)"
    text = "\n".join(
        [
            *lines,
            f"{summary['vectors']} vectors{in_body}, {replaced} replaced, {warned or 'no'} warning{'s'[: warned != 1]}",
            f"{folder / 'velocity.nc'}",
            f"{folder / 'report.html'}: look at it before the vectors",
        ]
    )
    return Outcome(text, {"quality": summary["quality"], "set_aside": aside}, SET_ASIDE if aside else 0)


def not_in_images(facts: Mapping[str, Any]) -> str:
    """The largest displacement, and what it rests on that no image can tell (``summary.json``)."""
    moved = ", ".join(f"{voxels:.2g}" for voxels in facts["largest_displacement_voxels"])
    return (
        f"displacements of up to ({moved}) voxels along (x, y, z), {facts['largest_velocity_m_s']:.3g} m/s at "
        f'dt = {facts["dt_s"]:g} s, orientation "{facts["orientation"]}": no image tells whether these two are right;'
        " plenopiv orientation settles the second"
    )


def set_aside(aside: Sequence[Mapping[str, Any]], pairs: int) -> list[str]:
    """What was set aside of so many pairs, in lines."""
    if not aside:
        return []
    lines = [f"{len(aside)} of {pairs} pairs set aside:"]
    lines += [f"  {' and '.join(map(printable, one['frames']))}: {one['reason']}" for one in aside[:LISTED]]
    return lines + ([f"  and {len(aside) - LISTED} more, in summary.json"] if len(aside) > LISTED else [])


def pairs_of(text: str) -> tuple[int, int]:
    """The first and last pair of "FIRST-LAST", or of one number.

    Raises:
        PlenoPIVError: it is neither.
    """
    found = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", text.strip())
    if found is None:
        raise PlenoPIVError(f"--pairs {text}: give the first and last pair, counted from 0, as in --pairs 0-49")
    return int(found[1]), int(found[2] or found[1])
