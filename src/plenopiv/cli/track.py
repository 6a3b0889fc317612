"""``plenopiv track``: particles and their tracks."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.cli.run import LISTED, SET_ASIDE, Where, workers_of
from plenopiv.cli.terminal import Outcome
from plenopiv.errors import printable
from plenopiv.experiment import Experiment


def track(file: Path, overwrite: bool, where: Where = (None, None, None, None)) -> Outcome:
    """Track the particles of an experiment, and say where they are; ``where``: as for ``run``.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, or there are tracks of other inputs.
    """
    experiment = Experiment.load(file)
    workers = workers_of(where)
    from plenopiv.run.track import track as track_all  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        result = track_all(experiment, progress, overwrite, workers)
    summary = result.summary
    counts, pairs, aside = list(summary["particles"].values()), summary["pairs"], summary["set_aside"]
    std = ", ".join(f"{1e3 * each:.2g}" for each in summary["median_std_mm"])
    lines = []
    if aside:
        lines.append(f"{len(aside)} of {pairs} pairs set aside:")
        lines += [f"  {' and '.join(map(printable, one['frames']))}: {one['reason']}" for one in aside[:LISTED]]
    lines += [
        f"{sum(counts)} particles in {len(counts)} frames, {sum(summary['linked'])} links in {pairs} "
        f"pair{'s'[: pairs != 1]}; median standard deviation ({std}) um along (x, y, z)",
        f"{result.path}",
        f"{result.velocity}",
    ]
    facts = {
        "tracks": str(result.path),
        "velocity": str(result.velocity),
        "particles": counts,
        "linked": summary["linked"],
        "set_aside": aside,
    }
    return Outcome("\n".join(lines), facts, SET_ASIDE if aside else 0)
