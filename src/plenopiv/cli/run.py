"""``plenopiv run``: the whole chain, as ``plenopiv.run`` has it."""

from __future__ import annotations

from pathlib import Path

from plenopiv.cli.progress import Progress
from plenopiv.experiment import Experiment


def run(file: Path, overwrite: bool, memory_gb: float | None = None) -> str:
    """Run an experiment file and say where the results are.

    Raises:
        PlenoPIVError: the experiment file or its images are wrong, or the output folder holds a complete run.
    """
    experiment = Experiment.load(file)
    from plenopiv.run.frames import run as run_frames  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        run_frames(experiment, progress, overwrite, memory_gb=memory_gb)
    folder = experiment.output_directory
    return f"{folder / 'velocity.nc'}\n{folder / 'report.html'}"
