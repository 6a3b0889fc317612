"""PlenoPIV: from raw images of one plenoptic camera to a volumetric velocity field.

The same as ``plenopiv run experiment.toml``, in Python:

    import plenopiv

    experiment = plenopiv.load("experiment.toml")
    result = plenopiv.process(experiment)
    print(result.velocity.w.max(), result.summary["replaced_share"])

The stages, a subpackage each: recording -> lightfield -> reconstruction (volume) -> displacement -> velocity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["PlenoPIVError", "PlenoPIVWarning", "compare", "correlate", "load", "process", "statistics_of"]

from plenopiv.errors import PlenoPIVError, PlenoPIVWarning

if TYPE_CHECKING:
    from pathlib import Path

    import xarray

    from plenopiv.comparison import Comparison
    from plenopiv.experiment import Experiment
    from plenopiv.run.series import RunResult


def load(path: str) -> Experiment:
    """Read an experiment file; see ``plenopiv.experiment.Experiment``."""
    from plenopiv.experiment import Experiment  # here: importing plenopiv stays fast

    return Experiment.load(path)


def process(experiment: Experiment | str | Path, **options: Any) -> RunResult:
    """Run an experiment, or that of a file, from raw images to a results folder; see ``plenopiv.run.series.run``."""
    from plenopiv.experiment import Experiment
    from plenopiv.run.series import run as run_series

    return run_series(experiment if isinstance(experiment, Experiment) else Experiment.load(experiment), **options)


def compare(a: str, b: str) -> Comparison:
    """Two results side by side, each a results folder or a velocity.nc; see ``plenopiv.run.compared.compare``."""
    from plenopiv.run.compared import compare as compare_results

    return compare_results(a, b)


def correlate(results: str, **options: Any) -> RunResult:
    """Measure vectors again from the volumes of a results folder, with other keys of [correlation]; see
    ``plenopiv.run.correlate.correlate``."""
    from plenopiv.run.correlate import correlate as measure_again

    return measure_again(results, **options)


def statistics_of(results: str, **options: Any) -> xarray.Dataset:
    """Mean, RMS, Reynolds stresses and skewness of a run's pairs, each with its uncertainty; see
    ``plenopiv.io.series_statistics.statistics_of``."""
    from plenopiv.io.series_statistics import statistics_of as of_file

    return of_file(results, **options)
