"""Vectors measured again from the volumes that a run kept, with other windows: nothing is reconstructed."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numba

from plenopiv.chain import Chain
from plenopiv.errors import PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.run import duration, memory
from plenopiv.run.duration import TimeEstimate
from plenopiv.run.frame import Progress
from plenopiv.run.inputs import with_calibration
from plenopiv.run.judged import line_of
from plenopiv.run.kept import KeptVolumes
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import Job, PairRecord
from plenopiv.run.plan import Plan
from plenopiv.run.series import RunResult
from plenopiv.run.shown import VolumeShown
from plenopiv.run.stored import StoredSeries, ask_for_space, summary_there, tell_kept, tell_plan
from plenopiv.run.written import source
from plenopiv.volume import SparseVolume

log = logging.getLogger("plenopiv")
READ = 0.3  # s, a volume: the child process that tries its file, and half a million voxels
START = 6.0  # s, calibration, libraries, report


def correlate(
    results: str | Path,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **correlation: Any,
) -> RunResult:
    """Measure the vectors of a finished run again from the volumes that it kept (output.volumes = true).

    ``correlation``: keys of the table [correlation] that shall differ (``windows``, ``overlap``, ...). The results go
    to ``out``, by default a folder beside ``results`` that is named by the windows; its files are those of a run, and
    vectors are those that a whole run with these keys would give, bit for bit. Pairs that were set aside for their
    frames stay so; those whose field was bad are measured again. Finished pairs are kept, whatever ends it.
    ``overwrite``: as for ``run``.

    Raises:
        PlenoPIVError: no volumes were kept; one, or a file that calibrates, is gone or not as it was; keys cannot be
            used; ``out`` holds results of other inputs.
    """
    report = progress or (lambda stage, done, total: None)
    clock = Clock()
    kept = KeptVolumes.of(results)
    experiment, directory = kept.with_correlation(correlation, None if out is None else Path(out))
    recording = experiment.recording()
    with clock("check"):
        kept.check(recording)
    with kept_warnings() as caught, SeriesFolder(directory, overwrite) as folder:
        tell_before(experiment, kept)
        inputs = kept.stated_inputs(experiment, recording)
        folder.begin(inputs)
        with clock("calibration"):
            chain = kept.chain(experiment, recording, report)
        inputs = with_calibration(inputs, chain, recording)
        folder.settle(inputs)
        tell_kept(folder, recording)
        if folder.is_complete:
            return RunResult(summary_there(folder), folder.directory, (len(recording.pairs), len(recording.pairs)))
        planned = plan_of(chain)
        left = [number for number in range(len(recording.pairs)) if number not in folder.finished]
        tell_plan(planned, recording, [number for number in left if number in kept.measurable])
        ask_for_space(folder, planned, recording, left)

        judgement = kept.judgement(recording, chain.camera)
        for finding in judgement.findings:
            warnings.warn(line_of(asdict(finding)), PlenoPIVWarning, stacklevel=2)
        made_of = f"{source(experiment)}, volumes of {kept.results.resolve().name}"
        job = Job(chain, recording, judgement.pairs, folder.work, made_of, gradients=experiment.output.gradients)
        shown = VolumeShown(lambda number: kept.volume(recording, recording.pairs[number][0]), clock)
        calibration, before = kept.summary["calibration"], [str(w.message) for w in caught]
        series = StoredSeries(
            folder, experiment, recording, inputs, judgement, calibration, planned, clock, report, before
        )
        series.store(_in_turn(job, kept, left, clock, report, shown), len(left))
        summary = series.put_together(shown.of, more={"volumes_of": str(kept.results)})
    return RunResult(summary, directory, (len(recording.pairs), len(recording.pairs)))


def _in_turn(
    job: Job, kept: KeptVolumes, numbers: Sequence[int], clock: Clock, report: Progress, shown: VolumeShown
) -> Iterator[PairRecord]:
    """The records of the pairs ``numbers``, in their order, their fields written."""
    held: dict[int, SparseVolume] = {}
    for number in numbers:
        record, pair = kept.record(number), job.recording.pairs[number]
        if record.set_aside is None:
            held = {k: volume for k, volume in held.items() if k in pair}
            with clock("volumes"):
                held |= {k: kept.volume(job.recording, k) for k in pair if k not in held}
            shown.see(number, held[pair[0]])
            with clock("correlation"):
                record = job.measured(record, held[pair[0]], held[pair[1]], report)
        yield record


def tell_before(experiment: Experiment, kept: KeptVolumes) -> None:
    """Warn of what does not stop it: settings, and other versions than those of the run."""
    for line in experiment.warnings():
        warnings.warn(line, PlenoPIVWarning, stacklevel=3)
    if other := kept.other_versions:
        warnings.warn(
            f"{kept.results}: its volumes are of other versions ({'; '.join(other)}); a run with these may give others",
            PlenoPIVWarning,
            stacklevel=3,
        )


def plan_of(chain: Chain) -> Plan:
    """What to measure between volumes takes."""
    settings = chain.camera, chain.grid, chain.reconstruction, chain.correlation
    needed = replace(memory.of_settings(*settings), volumes=0.0)
    if not chain.unusable:
        needed = replace(needed, light_field=0.0)
    pair = duration.of_settings(*settings, numba.get_num_threads()).pair
    return Plan(chain, needed, TimeEstimate(READ, pair, START))
