"""``plenopiv track``: particles and their tracks."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.cli.terminal import Outcome
from plenopiv.experiment import Experiment


def track(file: Path, overwrite: bool) -> Outcome:
    """Track the particles of an experiment, and say where they are.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, or there are tracks already.
    """
    experiment = Experiment.load(file)
    from plenopiv.run.track import track as track_all  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        result = track_all(experiment, progress, overwrite)
    counts = list(result.particles.values())
    std = ", ".join(f"{1e3 * each:.2g}" for each in result.median_std_mm)
    links = sum(result.linked)
    text = "\n".join(
        [
            f"{sum(counts)} particles in {len(counts)} frames, {links} links in {len(result.linked)} "
            f"pair{'s'[: len(result.linked) != 1]}; median standard deviation ({std}) um along (x, y, z)",
            f"{result.path}",
        ]
    )
    return Outcome(text, {"tracks": str(result.path), "particles": counts, "linked": result.linked})
