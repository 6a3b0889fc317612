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
    from plenopiv.run.series import run as run_series  # here: a mistake in the file is told before the kernels load

    with Progress() as progress:
        result = run_series(experiment, progress, overwrite, memory_gb=memory_gb)
    folder, summary = experiment.output_directory, result.summary
    replaced, warned = f"{100 * summary['replaced_share']:.1f} %", len(summary["warnings"])
    return "\n".join(
        [
            f"{summary['vectors']} vectors, {replaced} replaced, {warned or 'no'} warning{'s'[: warned != 1]}",
            f"{folder / 'velocity.nc'}",
            f"{folder / 'report.html'}: look at it before the vectors",
        ]
    )
