"""Vectors measured again from the volumes that a run kept, with other windows: nothing is reconstructed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from plenopiv.device.backend import device_of
from plenopiv.errors import PlenoPIVError, PlenoPIVWarning
from plenopiv.experiment import Experiment
from plenopiv.io.series_folder import SeriesFolder
from plenopiv.recording import Recording
from plenopiv.run.ensemble import Ensembles
from plenopiv.run.frame import Progress
from plenopiv.run.inputs import with_calibration
from plenopiv.run.judged import line_of
from plenopiv.run.kept import KeptVolumes
from plenopiv.run.log import Clock, kept_warnings
from plenopiv.run.pair import Job, PairRecord
from plenopiv.run.plan import Plan, plan_between_volumes
from plenopiv.run.present import as_it_is_now, remember
from plenopiv.run.series import RunResult
from plenopiv.run.shown import VolumeShown
from plenopiv.run.stored import StoredSeries, ask_for_space, summary_there, tell_kept, tell_plan, times_of
from plenopiv.run.written import source
from plenopiv.statistics import Phases
from plenopiv.statistics.phase import BINS
from plenopiv.volume import SparseVolume


def correlate(
    results: str | Path,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    ensemble: bool = False,
    phases: Phases | None = None,
    bins: int = BINS,
    device: str | None = None,
    **correlation: Any,
) -> RunResult:
    """Measure the vectors of a finished run again from the volumes that it kept (output.volumes = true).

    ``correlation``: keys of the table [correlation] that shall differ (``windows``, ``overlap``, ...). The results go
    to ``out``, by default a folder beside ``results`` that is named by the windows; its files are those of a run, and
    vectors are those that a whole run with these keys would give, bit for bit. Pairs that were set aside for their
    frames stay so; those whose field was bad are measured again. Finished pairs are kept, whatever ends it.
    ``overwrite``, ``device``: as for ``run``.

    ``ensemble``: one field of all pairs instead, of a steady flow: their correlations are summed (``Chain.ensemble``).
    Its time is the mean of theirs, ``pairs`` (time,) says how many they are; pairs that were set aside for their frames
    are left out. With ``phases`` a field for each of ``bins`` parts of the period; ``phase`` (time,) is the middle of a
    bin.

    Raises:
        PlenoPIVError: no volumes were kept; one, or a file that calibrates, is gone or not as it was; keys cannot be
            used; ``out`` holds results of other inputs; ``phases`` do not fit the pairs, or are no ``ensemble``.
    """
    if phases is not None and not ensemble:
        raise PlenoPIVError(f"{phases.source}: phases are of ensembles; ask for these too (--ensemble)")
    report = progress or (lambda stage, done, total: None)
    clock = Clock()
    kept = KeptVolumes.of(results)
    fields: EachPair | Ensembles = Ensembles.of(kept, phases, bins) if ensemble else EachPair(kept)
    experiment, directory = kept.with_correlation(correlation, None if out is None else Path(out), fields.words, device)
    computing = device_of(experiment.compute.device, experiment.compute.device_memory_gb)
    if ensemble and computing.kind != "cpu":
        raise PlenoPIVError("ensembles are correlated on this processor: give --device cpu")
    recording = experiment.recording()
    with clock("check"):
        kept.check(recording)
    with kept_warnings() as caught, SeriesFolder(directory, overwrite) as folder:
        _tell_before(experiment, kept)
        inputs = kept.stated_inputs(experiment, recording, computing) | fields.stated
        folder.begin(inputs)
        with clock("calibration"):
            chain = kept.chain(experiment, recording, report, computing)
        inputs = with_calibration(inputs, chain, recording)
        folder.settle(inputs)
        times = fields.times(recording)
        count = len(times["time"])
        tell_kept(folder, count)
        if folder.is_complete and len(folder.finished) == count:
            return RunResult(summary_there(folder), directory, (count, count))
        planned = fields.plan(plan_between_volumes(chain))
        left = [number for number in range(count) if number not in folder.finished]
        planned = as_it_is_now(planned)
        tell_plan(planned, 2 * len(left), len(left))
        ask_for_space(folder, planned, len(left), count, experiment.output.gradients)

        judgement = kept.judgement(recording, chain.camera)
        for finding in judgement.findings:
            warnings.warn(line_of(asdict(finding)), PlenoPIVWarning, stacklevel=2)
        made_of = f"{source(experiment)}, volumes of {kept.name}"
        job = Job(chain, recording, judgement.pairs, folder.work, made_of, gradients=experiment.output.gradients)
        calibration, before = kept.summary["calibration"], [str(w.message) for w in caught]
        series = StoredSeries(
            folder, experiment, recording, times, inputs, judgement, calibration, planned, clock, report, before
        )
        shown = VolumeShown(chain, lambda: kept.volume(recording, recording.pairs[kept.measurable[0]][0]), clock)
        series.store(fields.measured(job, left, clock, report, shown), len(left))
        remember(planned)
        summary = series.put_together(shown.of, more={"volumes_of": str(kept.results), **fields.summary})
    return RunResult(summary, directory, (count, count))


@dataclass(frozen=True)
class EachPair:
    """A field of each pair; the other way is ``Ensembles``."""

    kept: KeptVolumes
    words: tuple[str, ...] = ()

    @property
    def stated(self) -> dict[str, Any]:
        """Nothing more."""
        return {}

    @property
    def summary(self) -> dict[str, Any]:
        """Nothing more."""
        return {}

    def times(self, recording: Recording) -> dict[str, list[float]]:
        """Of the pairs."""
        return times_of(recording)

    def plan(self, each: Plan) -> Plan:
        """The same."""
        return each

    def measured(
        self, job: Job, numbers: Sequence[int], clock: Clock, report: Progress, shown: VolumeShown
    ) -> Iterator[PairRecord]:
        """The records of the pairs ``numbers``; each volume is read once where pairs that share it follow each
        other."""
        held: dict[int, SparseVolume] = {}
        for number in numbers:
            record, pair = self.kept.record(number), job.recording.pairs[number]
            if record.set_aside is None:
                held = {k: volume for k, volume in held.items() if k in pair}
                with clock("volumes"):
                    held |= {k: self.kept.volume(job.recording, k) for k in pair if k not in held}
                shown.see(number, held[pair[0]])
                with clock("correlation"):
                    record = job.measured(record, held[pair[0]], held[pair[1]], report)
            yield record


def _tell_before(experiment: Experiment, kept: KeptVolumes) -> None:
    """Warn of what does not stop it: settings, and other versions than those of the run."""
    for line in experiment.warnings():
        warnings.warn(line, PlenoPIVWarning, stacklevel=3)
    if other := kept.other_versions:
        warnings.warn(
            f"{kept.results}: its volumes are of other versions ({'; '.join(other)}); a run with these may give others",
            PlenoPIVWarning,
            stacklevel=3,
        )
