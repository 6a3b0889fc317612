"""``plenopiv track``: particles and their tracks."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.cli.run import SET_ASIDE, Where, not_in_images, set_aside, workers_of
from plenopiv.cli.terminal import Outcome
from plenopiv.experiment import Experiment


def track(file: Path, overwrite: bool, where: Where = (None, None, None, None), force: bool = False) -> Outcome:
    """Track the particles of an experiment, and say where they are; ``where``, ``force``: as for ``run``.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, or there are tracks of other inputs.
    """
    experiment = Experiment.load(file)
    workers = workers_of(where)
    from plenopiv.run.track import track as track_all  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        result = track_all(experiment, progress, overwrite, workers, force)
    summary = result.summary
    counts, pairs, aside = list(summary["particles"].values()), summary["pairs"], summary["set_aside"]
    std = ", ".join(f"{1e3 * each:.2g}" for each in summary["median_std_mm"] or ())
    lines = [
        not_in_images(summary["not_in_images"]),
        *set_aside(aside, pairs),
        f"{sum(counts)} particles in {len(counts)} frames, {sum(summary['linked'])} links in {pairs} "
        f"pair{'s'[: pairs != 1]}; median standard deviation ({std}) um along (x, y, z)",
        *(f"{path}" for path in (result.path, result.velocity) if path is not None),
    ]
    facts = {
        "quality": summary["quality"],
        "tracks": str(result.path),
        "velocity": None if result.velocity is None else str(result.velocity),
        "particles": counts,
        "linked": summary["linked"],
        "set_aside": aside,
    }
    return Outcome("\n".join(lines), facts, SET_ASIDE if aside else 0)
